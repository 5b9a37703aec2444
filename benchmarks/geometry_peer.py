"""Motion, signs and cost of wayside and of pycolmap on the same images, side by side."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from common import DRIVES, ROOT, head, processor_seconds, row
from geometry_runs import FOLDER, Array, Run, camera_of, pair, true_poses
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Pose
from wayside.stages.geometry import ideal_points

STEPS = 5
"""Images over which camera positions are compared."""


def peer_table(runs: list[Run], count: int) -> Iterator[str]:
    """Motion, signs and cost side by side."""
    yield f"## pycolmap {version('pycolmap')}"
    yield ""
    yield (
        f"The first {count} images of each drive, images and spacing only, same calibration, one thread. The peer, "
        "pycolmap, runs SIFT, sequential matching over five images and incremental mapping. Its options are loosened "
        "for forward motion, and it is scaled by the known spacing. Its place of a sign is the median of the points on "
        "the face, each against the true plane along its own ray, in the closest image that shows one. Rotation and "
        f"direction of each step, position of the camera {STEPS} images on and errors of signs are median / 95 %."
    )
    yield ""
    names = "drive|what|images|rotation, deg|direction, deg|camera, cm|signs|along, cm|lateral, cm"
    yield head([*names.split("|"), "processor s per image"], words=2)
    for one in runs:
        truth = true_poses(one.truth)
        own = motion_cells(wayside_poses(one, count), truth)
        yield row([one.name, "wayside", *own, *own_signs(one, count)])
        out = FOLDER / f"{one.name}-peer.npz"
        out.unlink(missing_ok=True)
        command = [sys.executable, "benchmarks/peer.py", str(DRIVES / f"{one.name}.mcap"), str(out)]
        before = processor_seconds()
        subprocess.run([*command, "--frames", str(count)], check=True, cwd=ROOT)
        spent = processor_seconds() - before
        with np.load(out) as model:
            poses, scale = scaled_poses(model, truth)
            errors = peer_signs(one, model, poses, scale)
        cells = [*motion_cells(poses, truth), str(len(errors))]
        cells += [pair(*np.quantile(np.abs(errors[:, k]), [0.5, 0.95]), 100) for k in (2, 0)]
        yield row([one.name, "pycolmap", *cells, f"{spent / count:.2f}"])
    yield ""


def wayside_poses(one: Run, count: int) -> dict[int, Pose]:
    """Poses of the first images of a run."""
    rows = pq.read_table(one.folder / "frames.parquet").to_pylist()
    return {
        r["frame"]: Pose(
            Rotation.from_quat([r[c] for c in ("qx", "qy", "qz", "qw")]).as_matrix(),
            np.array([r[c] for c in "xyz"]),
        )
        for r in rows
        if r["status"] == "used" and r["frame"] < count
    }


def own_signs(one: Run, count: int) -> list[str]:
    """Cells on signs and cost of wayside."""
    e = one.evaluation(below=count)
    along, lateral = e.error_m["along"], e.error_m["lateral"]
    images = len(one.truth["frames"])
    cells = [
        str(e.found_count),
        pair(along.median, along.p95, 100),
        pair(lateral.median, lateral.p95, 100),
    ]
    return [*cells, f"{one.processor_s / images:.2f} (all stages)"]


def motion_cells(poses: dict[int, Pose], truth: dict[int, Pose]) -> list[str]:
    """Errors of steps and of the way over several images."""
    turns, directions, ways = [], [], []
    for frame, pose in poses.items():
        if frame - 1 in poses:
            step, true = (
                pose.relative_to(poses[frame - 1]),
                truth[frame].relative_to(truth[frame - 1]),
            )
            turns.append(Rotation.from_matrix(step.rotation @ true.rotation.T).magnitude())
            cosine = (
                step.centre
                @ true.centre
                / np.linalg.norm(step.centre)
                / np.linalg.norm(true.centre)
            )
            directions.append(np.arccos(min(1.0, cosine)))
        if frame - STEPS in poses:
            step, true = (p[frame].relative_to(p[frame - STEPS]) for p in (poses, truth))
            ways.append(np.linalg.norm(step.centre - true.centre))
    cells = [
        f"{np.degrees(np.median(v)):.4f} / {np.degrees(np.quantile(v, 0.95)):.4f}"
        for v in (turns, directions)
    ]
    return [str(len(poses)), *cells, pair(*np.quantile(ways, [0.5, 0.95]), 100)]


def scaled_poses(model: Any, truth: dict[int, Pose]) -> tuple[dict[int, Pose], float]:
    """The peer's poses in metres by the nominal spacing; steps over missing images count as often."""
    frames, centres = model["frames"], model["centres"]
    lengths = np.linalg.norm(np.diff(centres, axis=0), axis=1) / np.diff(frames)
    nominal = 26.4 * 0.3048
    scale = nominal / float(np.median(lengths))
    poses = zip(frames, model["rotations"], centres, strict=True)
    return {int(f): Pose(r, scale * c) for f, r, c in poses if int(f) in truth}, scale


def peer_signs(one: Run, model: Any, poses: dict[int, Pose], scale: float) -> Array:
    """Errors (n, 3) of panels by the peer's points on them: right, down, ahead in the closest image with a point."""
    truth, camera = true_poses(one.truth), camera_of(one.truth)
    seen, points = model["seen"], model["points"] * scale
    found = []
    for panel in one.truth["signs"]:
        for view in sorted(panel["frames"], key=lambda v: v["range_m"]):
            frame = view["frame"]
            if view["side"] != "front" or not panel["faces_travel"] or frame not in poses:
                continue
            rows = np.flatnonzero(seen[:, 0] == frame)
            rows = rows[[inside(seen[i, 1:], view["polygons"]) for i in rows]]
            if len(rows) == 0:
                continue
            uv = (ideal_points(camera, seen[rows, 1:]) - [camera.cx, camera.cy]) / [
                camera.fx,
                camera.fy,
            ]
            rays = np.column_stack([uv, np.ones(len(uv))])
            normal = np.array(panel["normal"]) @ truth[frame].rotation
            centre = truth[frame].to_camera(np.array(panel["centre"]))
            true = rays * (normal @ centre / (rays @ normal))[:, None]
            found.append(np.median(poses[frame].to_camera(points[rows]) - true, axis=0))
            break
    return np.array(found).reshape(-1, 3)


def inside(point: Array, polygons: list[list[list[float]]]) -> bool:
    """Whether a pixel lies in one of the polygons."""
    place = (float(point[0]), float(point[1]))
    return any(cv2.pointPolygonTest(np.array(p, np.float32), place, False) >= 0 for p in polygons)
