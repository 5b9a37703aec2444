"""How exactly signs are placed on rendered drives, compared with the bound and with a peer.

    .venv/bin/python benchmarks/geometry.py [--frames 24] [--no-peer]

Runs wayside on the rendered drives `straight` and `curve` as recorded (poses given), with images and the known spacing
alone, and with satellite fixes alone. Compares the signs with the truth and with the Cramér-Rao bound of the scene.
Then reconstructs the first images of both with pycolmap (extra `benchmark`), same
calibration, one thread. Writes benchmarks/geometry.md; with --no-peer it only prints.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from common import BENCHMARKS, REAL_DRIVES, head, render, row, run_wayside, table, versions
from geometry_peer import peer_table
from geometry_runs import (
    FOLDER,
    NAMES,
    POSES_GIVEN,
    SPACING_ONLY,
    WAYS,
    Array,
    Run,
    camera_of,
    pair,
    run,
    true_poses,
)

from wayside.pipeline.evaluation.figures import AXES, RenderedEvaluation
from wayside.pipeline.labels.box_matching import same_thing
from wayside.pipeline.simulation.bound import point_bound
from wayside.pipeline.simulation.drive import Survey
from wayside.pipeline.simulation.simulate import UNKNOWN_LENGTH_M, bound_of_step
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.settings import MotionSettings

CENTRE_PX, POSE_M, POSE_DEG = 0.2, 0.02, 0.04
"""For the bound: noise of a face's centre in an image, and the scatter of the poses in the logs."""
REAL, REAL_SPACING = "de_road_kitti0015", "6.15m"
SIZES = {"R1": (0.90, 0.78), "R3": (0.60, 0.60)}
"""Nominal width and height, metres: a warning triangle of 900 mm side, a limit disc of 600 mm."""
APART = ("R1", "R3", 28.6)
"""Two signs and the way from one to the other, metres, from when each is passed and 80 m between two beacons."""


