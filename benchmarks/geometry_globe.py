"""Tables of the geometry benchmark about what stands beside what, and where on the globe."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from geometry_runs import DRIVES, FIXES_ONLY, Array, Run, heading, pair, row, true_poses
from pyproj import Geod
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.frame import Fix, Pose
from wayside.schemas.settings import LandmarkSettings, MotionSettings, ReadSettings
from wayside.stages.georeference import (
    AbsoluteMeasurements,
    Globe,
    LocalOrigin,
    PathPoint,
    RelativeMotionChain,
    align_level,
    georeference,
    smooth,
)

FIX_SIGMA_M, FIX_KEEPS, FIX_NEW_M = 1.0, 0.99, 0.08
"""Errors of the fixes in the rendered logs: of each, what is left of it at the next image, what is new."""
NEXT_M = 80.0
LONG, LONG_DRIVES, LONG_STEP_M, LONG_SPEED = (100, 300, 1000, 3000), 12, 8.0, 20.0
TURN_RAD, SIDE_RAD, LENGTH_M, MEMORY_S = 1e-4, 3e-4, 0.02, 60.0
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def relation_table(runs: list[Run]) -> Iterator[str]:
    """Distances between neighbouring signs, and places on the globe."""
    yield "## Neighbouring signs, and places on the globe"
    yield ""
    yield (
        f"Error of the distance between neighbouring signs (up to {NEXT_M:.0f} m apart), and horizontal error of "
        f"longitude and latitude where fixes exist, median / 95 %, cm. The fixes err by {FIX_SIGMA_M:.0f} m, slowly "
        "varying. Scale: where nothing but fixes tells of lengths, one standard deviation of the scale that they leave "
        "to a drive whose steps are known exactly but for it, as a part of the way to the next sign. Sigma: as stated "
        "with each sign, median of east and north; fraction of the true places within one and two of them, both "
        "together. All signs of a drive share the error of its fixes: a fraction close to all or none is luck."
    )
    yield ""
    yield from heading(
        "drive, what is given|pairs|distance between neighbours|scale|on the globe|sigma|within"
    )
    for one in runs:
        gaps = neighbour_errors(one)
        away, stated = globe_errors(one)
        cells = [f"{one.name}, {one.way}", str(len(gaps)), pair(*_tails(gaps), 100)]
        cells.append(f"{100 * scale_bound(one):.1f}" if one.way == FIXES_ONLY else "-")
        if len(away):
            pulls = np.abs(away / stated)
            cells += [
                pair(*_tails(np.linalg.norm(away, axis=1)), 100),
                f"{100 * np.median(stated):.0f}",
            ]
            cells.append(f"{100 * (pulls < 1).mean():.0f} / {100 * (pulls < 2).mean():.0f} %")
        else:
            cells += ["-"] * 3
        yield row(cells)
    yield ""


def matched(one: Run) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Reported sign and true panel, in the order of the road."""
    stated = {s["sign_id"]: s for s in one.signs}
    panels = {p["id"]: p for p in one.truth["signs"]}
    pairs = [(stated[m.sign_id], panels[m.panel_id]) for m in one.evaluation().matches]
    return sorted(pairs, key=lambda both: both[1]["station_m"])


def neighbour_errors(one: Run) -> Array:
    """Errors of the distance from each sign to the next, metres."""
    found = [
        abs(np.linalg.norm([b[c] - a[c] for c in "xyz"]) - true)
        for (a, true_a), (b, true_b) in pairwise(matched(one))
        if (true := _apart(true_a, true_b)) < NEXT_M
    ]
    return np.array(found)


def globe_errors(one: Run) -> tuple[Array, Array]:
    """Errors of longitude and latitude, east and north (n, 2), and what was stated of them, metres."""
    geod, origin = Geod(ellps="WGS84"), one.truth["origin_wgs84"]
    away, stated = [], []
    for sign, panel in matched(one):
        if sign["lon_deg"] is None:
            continue
        bearing, _, length = geod.inv(origin[1], origin[0], sign["lon_deg"], sign["lat_deg"])
        place = length * np.array([np.sin(np.radians(bearing)), np.cos(np.radians(bearing))])
        away.append(place - panel["centre"][:2])
        stated.append([sign["sigma_east_m"], sign["sigma_north_m"]])
    return np.array(away), np.array(stated)


def scale_bound(one: Run) -> float:
    """Median part of the way to the next sign by which the scale is unsure at best, metres.

    Least squares of shift, turn and scale of the true path, level, under fixes with the errors of the rendered logs.
    """
    path = np.array([f["position"][:2] for f in one.truth["frames"]])
    count = len(path)
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    covariance = FIX_SIGMA_M**2 * FIX_KEEPS**apart + FIX_NEW_M**2 * np.eye(count)
    weight = np.kron(np.eye(2), np.linalg.inv(covariance))
    x, y = (path - path.mean(axis=0)).T
    ones, none = np.ones(count), np.zeros(count)
    jacobian = np.array([[ones, none], [none, ones], [-y, x], [x, y]]).reshape(4, -1).T
    scale = np.sqrt(np.linalg.inv(jacobian.T @ weight @ jacobian)[3, 3])
    ways = [_apart(a, b) for (_, a), (_, b) in pairwise(matched(one))]
    return float(scale * np.median([w for w in ways if w < NEXT_M]))


