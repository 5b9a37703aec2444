"""A landmark fitted to its views: point, covariance, metric size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.stages.mapping.association import (
    MISSED,
    WindowCandidates,
    associate,
)
from wayside.stages.mapping.triangulation import POINT_ITERATIONS, triangulate_views

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of normal errors."""
# Set on the development drives, where no other reason is given.
BOX_SIGMA = (1.0, 0.02)
"""Scatter of the centre of a box: px, and heights added to it, since some boxes follow the inner field of a face."""
DRIFT_RAD = 2.5e-4
"""Scatter of a ray, rad, times the root of the frames to the nearest view: chained motion."""
FITTED_VIEWS = 8
"""Nearest views that the point is fitted to: more add nothing (measured)."""
LEAST_M, PARALLEL_M = 1.0, 1000.0
"""Depths at which rays meet, m: no panel is nearer, and rays that meet farther are parallel."""
SIZE_VIEWS = 6
"""Nearest views whose median is the size."""
LEAST_SPREAD = 0.02
"""Least scatter of the size, by the size."""
ROUNDS = 3
"""Fits of a hypothesis to its views before the last one, at most."""


@dataclass(frozen=True, slots=True)
class LandmarkFit:
    """A landmark fitted to its v views, oldest first."""

    frames: NDArray[np.int64]
    """Position of the frame in the window, (v,)."""
    rows: NDArray[np.int64]
    """Number among the followed candidates of that frame, (v,)."""
    used: NDArray[np.bool_]
    """Whether the point was fitted to the view, (v,)."""
    point: NDArray[np.float64]
    """In the world, by the rays alone, (3,)."""
    covariance: NDArray[np.float64]
    """Of the point, in the world, (3, 3)."""
    residual_px: NDArray[np.float64]
    """Of each view, (v,)."""
    depth: NDArray[np.float64]
    """Of the point in each view, (v,), metres."""
    metric: NDArray[np.float64]
    """Width and height, (2,), metres."""
    spread: NDArray[np.float64]
    """Scatter of both over the views, (2,), metres."""
    weight_sigma: NDArray[np.float64]
    """Standard deviation that each view was weighted by, (v,)."""
    ray_sigma: NDArray[np.float64]
    """Standard deviation of its ray alone, (v,)."""
    missed: int = 0
    """Number of frames that should show it and have no candidate there."""
    value: float = 0.0
    """Sum over the views."""
    back: bool = False
    """Whether it is followed as the back of a panel."""

    @property
    def rms_px(self) -> float:
        """RMS of the residuals of the views that were used."""
        return float(np.sqrt((self.residual_px[self.used] ** 2).mean()))


def fit_hypothesis(
    candidates: WindowCandidates,
    row: NDArray[np.int32],
    free: NDArray[np.bool_],
    gap_px: float,
    *,
    fewest: int,
    box_sigma: tuple[float, float] = BOX_SIGMA,
) -> LandmarkFit | None:
    """Fit a landmark to its views and associate again, in turn, until the views stay the same.

    Parameters
    ----------
    candidates, free, gap_px
        As in `associate`.
    row
        Candidate of each frame or -1, (n,).
    fewest
        Views that it needs; with fewer there is no landmark (None), nor where the rays do not meet ahead.
    box_sigma
        Scatter of the centres of boxes, as `BOX_SIGMA`.
    """
    rounds = ROUNDS
    while True:
        frames = np.flatnonzero(row >= 0)
        if len(frames) < fewest:
            return None
        fit = fit_views(candidates, row[frames].astype(np.int64), frames, box_sigma=box_sigma)
        if fit is None:
            return None
        if rounds == 0:
            break
        found = associate(candidates, fit.point[None], fit.metric[None], free, gap_px)
        if np.array_equal(found.row[0], row):
            break
        row, rounds = found.row[0], rounds - 1
    missed = int((found.state[0] == MISSED).sum())
    return replace(fit, missed=missed, value=float(found.value[0]))


def fit_views(
    candidates: WindowCandidates,
    rows: NDArray[np.int64],
    frames: NDArray[np.int64],
    *,
    box_sigma: tuple[float, float] = BOX_SIGMA,
    nearest: int = FITTED_VIEWS,
    iterations: int = POINT_ITERATIONS,
) -> LandmarkFit | None:
    """Point, covariance and metric size from views; None where the rays do not meet ahead.

    Parameters
    ----------
    candidates
        The window.
    rows, frames
        Candidates (v,) of the window and their frames, ascending.
    box_sigma
        Scatter of the centres of boxes, as `BOX_SIGMA`.
    nearest
        The point is fitted to so many of the latest views.
    iterations
        Of the fit of the point at most.
    """
    c = candidates
    tall_px = c.size[rows, 1] * c.focal[frames]
    used = np.zeros(len(rows), bool)
    used[np.argsort(-frames, kind="stable")[:nearest]] = True
    own = (box_sigma[0] + box_sigma[1] * tall_px) / c.focal[frames]
    sigma = np.hypot(own, DRIFT_RAD * np.sqrt(frames.max() - frames))
    point, covariance = triangulate_views(
        c.rotation[frames[used]], c.centre[frames[used]], c.ray[rows[used]], sigma[used], iterations
    )
    if not np.isfinite(point).all() or not np.isfinite(covariance).all():
        return None
    local = np.einsum("ni,nij->nj", point - c.centre[frames], c.rotation[frames])
    depth = local[:, 2]
    if depth.min() < LEAST_M or depth.max() > PARALLEL_M:
        return None
    gap = (local[:, :2] / depth[:, None] - c.ray[rows]) * c.focal[frames][:, None]
    residual = np.hypot(gap[:, 0], gap[:, 1])
    metric, spread = metric_size(c.size[rows] * depth[:, None], depth, c.whole[rows])
    return LandmarkFit(
        frames,
        rows - c.first[frames],
        used,
        point,
        covariance,
        residual,
        depth,
        metric,
        spread,
        sigma,
        own,
    )


def metric_size(
    sizes: NDArray[np.float64],
    depth: NDArray[np.float64],
    whole: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median width and height (2,) over the nearest views, and their scatter (2,), metres.

    Views cut by the edge of the image are left out where others exist.
    """
    order = np.argsort(depth, kind="stable")
    best = order[whole[order]]
    near = sizes[(best if len(best) else order)[:SIZE_VIEWS]]
    middle = np.median(near, axis=0)
    scatter = MAD_TO_SIGMA * np.median(np.abs(near - middle), axis=0)
    return middle, np.maximum(scatter, LEAST_SPREAD * middle)
