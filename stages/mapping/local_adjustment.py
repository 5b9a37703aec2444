"""A landmark adjusted together with the frames that observed it: poses, tie points and landmark (report chapter 8).

Two-view motion is chained step by step, so its errors add up over the frames in which a sign is seen. Over a window of
frames, ties of consecutive steps that share a corner form tracks, which constrain the steps against each other: in
length and in direction. The pose of the frame the landmark is reported in is fixed (the gauge); the known lengths of
the steps fix the scale.

Which ties count decides the accuracy. Patches on markings slide along them, the more the less texture they have
across, and confirm the motion they were predicted by: those are left out. Ties of a long displacement in the image have
an error in proportion to it: they weigh less. Ties on vehicles lose their weight by the robust cost.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.measurement import WindowResidual
from wayside.schemas.motion import ROUGH_LENGTHS
from wayside.stages.adjustment import (
    ANCHOR_SIGMA_PX,
    DISPLACEMENT_SIGMA,
    FARTHEST_TIE_M,
    NEAREST_TIE_M,
    NO_TIES,
    QUADRATIC,
    TIE_ERRORS,
    TIE_SCALE,
    WINDOW_ITERATIONS,
    ResidualBlocks,
    StepConstraints,
    StepTies,
    Window,
    adjust_window,
    correlated_covariance,
    correlated_sigma_px,
    link_tracks,
    select_tracks,
    ties_of_step,
)
from wayside.stages.kernels import Array
from wayside.stages.mapping.panel import Panel
from wayside.stages.mapping.triangulation import CAUCHY_SIGMAS
from wayside.stages.mapping.window import WindowFrame

MOST_FRAMES = 8
"""Longest window."""
VIEWS_INSIDE = 0.5
"""A window with a smaller fraction of the views is left to the chain of all."""
CELL_PX = 70.0
"""One tie is kept in each cell of this size, longest tracks first."""
VARIANCE_FACTOR = 0.85
"""Variance of normal errors under the robust costs, by the weights: 0.83 for rays, 0.86 for ties (integrals)."""
WINDOW_GAIN = 3e-3
"""The adjustment of a window ends where an iteration lowers the cost by a smaller fraction: 90 % within 0.1 sigma."""


class LandmarkMeasurement(NamedTuple):
    """A measured landmark."""

    point: Array
    """In the world, (3,)."""
    covariance: Array
    """Of the point relative to the camera that it is reported in, world axes, (3, 3)."""
    panel: Panel
    """The panel it was measured by."""
    residual: WindowResidual | None = None
    """Of its adjustment. None: there was none."""


def adjust_jointly(
    held: Sequence[WindowFrame], best: int, panel: Panel
) -> LandmarkMeasurement | None:
    """Adjust a landmark, measured as a panel, with the motion of the frames around it, whose poses are in one world.

    The pose of frame `best`, which the landmark is reported in, is fixed. None where there is no prior of that motion,
    or most of the views are outside the window.
    """
    first, last = window_around(best, panel.frames, MOST_FRAMES)
    window = held[first : last + 1]
    priors = [h.motion.prior for h in window[1:]]
    known = [p for p in priors if p is not None]
    inside = (panel.frames >= first) & (panel.frames <= last)
    views = int(inside.sum())
    if len(known) < len(priors) or views < max(2, VIEWS_INSIDE * len(inside)):
        return None
    home, focal = held[best].motion.pose, window[0].focal
    poses = [h.motion.pose.relative_to(home) for h in window]
    ties, track = distributed_ties(window)
    start, anchors = track_starts(ties, track)
    landmark, numbers = np.zeros(views, np.int64), panel.frames[inside] - first
    rays, sigma = panel.rays[inside], panel.ray_sigma[inside]
    seen = ResidualBlocks.observations(numbers, landmark, rays, sigma, CAUCHY_SIGMAS)
    rows = ResidualBlocks.joined([seen, *_tie_blocks(ties, track, (start, anchors), focal)])
    x, y, z = home.to_camera(panel.point)
    found = adjust_window(
        Window(
            np.stack([p.rotation for p in poses]),
            np.stack([p.centre for p in poses]),
            best - first,
            np.vstack([[x / z, y / z, 1 / z], start]),
            np.concatenate([[best - first], anchors]),
        ),
        rows,
        StepConstraints.of(known, common=any(h.motion.source in ROUGH_LENGTHS for h in window[1:])),
        iterations=WINDOW_ITERATIONS,
        gain=WINDOW_GAIN,
    )
    if not np.isfinite(found.covariance).all():
        return None
    shared = shared_errors(ties, found.gain[views + len(anchors) :] / focal)
    covariance = VARIANCE_FACTOR * found.covariance + shared
    rotation, position = home.rotation, home.to_world(found.position)
    history = np.sqrt(found.history / (2 * len(rows.point)))
    ends = (window[0].frame.index, window[-1].frame.index)
    residual = WindowResidual(*ends, tuple(history.tolist()), panel.point, position)
    return LandmarkMeasurement(position, rotation @ covariance @ rotation.T, panel, residual)


def _tie_blocks(
    ties: StepTies, track: NDArray[np.int64], starts: tuple[Array, NDArray[np.int64]], focal: float
) -> tuple[ResidualBlocks, ResidualBlocks]:
    """Rows of the starts of tracks, and of the ties; point 0 is the landmark."""
    start, anchors = starts
    sigma = ties.scatter * np.hypot(
        # noise of both images, that of the earlier one magnified
        TIE_ERRORS.sigma_px * np.sqrt(1 + (ties.warp[:, 0] ** 2 + ties.warp[:, 2] ** 2) / 2),
        DISPLACEMENT_SIGMA * ties.displacement_px,
    )
    points = np.arange(1, len(anchors) + 1, dtype=np.int64)
    anchor_sigma = np.full(len(anchors), ANCHOR_SIGMA_PX / focal)
    return (
        ResidualBlocks.observations(anchors, points, start[:, :2], anchor_sigma, QUADRATIC),
        ResidualBlocks(
            np.column_stack([ties.step, ties.step + 1]),
            track + 1,
            ties.source,
            ties.target,
            ties.warp,
            sigma / focal,
            np.full(len(track), TIE_SCALE),
        ),
    )


def window_around(best: int, frames: NDArray[np.int64], most: int) -> tuple[int, int]:
    """First and last of at most so many consecutive frames with the best one and those nearest to it."""
    first = last = best
    for frame in sorted(frames.tolist(), key=lambda f: abs(f - best)):
        low, high = min(first, frame), max(last, frame)
        if high - low < most:
            first, last = low, high
    return first, last


def distributed_ties(window: Sequence[WindowFrame]) -> tuple[StepTies, NDArray[np.int64]]:
    """Ties of all steps that agree with their motion, evenly over the image, and the number of the track of each."""
    pairs = enumerate(pairwise(window))
    steps = (ties_of_step(k, b.motion, a.camera, b.camera, inliers=True) for k, (a, b) in pairs)
    ties = StepTies.joined([NO_TIES, *steps])
    track = link_tracks(ties.step, ties.corners)
    cell = np.floor(ties.pixel / CELL_PX).astype(np.int64)
    rows = np.flatnonzero(select_tracks(track, ties.step, cell))
    _, numbers = np.unique(track[rows], return_inverse=True)
    return ties.select(rows), numbers.astype(np.int64)


def track_starts(ties: StepTies, track: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Coordinates (p, 3) of each track in the frame (p,) where it starts: ray and inverse depth."""
    _, first = np.unique(track, return_index=True)
    depth = np.nan_to_num(ties.place[first, 2], nan=FARTHEST_TIE_M)
    inverse = 1 / np.clip(depth, NEAREST_TIE_M, FARTHEST_TIE_M)
    return np.column_stack([ties.source[first], inverse]), ties.step[first]


def shared_errors(ties: StepTies, gain: Array) -> Array:
    """Covariance (3, 3) to add to that of a landmark for errors that neighbouring ties share.

    `gain` (n, 2, 3): derivative of the landmark by the error of each tie, m / px. The weights counted the part of the
    scatter that is a fraction of the displacement as independent. It is in the shared error, and its independent part
    is subtracted here.
    """
    displacement, gain = ties.displacement_px, ties.scatter[:, None, None] * gain
    shared = correlated_sigma_px(displacement)[:, None, None] * gain
    alone = (DISPLACEMENT_SIGMA * displacement)[:, None, None] * gain
    counted: Array = np.einsum("nik,nim->km", alone, alone)
    return correlated_covariance(ties.pixel, ties.step, shared, TIE_ERRORS.reach_px) - counted
