"""A place adjusted together with the frames that saw it: poses, tie points and the place at once (report chapter 8).

Two-view motion is chained step by step, so its errors add up over the way that a sign is seen. Over a window of
frames, ties that go on from step to step compare the steps: lengths average, directions must agree. The pose of the
frame the place is reported in is held (the gauge); the known lengths of the steps give the scale.

What makes the errors small is which ties count. Patches on markings slide along them, the more the less texture they
have across, and confirm the motion they were sought by: those are left out. Ties that go a long way through the picture
err by a share of it: they weigh less. Those that follow vehicles lose their weight by the robust cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.motion import StepPrior
from wayside.stages.geometry import rays_of_ideal
from wayside.stages.kernels import Array
from wayside.stages.mapping.bundle_adjustment import adjust_window
from wayside.stages.mapping.residuals import QUADRATIC, Links, Rows
from wayside.stages.mapping.tie_tracks import link_tracks, spread_tracks
from wayside.stages.mapping.triangulation import CAUCHY
from wayside.stages.mapping.window import WindowFrame
from wayside.stages.odometry import (
    REGISTERED_SIGMA_PX,
    SHARED_REACH_PX,
    shared_by_picture,
    shared_sigma_px,
)

MOST_FRAMES, FEWEST_SHARE = 8, 0.5
"""Longest window; where it holds a smaller share of the views, the chain of all of them says more."""
CELL_PX = 70.0
"""Of the ties of a step one is kept in each cell of the later picture, those of the longest tracks first."""
SLIDING_PX = 0.12
"""Ties that may slide further along the edges of their patches are left out."""
WAY_SHARE = 0.002
"""What a tie's way through the picture adds to its scatter, as a share of the way (measured)."""
TIE_SCALE, ASTRAY = 1.0, 4.0
"""Sigmas where the cost of a tie starts to flatten, and from which it counts as astray."""
ROBUST_SHARE = 0.85
"""Variance of normal errors under these robust costs, as a share of what the weights left to them say: .83 for sights,
.86 for ties, by integrals over the normal law."""
ANCHOR_SIGMA_PX = 0.01
"""A track is the very point that its first corner shows: its neighbours would do as well."""
NEAREST_M, FARTHEST_M = 1.0, 2000.0


class Sighted(NamedTuple):
    """What was measured of a place: frames of the window (v,), rays (v, 2) and their sigma (v,)."""

    frames: NDArray[np.int64]
    rays: Array
    sigma: Array


class Joint(NamedTuple):
    """A place (3,) in the world; covariance (3, 3) relative to the held camera, world axes; tracks kept and astray."""

    point: Array
    covariance: Array
    tracks: int
    astray: int


class _Tied(NamedTuple):
    """Ties of one step or several, one a row: step, corners of both frames (n, 2), rays in both, warp (n, 3), depth.

    depth (n,): in the earlier frame, m; place, way (n, 2), (n,): px in the later picture, and through it by travel.
    """

    step: NDArray[np.int64]
    corners: NDArray[np.int64]
    source: Array
    target: Array
    warp: Array
    depth: Array
    place: Array
    way: Array

    def of(self, rows: NDArray[np.int64]) -> _Tied:
        """Some of the rows."""
        return _Tied._make(np.ascontiguousarray(column[rows]) for column in self)


def adjust_together(
    held: Sequence[WindowFrame], best: int, sighted: Sighted, point: Array
) -> Joint | None:
    """Adjust a place with the motion round it.

    None where nothing is known of that motion beforehand, or most of the views are too far off.

    Parameters
    ----------
    held
        Frames with their motion; poses in one world.
    best
        The frame the place is reported in: its pose is held.
    sighted
        What was measured of the place.
    point
        Where it is thought to be, (3,).
    """
    first, last = window_round(best, sighted.frames)
    window = held[first : last + 1]
    priors = [h.motion.prior for h in window[1:]]
    known = [p for p in priors if p is not None]
    inside = (sighted.frames >= first) & (sighted.frames <= last)
    if len(known) < len(priors) or inside.sum() < max(2, FEWEST_SHARE * len(inside)):
        return None
    home, focal = held[best].motion.pose, window[0].focal
    poses = [h.motion.pose.relative_to(home) for h in window]
    tied, track = well_spread(ties_of(window))
    start, anchors = track_starts(tied, track)
    count, seen = len(anchors), int(inside.sum())
    sigma = np.hypot(registered_sigma_px(tied), WAY_SHARE * tied.way)
    rows = Rows.joined(
        [
            Rows.sights(
                sighted.frames[inside] - first,
                np.zeros(seen, np.int64),
                sighted.rays[inside],
                sighted.sigma[inside],
                CAUCHY,
            ),
            Rows.sights(
                anchors,
                np.arange(1, count + 1, dtype=np.int64),
                start[:, :2],
                np.full(count, ANCHOR_SIGMA_PX / focal),
                QUADRATIC,
            ),
            tie_rows(tied, track + 1, sigma / focal),
        ]
    )
    x, y, z = home.to_camera(point)
    found = adjust_window(
        np.stack([p.rotation for p in poses]),
        np.stack([p.centre for p in poses]),
        best - first,
        np.vstack([[x / z, y / z, 1 / z], start]),
        np.concatenate([[best - first], anchors]),
        rows,
        links_of(known, common=any(h.motion.source == "fixes" for h in window[1:])),
    )
    if not np.isfinite(found.covariance).all():
        return None
    shared = shared_errors(tied, found.gain[seen + count :] / focal)
    covariance = ROBUST_SHARE * found.covariance + shared
    astray = np.unique(track[found.squares[seen + count :] > ASTRAY**2])
    turn = home.rotation
    return Joint(home.to_world(found.place), turn @ covariance @ turn.T, count, len(astray))


