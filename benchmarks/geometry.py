"""How exactly signs are placed on rendered drives, compared with the bound and with a peer.

    .venv/bin/python benchmarks/geometry.py [--no-peer]

Runs wayside on the rendered drives `straight` and `curve` as recorded (poses given), with images and the known spacing
alone, and with satellite fixes alone. Compares the signs with the truth and with the Cramér-Rao bound of the scene.
Then reconstructs the first images of both with pycolmap (extra `benchmark`), same calibration, one thread. Writes
benchmarks/geometry.md; with --no-peer it only prints.
"""

import json
import os
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from accept import write_page
from common import REAL_DRIVES, render, run_wayside, table
from geometry_runs import (
    FOLDER,
    NAMES,
    PEER_HEADS,
    POSES_GIVEN,
    SPACING_ONLY,
    WAYS,
    Array,
    Run,
    pair,
    peer_rows,
    run,
)

from wayside.pipeline.evaluation.figures import AXES, RenderedEvaluation
from wayside.pipeline.labels.box_matching import same_thing
from wayside.pipeline.simulation.bound import point_bound
from wayside.pipeline.simulation.drive import Survey
from wayside.pipeline.simulation.simulate import UNKNOWN_LENGTH_M, bound_of_step
from wayside.pipeline.statistics import spread
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import ideal_of_rays

CENTRE_PX, POSE_M, POSE_DEG = 0.2, 0.02, 0.04
"""For the bound: noise of a face's centre in an image, and the scatter of the poses in the logs."""
PEER_IMAGES = 24
REAL, REAL_SPACING = "de_road_kitti0015", "6.15m"
SIZES = {"R1": (0.90, 0.78), "R3": (0.60, 0.60)}
"""Nominal width and height, metres: a warning triangle of 900 mm side, a limit disc of 600 mm."""
APART_M = 28.6
"""The way from the one to the other, from when each is passed and 80 m between two beacons."""
HEADS = (
    "drive, what is given|found|along|bound|lateral|bound|up|bound|3-D|width|height|bottom edge"
    "|facing|sigma"
).split("|")


def main() -> int:
    """Run, compare, write."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--no-peer", action="store_true")
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes started here
    FOLDER.mkdir(parents=True, exist_ok=True)
    render(NAMES)
    runs = [run(name, way) for name in NAMES for way in WAYS]
    parts = {"Signs against the truth": table(HEADS, map(sign_cells, runs))}
    if not args.no_peer:
        spaced = [one for one in runs if one.way == SPACING_ONLY]
        rows = peer_rows(spaced, PEER_IMAGES)
        parts[f"pycolmap {version('pycolmap')}"] = table(PEER_HEADS, rows, words=2)
    if (REAL_DRIVES / f"{REAL}.mcap").is_file():
        parts["A real drive"] = table(("what", "nominal", "measured"), real_rows())
    print("\n".join(line for part in parts.values() for line in part))
    if not args.no_peer:
        write_page("geometry.md", parts)
    return 0


def sign_cells(one: Run) -> list[str]:
    """Errors of found signs, next to the bound."""
    e = one.evaluation()
    cells = [f"{one.name}, {one.way}", f"{e.found_count} of {e.wanted}"]
    for axis, bound_m in zip(("along", "lateral", "up"), bounds(one, e), strict=True):
        cells += [pair(e.error_m[axis], 100), f"{100 * bound_m:.1f}"]
    sizes = (e.size_error(side) for side in ("width", "height"))
    cells += [pair(errors, 100) for errors in (e.error_m["total"], *sizes, e.bottom_error_m)]
    facing = [(m.sign["facing_deg"], m.panel["facing_deg"]) for m in e.found]
    turned = spread(abs((a - b + 180) % 360 - 180) for a, b in facing if a is not None)
    pulls = np.abs([np.divide(m.error_m, [m.sign[s] for s in AXES.values()]) for m in e.found])
    shares = (f"{100 * (pulls < sigmas).mean():.0f}" for sigmas in (1, 2))
    return [*cells, pair(turned, 1), f"{' / '.join(shares)} %"]


def bounds(one: Run, e: RenderedEvaluation) -> Array:
    """Median Cramér-Rao bound (3,) of the found signs as standard deviations along, lateral, up."""
    poses, camera = one.true_poses, one.camera
    given = one.way == POSES_GIVEN
    steps: dict[int, Array] = {}
    found = []
    for match in e.found:
        panel, best = match.panel, match.sign["best_frame"]
        fronts = (v for v in panel["frames"] if v["side"] == "front")
        views = sorted({best, *(v["frame"] for v in fronts if v["visible_fraction"] >= 0.5)})
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
    both = (points, step.to_camera(points))
    with np.errstate(divide="ignore"):
        before, now = (ideal_of_rays(camera, local[:, :2] / local[:, 2:]) for local in both)
    shown = both[1][:, 2] > 4
    for uv in (before, now):
        shown &= (uv >= 0).all(axis=1) & (uv < [camera.width, camera.height]).all(axis=1)
    rows = np.flatnonzero(shown)[: survey.ties]
    known = UNKNOWN_LENGTH_M if given else MotionSettings().spacing_sigma_m
    return bound_of_step(survey, camera, step, (before[rows], now[rows]), known)


def real_rows() -> Iterator[list[str]]:
    """Known lengths on a real drive, next to the measured ones."""
    out = FOLDER / REAL
    words = ("-o", out, "--overwrite", "--spacing", REAL_SPACING)
    run_wayside("run", REAL_DRIVES / f"{REAL}.mcap", *words, check=True)
    labels = json.loads((REAL_DRIVES / f"{REAL}.labels.json").read_text())
    known = {sign["id"]: sign for sign in labels["signs"]}
    found = {name: found_row(out, known[name]) for name in SIZES}
    for name, (width, height) in SIZES.items():
        yield [known[name]["what"], f"{width:.2f} x {height:.2f} m", size_words(found[name])]
    first, second = (found[name] for name in SIZES)
    apart = f"{second['station_m'] - first['station_m']:.1f} m" if first and second else "not found"
    yield ["from the one to the other, along the road", f"{APART_M:.1f} m", apart]


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