def log_table() -> Iterator[str]:
    """Poses and fixes of all rendered logs, read without their images: each drive has fixes of its own error."""
    yield "## Where the cameras of all rendered logs are"
    yield ""
    yield (
        "Fixes as recorded, every drive with errors of its own; steps from the true poses with the scatter of those "
        f"that images give ({np.degrees(TURN_RAD):.3f} degrees, {100 * LENGTH_M:.0f} cm), and poses as recorded or "
        "none. Horizontal error of the camera on the globe, median / 95 %, m; sigma: as stated, median; fraction of "
        "east, north and height within one and two sigma at the first, middle and last image; time offsets found and "
        "fixes left out, though there are none."
    )
    yield ""
    yield from heading("what is given|drives|on the globe|sigma|within|time offset|left out")
    for way in ("fixes and spacing", "poses and fixes"):
        away, sigmas, pulls, offsets, out = [], [], [], 0, 0
        for log in sorted(DRIVES.glob("*.mcap")):
            globe, error = on_earth(log, poses=way.startswith("poses"))
            if globe is None:
                continue
            sigma = np.sqrt(np.diagonal(globe.trajectory.covariance[:, :3, :3], axis1=1, axis2=2))
            away.append(np.linalg.norm(error[:, :2], axis=1))
            sigmas.append(sigma[:, :2].ravel())
            pulls.append(np.abs(error / sigma)[[0, len(error) // 2, -1]])
            offsets += globe.trajectory.time_offset_s != 0
            out += globe.trajectory.outliers
        within = [100 * (np.array(pulls) < n).mean() for n in (1, 2)]
        cells = [way, str(len(away)), pair(*_tails(np.concatenate(away)), 1)]
        cells.append(f"{np.median(np.concatenate(sigmas)):.2f}")
        cells += [f"{within[0]:.0f} / {within[1]:.0f} %", str(offsets), str(out)]
        yield row(cells)
    yield ""


def on_earth(log: Path, *, poses: bool) -> tuple[Globe | None, Array]:
    """The cameras of a rendered log on the globe, and their errors east, north, up (n, 3); None without fixes."""
    truth = json.loads(log.with_suffix(".truth.json").read_text())
    settings = ReadSettings(thin_m=0.0, spacing_m=LONG_STEP_M)
    used = [f for f in read_frames(log, settings, ReadReport()) if f.used]
    if not any(f.fix for f in used) or (poses and not any(f.pose for f in used)):
        return None, np.zeros((0, 3))
    every, rng = true_poses(truth), np.random.default_rng(0)
    sigma = np.array([SIDE_RAD * LONG_STEP_M, SIDE_RAD * LONG_STEP_M, LENGTH_M])
    covariance = np.diag([TURN_RAD**2] * 3 + (sigma**2).tolist())
    path, chained = [], every[used[0].index]
    for before, frame in zip([None, *used], used, strict=False):
        if before is not None:
            step = every[frame.index].relative_to(every[before.index])
            slip = Rotation.from_rotvec(rng.normal(0, TURN_RAD, 3)).as_matrix()
            noisy = Pose(slip @ step.rotation, step.centre + rng.normal(size=3) * sigma)
            chained = chained.compose(noisy)
        given = frame.pose if poses else None
        path.append(
            PathPoint(frame.index, chained, given, frame.fix, frame.time_ns, covariance, "straight")
        )
    (laid,) = georeference(iter(path), MotionSettings(), LandmarkSettings())
    globe = laid.globe
    if globe is None:
        return None, np.zeros((0, 3))
    places = [Fix(lat, lon, height, None) for lon, lat, height in globe.route().tolist()]
    local = LocalOrigin(*truth["origin_wgs84"]).local(places)
    return globe, local - np.array([every[f.index].centre for f in used])


def long_table() -> Iterator[str]:
    """Made-up drives of many images: the chain of steps laid over the fixes as one body, and smoothed by them."""
    yield "## Long drives held by fixes"
    yield ""
    yield (
        f"Made-up drives round bends, {LONG_DRIVES} of each length, an image every {LONG_STEP_M:.0f} m at "
        f"{LONG_SPEED:.0f} m/s; steps exact to {np.degrees(TURN_RAD):.3f} degrees and {100 * LENGTH_M:.0f} cm, fixes "
        f"that err by {FIX_SIGMA_M:.0f} m with a memory of {MEMORY_S:.0f} s. Horizontal error of the camera, median / "
        "95 %, m; fraction of east and north within one and two stated standard deviations; error of the way between "
        "neighbouring images as measured and smoothed, RMS, cm."
    )
    yield ""
    yield from heading("images|km|chain laid over the fixes|smoothed|within|steps|smoothed")
    for count in LONG:
        rigid, held, pulls, ways = [], [], [], []
        for seed in range(LONG_DRIVES):
            chain, measured, start, truth = made_up(seed, count)
            found = smooth(chain, measured, *start)
            error = found.centre - truth
            rigid.append(np.linalg.norm((start[1] - truth)[:, :2], axis=1))
            held.append(np.linalg.norm(error[:, :2], axis=1))
            sigma = np.sqrt(np.diagonal(found.covariance[:, :2, :2], axis1=1, axis2=2))
            pulls.append(np.abs(error[:, :2] / sigma))
            true = _steps(truth)
            ways.append([_off(chain.length[1:], true), _off(_steps(found.centre), true)])
        within = [100 * (np.concatenate(pulls) < n).mean() for n in (1, 2)]
        cells = [str(count), f"{count * LONG_STEP_M / 1000:.1f}"]
        cells += [pair(*_tails(np.concatenate(errors)), 1) for errors in (rigid, held)]
        cells.append(f"{within[0]:.0f} / {within[1]:.0f} %")
        cells += [f"{100 * value:.2f}" for value in np.sqrt(np.mean(np.square(ways), axis=0))]
        yield row(cells)
    yield ""


def made_up(
    seed: int, count: int
) -> tuple[RelativeMotionChain, AbsoluteMeasurements, tuple[Array, Array], Array]:
    """Steps and fixes of a drive, the chain of the steps laid over the fixes, and the true path (n, 3)."""
    rng = np.random.default_rng([seed, count])
    station = LONG_STEP_M * np.arange(count)
    bearing = np.cumsum(np.sin(station / 150) * LONG_STEP_M / 250)
    truth = np.zeros((count, 3))
    truth[1:, :2] = np.cumsum(
        LONG_STEP_M * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)[1:], axis=0
    )
    rotation = Rotation.from_rotvec(np.outer(bearing, [0, 0, 1])).as_matrix() @ LEVEL
    back = rotation[:-1].transpose(0, 2, 1)
    turn, step = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    slip = Rotation.from_rotvec(rng.normal(0, TURN_RAD, (count - 1, 3))).as_matrix()
    turn[1:] = slip @ back @ rotation[1:]
    sigma = np.array([SIDE_RAD * LONG_STEP_M, SIDE_RAD * LONG_STEP_M, LENGTH_M])
    step[1:] = (back @ np.diff(truth, axis=0)[:, :, None])[:, :, 0]
    step[1:] += rng.normal(size=(count - 1, 3)) * sigma
    covariance = np.tile(np.diag([TURN_RAD**2] * 3 + (sigma**2).tolist()), (count, 1, 1))
    known = np.full((count, 2), np.nan)
    chain = RelativeMotionChain(
        station / LONG_SPEED, turn, step, covariance, np.zeros(count, bool), known
    )
    keeps = np.exp(-LONG_STEP_M / LONG_SPEED / MEMORY_S)
    correlated = [rng.normal(0, FIX_SIGMA_M, 3)]
    for _ in range(count - 1):
        correlated.append(
            keeps * correlated[-1] + rng.normal(0, FIX_SIGMA_M * np.sqrt(1 - keeps**2), 3)
        )
    new = np.full((count, 3), 0.1 * FIX_SIGMA_M)
    place = truth + correlated + rng.normal(size=(count, 3)) * new
    first = np.radians([5.0, 5.0, 180.0])
    measured = AbsoluteMeasurements(
        np.arange(count),
        place,
        new,
        np.full((count, 3), FIX_SIGMA_M),
        MEMORY_S,
        np.zeros(3),
        None,
        None,
        first,
        np.radians(10.0),
    )
    rotations, centres = [rotation[0]], [truth[0]]
    for k in range(1, count):
        centres.append(centres[-1] + rotations[-1] @ step[k])
        rotations.append(rotations[-1] @ turn[k])
    laid, shift = align_level(np.array(centres), place)
    return chain, measured, (laid @ np.array(rotations), np.array(centres) @ laid.T + shift), truth


def _apart(one: dict[str, Any], other: dict[str, Any]) -> float:
    return float(np.linalg.norm(np.subtract(other["centre"], one["centre"])))


def _steps(centre: Array) -> Array:
    return np.asarray(np.linalg.norm(np.diff(centre, axis=0), axis=1))


def _off(found: Array, true: Array) -> float:
    return float(np.sqrt(np.mean((found - true) ** 2)))


def _tails(values: Array) -> list[float]:
    return np.quantile(values, [0.5, 0.95]).tolist() if len(values) else [np.nan, np.nan]