def window_round(best: int, frames: NDArray[np.int64]) -> tuple[int, int]:
    """First and last of at most `MOST_FRAMES` consecutive frames with the best and those nearest to it."""
    first = last = best
    for frame in sorted(frames.tolist(), key=lambda f: abs(f - best)):
        low, high = min(first, frame), max(last, frame)
        if high - low < MOST_FRAMES:
            first, last = low, high
    return first, last


def links_of(priors: Sequence[StepPrior], *, common: bool) -> Links:
    """What is known of the steps of a window, each from one frame to the next.

    common: their lengths were carried on from each other, so they are wrong alike, and no better for being many.
    """
    numbers = np.arange(len(priors), dtype=np.int64)
    alike = np.sqrt(len(priors)) if common else 1.0
    return Links(
        np.column_stack([numbers, numbers + 1]),
        np.array([p.rotation for p in priors], np.float64).reshape(-1, 3, 3),
        np.array([p.sigma_rotation for p in priors], np.float64),
        np.array([p.direction for p in priors], np.float64).reshape(-1, 3),
        np.array([p.sigma_direction for p in priors], np.float64).reshape(-1, 2),
        np.array([p.halfway for p in priors], np.bool_),
        np.array([p.length_m for p in priors], np.float64),
        np.array([p.sigma_m * alike for p in priors], np.float64),
    )


def ties_of(window: Sequence[WindowFrame]) -> _Tied:
    """Ties of all steps of a window that agree with their motion and do not slide."""
    parts = [_NO_TIES]
    for k in range(1, len(window)):
        motion, before, now = window[k].motion, window[k - 1].frame.camera, window[k].frame.camera
        ties, pose = motion.ties, motion.step
        if ties is None or pose is None or before is None or now is None:
            continue
        if ties.rows is None or ties.warp is None or ties.sigma_px is None:
            continue
        good = ties.inlier & (ties.sigma_px < SLIDING_PX)
        source = rays_of_ideal(before, ties.previous[good])
        target = rays_of_ideal(now, ties.current[good])
        far = source @ pose.rotation[:2] + pose.rotation[2]
        way = np.linalg.norm(target - far[:, :2] / far[:, 2:], axis=1) * window[k].focal
        parts.append(
            _Tied(
                np.full(len(source), k - 1),
                ties.rows[good],
                source,
                target,
                ties.warp[good],
                pose.to_world(ties.point[good])[:, 2],
                ties.current[good],
                way,
            )
        )
    return _Tied(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def well_spread(tied: _Tied) -> tuple[_Tied, NDArray[np.int64]]:
    """The ties to keep, and the number of the track of each, from 0."""
    track = link_tracks(tied.step, tied.corners)
    cell = np.floor(tied.place / CELL_PX).astype(np.int64)
    rows = np.flatnonzero(spread_tracks(track, tied.step, cell))
    _, numbers = np.unique(track[rows], return_inverse=True)
    return tied.of(rows), numbers.astype(np.int64)


def track_starts(tied: _Tied, track: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Coordinates (p, 3) of each track in the frame (p,) that it starts in: ray and inverse depth."""
    _, first = np.unique(track, return_index=True)
    depth = np.nan_to_num(tied.depth[first], nan=FARTHEST_M)
    inverse = 1 / np.clip(depth, NEAREST_M, FARTHEST_M)
    return np.column_stack([tied.source[first], inverse]), tied.step[first]


def registered_sigma_px(tied: _Tied) -> Array:
    """Scatter (n,) of the registered place by the noise of both pictures, the earlier one's as large as it grows."""
    growth = (tied.warp[:, 0] ** 2 + tied.warp[:, 2] ** 2) / 2
    return np.asarray(REGISTERED_SIGMA_PX * np.sqrt(1 + growth))


def tie_rows(tied: _Tied, point: NDArray[np.int64], sigma: Array) -> Rows:
    """Residuals of ties of these points with these sigmas."""
    return Rows(
        np.column_stack([tied.step, tied.step + 1]),
        point,
        tied.source,
        tied.target,
        tied.warp,
        sigma,
        np.full(len(point), TIE_SCALE),
    )


def shared_errors(tied: _Tied, gain: Array) -> Array:
    """What must be added to the covariance (3, 3) of a place for errors that neighbouring ties share.

    gain (n, 2, 3): how an error of each tie moves the place, m / px. The share of the way that the ties were weighted
    by as if each erred by itself is part of that error, so it is taken out again.
    """
    shared = shared_sigma_px(tied.way)[:, None, None] * gain
    alone = (WAY_SHARE * tied.way)[:, None, None] * gain
    counted: Array = np.einsum("nik,nim->km", alone, alone)
    return shared_by_picture(tied.place, tied.step, shared, SHARED_REACH_PX) - counted


_NO_TIES = _Tied(
    np.zeros(0, np.int64),
    np.zeros((0, 2), np.int64),
    np.zeros((0, 2)),
    np.zeros((0, 2)),
    np.zeros((0, 3)),
    np.zeros(0),
    np.zeros((0, 2)),
    np.zeros(0),
)