def main() -> int:
    """Run, compare, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=24, help="images for the peer")
    parser.add_argument("--no-peer", action="store_true")
    parser.add_argument("--real", type=Path, default=REAL_DRIVES)
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes started here
    FOLDER.mkdir(parents=True, exist_ok=True)
    render(NAMES)
    runs = [run(name, way) for name in NAMES for way in WAYS]
    lines = ["# Geometry, its bound and a peer", ""]
    lines += ["Made by `benchmarks/geometry.py` on rendered drives with exact truth.", ""]
    lines += [versions(), "", *sign_table(runs)]
    if not args.no_peer:
        lines += peer_table([r for r in runs if r.way == SPACING_ONLY], args.frames)
    text = "\n".join([*lines, *real_table(args.real)]) + "\n"
    print(text)
    if not args.no_peer:
        (BENCHMARKS / "geometry.md").write_text(text)
    return 0


def sign_table(runs: list[Run]) -> Iterator[str]:
    """Errors of found signs, the bound beside them."""
    yield "## Signs against the truth"
    yield ""
    yield (
        "Errors in the camera of the closest whole view, median / 95 %, cm. Bound: one standard deviation, median over "
        f"the same signs. It takes {CENTRE_PX} px a coordinate for the centre of a face in each image, ties as "
        "measured on these drives and 2 cm of scatter in the spacing. Sizes are in per cent, facing in degrees. "
        "Sigma: fraction of the true positions within one and two stated standard deviations, all axes together."
    )
    yield ""
    names = "found|along|bound|lateral|bound|up|bound|3-D|width|height|bottom edge|facing|sigma"
    yield head(["drive, what is given", *names.split("|")])
    for one in runs:
        e = one.evaluation()
        bound = bounds(one, e)
        cells = [f"{one.name}, {one.way}", f"{e.found_count} of {e.wanted}"]
        for k, axis in enumerate(("along", "lateral", "up")):
            spread = e.error_m[axis]
            cells += [pair(spread.median, spread.p95, 100), f"{100 * bound[k]:.1f}"]
        total, bottom = e.error_m["total"], e.bottom_error_m
        cells.append(pair(total.median, total.p95, 100))
        cells += [pair(s.median, s.p95, 100) for s in map(e.size_error, ("width", "height"))]
        cells.append(pair(bottom.median, bottom.p95, 100))
        turned = facing_errors(e)
        cells.append(pair(*np.quantile(turned, [0.5, 0.95]), 1) if len(turned) else "-")
        pulls = np.abs(
            [np.divide(m.error_m, [m.sign[name] for name in AXES.values()]) for m in e.found]
        )
        cells.append(f"{100 * (pulls < 1).mean():.0f} / {100 * (pulls < 2).mean():.0f} %")
        yield row(cells)
    yield ""


def facing_errors(e: RenderedEvaluation) -> list[float]:
    """Absolute errors of the facing, degrees."""
    pairs = [(m.sign["facing_deg"], m.panel["facing_deg"]) for m in e.found]
    return [abs((a - b + 180) % 360 - 180) for a, b in pairs if a is not None]


def bounds(one: Run, e: RenderedEvaluation) -> Array:
    """Median Cramér-Rao bound (3,) of the found signs as standard deviations along, lateral, up."""
    poses, camera = true_poses(one.truth), camera_of(one.truth)
    given = one.way == POSES_GIVEN
    steps: dict[int, Array] = {}
    found = []
    for match in e.found:
        panel, best = match.panel, match.sign["best_frame"]
        views = [
            v["frame"]
            for v in panel["frames"]
            if v["side"] == "front" and v["visible_fraction"] >= 0.5
        ]
        views = sorted({*views, best})
        span = list(range(views[0], views[-1] + 1))
        for frame in span[1:]:
            if frame not in steps:
                steps[frame] = true_step_bound(poses, camera, frame, given=given)
        found.append(
            point_bound(
                np.stack([poses[f].rotation for f in span]),
                np.stack([poses[f].centre for f in span]),
                np.array(panel["centre"]),
                np.array(views) - span[0],
                np.full(len(views), CENTRE_PX / camera.fx),
                np.stack([steps.get(f, np.eye(6)) for f in span]),
                best - span[0],
                (POSE_M, np.radians(POSE_DEG)) if given else None,
            )
        )
    deviations = np.sqrt(np.array([np.diag(c) for c in found]))
    return np.asarray(np.median(deviations, axis=0)[[2, 0, 1]])


def true_step_bound(poses: dict[int, Pose], camera: Camera, frame: int, *, given: bool) -> Array:
    """Best covariance of a true step by 200 ties on the road and at its sides."""
    rng, count = np.random.default_rng(frame), 4000
    survey = Survey()
    ahead, road = rng.uniform(10, 120, count), rng.random(count) < 0.5
    side = rng.choice([-1.0, 1.0], count)
    aside = np.where(road, rng.uniform(-6, 6, count), side * rng.uniform(5, 30, count))
    below = np.where(road, 2.0, 2.0 - rng.gamma(1.0, 2.0, count))
    points = np.column_stack([aside, below, ahead])
    step = poses[frame].relative_to(poses[frame - 1])
    pixels = []
    for local in (points, step.to_camera(points)):
        scale = [camera.fx, camera.fy]
        with np.errstate(divide="ignore"):
            pixels.append(local[:, :2] / local[:, 2:] * scale + [camera.cx, camera.cy])
    shown = step.to_camera(points)[:, 2] > 4
    for uv in pixels:
        shown &= (uv >= 0).all(axis=1) & (uv < [camera.width, camera.height]).all(axis=1)
    rows = np.flatnonzero(shown)[: survey.ties]
    known = UNKNOWN_LENGTH_M if given else MotionSettings().spacing_sigma_m
    return bound_of_step(survey, camera, step, (pixels[0][rows], pixels[1][rows]), known)


def real_table(folder: Path) -> Iterator[str]:
    """What is known of lengths on a real drive, beside what is measured there."""
    yield "## A real drive"
    yield ""
    log, labels = folder / f"{REAL}.mcap", folder / f"{REAL}.labels.json"
    if not log.is_file():
        yield f"{REAL} was not at hand."
        return
    out = FOLDER / REAL
    run_wayside("run", log, "-o", out, "--overwrite", "--spacing", REAL_SPACING, check=True)
    known = {sign["id"]: sign for sign in json.loads(labels.read_text())["signs"]}
    found = {name: found_row(out, known[name]) for name in SIZES}
    yield (
        f"`{REAL}`: images and an estimated spacing of {REAL_SPACING}, calibration as published. Nothing there was "
        "surveyed. Sizes are from the regulations. The distance follows from 80 m between two beacons, whose boxes say "
        "that either is some 5 % off."
    )
    yield ""
    cells = [
        [known[name]["what"], f"{width:.2f} x {height:.2f} m", size_words(found[name])]
        for name, (width, height) in SIZES.items()
    ]
    first, second = found[APART[0]], found[APART[1]]
    apart = f"{second['station_m'] - first['station_m']:.1f} m" if first and second else "not found"
    cells.append(["from the one to the other, along the road", f"{APART[2]:.1f} m", apart])
    yield from table(("what", "nominal", "measured"), cells)


def size_words(sign: dict[str, Any] | None) -> str:
    """Width and height with their standard deviations."""
    if sign is None:
        return "not found"
    width, height = (
        f"{sign[f'panel_{side}_m']:.2f} ± {sign[f'sigma_{side}_m']:.2f}"
        for side in ("width", "height")
    )
    return f"{width} x {height} m"


def found_row(out: Path, label: dict[str, Any]) -> dict[str, Any] | None:
    """The row of `signs.parquet` that lies on a label."""
    boxes = {entry["i"]: entry["box"] for entry in label["boxes"]}
    listed = pq.read_table(out / "observations.parquet", columns=["sign_id", "frame", "box"])
    names = {
        one["sign_id"]
        for one in listed.to_pylist()
        if one["sign_id"] and one["frame"] in boxes and same_thing(one["box"], boxes[one["frame"]])
    }
    rows = pq.read_table(out / "signs.parquet").to_pylist()
    return next((one for one in rows if one["sign_id"] in names), None)


if __name__ == "__main__":
    sys.exit(main())
