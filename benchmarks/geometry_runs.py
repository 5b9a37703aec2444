"""Runs of wayside and of pycolmap on rendered drives, and errors of their motion and signs."""

import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from common import DRIVES, ROOT, processor_seconds, run_wayside
from faulty_logs import read_log, write_log
from scipy.spatial.transform import Rotation

from wayside.pipeline.evaluation.figures import RenderedEvaluation
from wayside.pipeline.evaluation.rendered import evaluate_against_truth
from wayside.pipeline.statistics import Spread, spread
from wayside.schemas.frame import Camera, Pose
from wayside.stages.geometry import to_rays
from wayside.stages.kernels import Array

FOLDER = ROOT / ".cache" / "geometry"
NAMES, SPACING = ("straight", "curve"), "26.4ft"
NOTHING_ELSE, FIXES = ("Image", "Camera"), ("Image", "Camera", "NavSat", "LocationFix")
POSES_GIVEN, SPACING_ONLY, FIXES_ONLY = "poses given", "images and spacing only", "fixes only"
WAYS = {POSES_GIVEN: (), SPACING_ONLY: NOTHING_ELSE, FIXES_ONLY: FIXES}
"""What a run is given, and which messages of the log it keeps for that; none: all."""
STEPS = 5
"""Images over which camera positions are compared."""
PEER_HEADS = (
    "drive|what|images|rotation, deg|direction, deg|camera, cm|signs|along, cm|lateral, cm"
    "|processor s per image"
).split("|")


@dataclass
class Run:
    """One run of wayside on one variant of a drive."""

    name: str
    way: str
    folder: Path
    truth: dict[str, Any]
    processor_s: float
    signs: list[dict[str, Any]] = field(default_factory=list)

    def evaluation(self, below: int | None = None) -> RenderedEvaluation:
        """Compare with the truth: all signs, or those whose best image comes before one."""
        rows = [s for s in self.signs if below is None or s["best_frame"] < below]
        return evaluate_against_truth(rows, self.truth)

    @cached_property
    def true_poses(self) -> dict[int, Pose]:
        """Pose of each image."""
        return {f["index"]: _pose(f["quaternion"], f["position"]) for f in self.truth["frames"]}

    @cached_property
    def camera(self) -> Camera:
        """The rendered camera."""
        c = self.truth["camera"]
        lens = [c[name] for name in ("width", "height", "fx", "fy", "cx", "cy")]
        return Camera(*lens, tuple(c["distortion"]))


def _pose(quaternion: list[float], position: list[float]) -> Pose:
    return Pose(Rotation.from_quat(quaternion).as_matrix(), np.array(position))


def run(name: str, way: str) -> Run:
    """Run wayside on a drive as recorded, or with part of its messages."""
    log, folder = DRIVES / f"{name}.mcap", FOLDER / f"{name}-{way.replace(' ', '-')}"
    if WAYS[way]:
        part = FOLDER / f"{folder.name}.mcap"
        strip(log, part, WAYS[way])
        log = part
    words = ["--overwrite", "--workers", "1", "--set", "read.thin_m=0"]
    words += ["--spacing", SPACING] if way == SPACING_ONLY else []
    before = processor_seconds()
    run_wayside("run", log, "-o", folder, *words, check=True)
    spent = processor_seconds() - before
    truth = json.loads((DRIVES / f"{name}.truth.json").read_text())
    rows = pq.read_table(folder / "signs.parquet", filters=[("status", "=", "sign")]).to_pylist()
    return Run(name, way, folder, truth, spent, rows)


def strip(source: Path, target: Path, keep: Iterable[str]) -> None:
    """Copy the messages of a log whose schema is of one of these kinds."""
    kept = (m for m in read_log(source) if any(kind in m.schema.name for kind in keep))
    write_log(target, kept)


def pair(errors: Spread, scale: float, places: int = 1) -> str:
    """Median and tail."""
    if errors.median is None or errors.p95 is None:
        return "-"
    return f"{scale * errors.median:.{places}f} / {scale * errors.p95:.{places}f}"


def peer_rows(runs: list[Run], count: int) -> Iterator[list[str]]:
    """Motion, signs and cost of wayside and of pycolmap on the first images, side by side."""
    for one in runs:
        e = one.evaluation(below=count)
        motion = motion_cells(wayside_poses(one, count), one.true_poses)
        signs = [str(e.found_count), *(pair(e.error_m[axis], 100) for axis in ("along", "lateral"))]
        cost = f"{one.processor_s / len(one.truth['frames']):.2f} (all stages)"
        yield [one.name, "wayside", *motion, *signs, cost]
        out = FOLDER / f"{one.name}-peer.npz"
        out.unlink(missing_ok=True)
        log, before = DRIVES / f"{one.name}.mcap", processor_seconds()
        program = [sys.executable, "benchmarks/peer.py", log, out, str(count)]
        subprocess.run(program, check=True, cwd=ROOT)
        cost = f"{(processor_seconds() - before) / count:.2f}"
        with np.load(out) as model:
            poses, scale = scaled_poses(model, one.true_poses)
            errors = np.abs(peer_signs(one, model, poses, scale))
        signs = [str(len(errors)), *(pair(spread(errors[:, k]), 100) for k in (2, 0))]
        yield [one.name, "pycolmap", *motion_cells(poses, one.true_poses), *signs, cost]


def wayside_poses(one: Run, count: int) -> dict[int, Pose]:
    """Poses of the first images of a run."""
    first = [("status", "=", "used"), ("frame", "<", count)]
    rows = pq.read_table(one.folder / "frames.parquet", filters=first).to_pylist()
    turns = ("qx", "qy", "qz", "qw")
    return {r["frame"]: _pose([r[c] for c in turns], [r[c] for c in "xyz"]) for r in rows}


def motion_cells(poses: dict[int, Pose], truth: dict[int, Pose]) -> list[str]:
    """Errors of steps and of the way over several images."""
    turns, directions, ways = [], [], []
    for frame in poses:
        if frame - 1 in poses:
            step, true = (p[frame].relative_to(p[frame - 1]) for p in (poses, truth))
            turns.append(Rotation.from_matrix(step.rotation @ true.rotation.T).magnitude())
            lengths = np.linalg.norm(step.centre) * np.linalg.norm(true.centre)
            directions.append(np.arccos(min(1.0, step.centre @ true.centre / lengths)))
        if frame - STEPS in poses:
            step, true = (p[frame].relative_to(p[frame - STEPS]) for p in (poses, truth))
            ways.append(np.linalg.norm(step.centre - true.centre))
    degrees = [pair(spread(np.degrees(v)), 1, places=4) for v in (turns, directions)]
    return [str(len(poses)), *degrees, pair(spread(ways), 100)]


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
            rays = np.column_stack([to_rays(one.camera, seen[rows, 1:]), np.ones(len(rows))])
            normal = np.array(panel["normal"]) @ one.true_poses[frame].rotation
            centre = one.true_poses[frame].to_camera(np.array(panel["centre"]))
            true = rays * (normal @ centre / (rays @ normal))[:, None]
            found.append(np.median(poses[frame].to_camera(points[rows]) - true, axis=0))
            break
    return np.array(found).reshape(-1, 3)


def inside(point: Array, polygons: list[list[list[float]]]) -> bool:
    """Whether a pixel lies in one of the polygons."""
    place = (float(point[0]), float(point[1]))
    return any(cv2.pointPolygonTest(np.array(p, np.float32), place, False) >= 0 for p in polygons)
