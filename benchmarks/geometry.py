"""How exactly signs are placed on rendered drives, beside the bound and beside a peer.

    .venv/bin/python benchmarks/geometry.py [--frames 24] [--no-peer]

Runs wayside on the rendered drives `straight` and `curve` three ways: as recorded (poses given), with images and the
known spacing alone, and with satellite fixes; compares the signs found with the truth and with the Cramér-Rao
bound of the same scene. Then reconstructs the first images of both with pycolmap (extra `benchmark`), same
calibration, one thread. Writes benchmarks/geometry.md; with --no-peer it only prints.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from geometry_globe import log_table, long_table, relation_table
from geometry_peer import peer_table
from geometry_real import real_table
from geometry_runs import (
    NAMES,
    POSES_GIVEN,
    RESULTS,
    ROOT,
    SPACING_ONLY,
    WAYS,
    Array,
    Run,
    camera_of,
    heading,
    pair,
    render,
    row,
    run,
    true_poses,
)

from wayside.pipeline.evaluation import RenderedEvaluation
from wayside.pipeline.simulation.bound import point_bound
from wayside.pipeline.simulation.drive import Survey
from wayside.pipeline.simulation.simulate import UNKNOWN_LENGTH_M, bound_of_step, simulate
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.settings import MotionSettings

CENTRE_PX, POSE_M, POSE_DEG = 0.2, 0.02, 0.04
"""For the bound: noise of a face's centre in an image, and the scatter of the poses in the logs."""
SIMULATED = 300
SIMULATIONS: dict[str, dict[str, float]] = {
    "straight, spacing given": {},
    "curve of 430 m radius": {"curve_radius_m": 430.0},
    "curve of 250 m radius": {"curve_radius_m": 250.0},
    "hills of 6 m, camera turned 1 degree": {"hill_m": 6.0, "mount_yaw_deg": 1.0},
    "straight, poses given to 2 cm": {"pose_m": POSE_M},
    "3 % of triggers dropped, 3 % outliers": {"drop_rate": 0.03, "outliers": 0.03},
    "1 px noise": {"noise_px": 1.0},
    "spacing 16 m": {"spacing_m": 16.0},
}


def main() -> int:
    """Run, compare, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=24, help="images for the peer")
    parser.add_argument("--no-peer", action="store_true")
    parser.add_argument("--real", type=Path, default=ROOT.parent / "shared" / "data" / "real")
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes started here
    RESULTS.mkdir(parents=True, exist_ok=True)
    render()
    runs = [run(name, way) for name in NAMES for way in WAYS]
    lines = [*title(), *sign_table(runs), *relation_table(runs)]
    lines += [*log_table(), *long_table(), *simulated_table()]
    if not args.no_peer:
        lines += peer_table([r for r in runs if r.way == SPACING_ONLY], args.frames)
    lines += real_table(args.real, RESULTS)
    text = "\n".join(lines) + "\n"
    print(text)
    if not args.no_peer:
        (ROOT / "benchmarks" / "geometry.md").write_text(text)
    return 0


def sign_table(runs: list[Run]) -> Iterator[str]:
    """Errors of found signs, the bound beside them."""
    yield "## Signs against the truth"
    yield ""
    yield (
        "Errors in the camera of the closest whole view, median / 95 %, cm; bound: one standard deviation, median over "
        f"the same signs: {CENTRE_PX} px a coordinate for the centre of a face in each image, ties as measured on "
        "these drives, 2 cm of scatter in the spacing. Sizes: per cent; facing: degrees; sigma: fraction of the true "
        "positions within one and two stated standard deviations, all axes together."
    )
    yield ""
    head = "drive, what is given|found|along|bound|lateral|bound|up|bound|3-D|width|height|bottom edge|facing|sigma"
    yield from heading(head)
    for one in runs:
        e = one.evaluation()
        bound = bounds(one, e)
        cells = [f"{one.name}, {one.way}", f"{e.found_count} of {e.wanted}"]
        for k, axis in enumerate(("along", "lateral", "up")):
            spread = e.error_m[axis]
            cells += [pair(spread.median, spread.p95, 100), f"{100 * bound[k]:.1f}"]
        total, bottom = e.error_m["total"], e.bottom_error_m
        cells.append(pair(total.median, total.p95, 100))
        cells += [pair(s.median, s.p95, 100) for s in (e.width_error, e.height_error)]
        cells.append(pair(bottom.median, bottom.p95, 100))
        turned = facing_errors(one, e)
        cells.append(pair(*np.quantile(turned, [0.5, 0.95]), 1) if len(turned) else "-")
        pulls = np.abs([np.divide(m.error_m, m.sigma_m) for m in e.matches])
        cells.append(f"{100 * (pulls < 1).mean():.0f} / {100 * (pulls < 2).mean():.0f} %")
        yield row(cells)
    yield ""


def facing_errors(one: Run, e: RenderedEvaluation) -> list[float]:
    """Absolute errors of the facing, degrees."""
    stated = {s["sign_id"]: s["facing_deg"] for s in one.signs}
    true = {p["id"]: p["facing_deg"] for p in one.truth["signs"]}
    pairs = [(stated[m.sign_id], true[m.panel_id]) for m in e.matches]
    return [abs((a - b + 180) % 360 - 180) for a, b in pairs if a is not None]


def bounds(one: Run, e: RenderedEvaluation) -> Array:
    """Median Cramér-Rao bound (3,) of the found signs as standard deviations along, lateral, up."""
    poses, camera = true_poses(one.truth), camera_of(one.truth)
    given = one.way == POSES_GIVEN
    panels = {p["id"]: p for p in one.truth["signs"]}
    best = {s["sign_id"]: s["best_frame"] for s in one.signs}
    steps: dict[int, Array] = {}
    found = []
    for match in e.matches:
        panel = panels[match.panel_id]
        views = [
            v["frame"]
            for v in panel["frames"]
            if v["side"] == "front" and v["visible_fraction"] >= 0.5
        ]
        views = sorted({*views, best[match.sign_id]})
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
                best[match.sign_id] - span[0],
                (POSE_M, np.radians(POSE_DEG)) if given else None,
            )
        )
    deviations = np.sqrt(np.array([np.diag(c) for c in found]))
    return np.asarray(np.median(deviations, axis=0)[[2, 0, 1]])


def true_step_bound(poses: dict[int, Pose], camera: Camera, frame: int, *, given: bool) -> Array:
    """Best covariance of a true step by 200 ties on the road and beside it."""
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


def simulated_table() -> Iterator[str]:
    """Drives without images, where thousands of signs cost little."""
    yield "## Simulated drives"
    yield ""
    survey = Survey(signs=SIMULATED, seed=5)
    yield (
        f"`wayside simulate`, {survey.signs} signs each: {survey.noise_px} px and {100 * survey.noise_share} % of a "
        f"panel's height for its centre in each image, {100 * survey.face_share:.0f} % of its size common to all of "
        "them. Errors median / 95 %, cm; sigma as stated and bound: medians; fraction within one and two sigma."
    )
    yield ""
    head = [f"{axis}|sigma|bound|within" for axis in ("along", "lateral", "up")]
    yield from heading("drive|placed|" + "|".join(head))
    for name, changed in SIMULATIONS.items():
        one = simulate(replace(survey, **changed))
        cells = [name, f"{len(one.error)} of {one.wanted}"]
        for k in range(3):
            cells.append(pair(*np.quantile(np.abs(one.error[:, k]), [0.5, 0.95]), 100))
            cells += [f"{100 * np.median(v[:, k]):.1f}" for v in (one.sigma, one.bound)]
            one_sigma, two_sigma = (100 * one.fraction_within(n)[k] for n in (1, 2))
            cells.append(f"{one_sigma:.0f} / {two_sigma:.0f} %")
        yield row(cells)
    yield ""


def title() -> list[str]:
    """Head of the page."""
    names = ("wayside", "numpy", "scipy", "opencv-python-headless", "numba")
    made = ", ".join(f"{name} {version(name)}" for name in names)
    return [
        "# Geometry beside its bound and beside a peer",
        "",
        "Made by `benchmarks/geometry.py` on rendered drives with exact truth.",
        "",
        f"Versions: {made}.",
        "",
    ]


if __name__ == "__main__":
    sys.exit(main())
