"""Landmarks fitted to their views, point, covariance and metric size, and accepted best first."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import TrackSettings
from wayside.stages.kernels import Array, compiled
from wayside.stages.mapping.association import MISSED, Hypotheses, WindowCandidates, associate
from wayside.stages.mapping.triangulation import Views, projected, triangulate
from wayside.stages.mapping.window import WindowFrame, joined

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
LEAST_SUM = -1.0
"""Hypotheses with a smaller sum over their views are dropped, log odds."""


@dataclass(frozen=True, slots=True)
class LandmarkFit:
    """A landmark fitted to its v views, oldest first."""

    frames: NDArray[np.int64]
    """Position of the frame in the window, (v,)."""
    rows: NDArray[np.int64]
    """Number among the followed candidates of that frame, (v,)."""
    used: NDArray[np.bool_]
    """Whether the point was fitted to the view, (v,)."""
    point: Array
    """In the world, by the rays alone, (3,)."""
    covariance: Array
    """Of the point, in the world, (3, 3)."""
    residual_px: Array
    """Of each view, (v,)."""
    depth: Array
    """Of the point in each view, (v,), metres."""
    metric: Array
    """Width and height, (2,), metres."""
    spread: Array
    """Scatter of both over the views, (2,), metres."""
    weight_sigma: Array
    """Standard deviation that each view was weighted by, (v,)."""
    ray_sigma: Array
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

    def views_in(self, window: Sequence[WindowFrame]) -> list[tuple[WindowFrame, int]]:
        """The frames of its views, each with the row of its candidate."""
        views = zip(self.frames.tolist(), self.rows.tolist(), strict=True)
        return [(window[frame], row) for frame, row in views]

    def followed_in(self, window: Sequence[WindowFrame]) -> NDArray[np.void]:
        """Its candidates, (v,), with the columns of `FOLLOWED`."""
        return joined(held.followed[row : row + 1] for held, row in self.views_in(window))


def accept_greedily(
    candidates: WindowCandidates,
    hypotheses: Hypotheses,
    free: NDArray[np.bool_],
    settings: TrackSettings,
    box_sigma: tuple[float, float] = BOX_SIGMA,
) -> list[LandmarkFit]:
    """Landmarks of a window, best first; each removes its candidates from the rest.

    Other boxes on a face make landmarks of their own: which one is the face, all evidence decides
    (`verdicts.same_face`).

    free (N,): candidates of the window that may be used. box_sigma: scatter of the centres of boxes, as `BOX_SIGMA`.
    """
    left = free.copy()
    row, _, value = found = associate(candidates, hypotheses, left, settings.gap_px)
    alive = (found.views() >= settings.fewest_views) & (value > LEAST_SUM)
    fits: list[LandmarkFit] = []
    while alive.any():
        best = int(np.argmax(np.where(alive, value, -np.inf)))
        alive[best] = False
        fit = _fit_hypothesis(candidates, row[best], left, settings, box_sigma)
        if fit is None or fit.value <= LEAST_SUM:
            continue
        fits.append(fit)
        taken = candidates.first[fit.frames] + fit.rows
        left[taken] = False
        again = np.flatnonzero(alive & (row[:, fit.frames] == taken).any(axis=1))
        if len(again):
            found = associate(candidates, hypotheses.select(again), left, settings.gap_px)
            row[again], value[again] = found.row, found.value
            alive[again] = (found.views() >= settings.fewest_views) & (found.value > LEAST_SUM)
    return fits


def _fit_hypothesis(
    candidates: WindowCandidates,
    row: NDArray[np.int32],
    free: NDArray[np.bool_],
    settings: TrackSettings,
    box_sigma: tuple[float, float],
) -> LandmarkFit | None:
    """Fit a landmark to the candidate of each frame or -1 (n,) and associate again, until the views stay the same.

    None where it has too few views, or the rays do not meet ahead.
    """
    rounds = ROUNDS
    while True:
        frames = np.flatnonzero(row >= 0)
        if len(frames) < settings.fewest_views:
            return None
        fit = fit_views(candidates, row[frames].astype(np.int64), frames, box_sigma)
        if fit is None:
            return None
        if rounds == 0:
            break
        one = Hypotheses(fit.point[None], fit.metric[None], np.zeros(1, np.bool_))
        found = associate(candidates, one, free, settings.gap_px)
        if np.array_equal(found.row[0], row):
            break
        row, rounds = found.row[0], rounds - 1
    missed = int((found.state[0] == MISSED).sum())
    side = bool(candidates.back[row[frames[0]]])
    return replace(fit, missed=missed, value=float(found.value[0]), back=side)


def fit_views(
    candidates: WindowCandidates,
    rows: NDArray[np.int64],
    frames: NDArray[np.int64],
    box_sigma: tuple[float, float] = BOX_SIGMA,
) -> LandmarkFit | None:
    """Point, covariance and metric size from views; None where the rays do not meet ahead.

    `rows`, `frames`: candidates (v,) of the window and their frames, ascending. `box_sigma`: scatter of the centres of
    boxes, as `BOX_SIGMA`.
    """
    n = len(rows)
    point, covariance, metric, spread = np.empty(3), np.empty((3, 3)), np.empty(2), np.empty(2)
    residual_px, depth, sigma, own = np.empty((4, n))
    fitted = point, covariance, residual_px, depth, metric, spread, sigma, own
    if not _fit_views(candidates, rows, frames, box_sigma, fitted):
        return None
    used = np.arange(n) >= n - FITTED_VIEWS
    return LandmarkFit(frames, rows - candidates.first[frames], used, *fitted)


@compiled
def _fit_views(
    c: WindowCandidates,
    rows: NDArray[np.int64],
    frames: NDArray[np.int64],
    box_sigma: tuple[float, float],
    fitted: tuple[Array, Array, Array, Array, Array, Array, Array, Array],
) -> bool:
    """Fill the columns of a `LandmarkFit` from its point on; False where the rays do not meet ahead."""
    point, covariance, residual_px, depth, metric, spread, sigma, own = fitted
    for k, f in enumerate(frames):
        own[k] = (box_sigma[0] + box_sigma[1] * (c.size[rows[k], 1] * c.focal[f])) / c.focal[f]
        sigma[k] = np.hypot(own[k], DRIFT_RAD * np.sqrt(frames[-1] - f))
    near, late = rows[-FITTED_VIEWS:], frames[-FITTED_VIEWS:]
    views = Views(c.rotation[late], c.centre[late], c.ray[near], sigma[-FITTED_VIEWS:])
    triangulate(views, point, covariance)
    if not (np.isfinite(point).all() and np.isfinite(covariance).all()):
        return False
    for k, f in enumerate(frames):
        x, y, depth[k] = projected(point, c.rotation[f], c.centre[f])
        u, v = c.ray[rows[k]]
        residual_px[k] = np.hypot((x - u) * c.focal[f], (y - v) * c.focal[f])
    metric[:], spread[:] = metric_size(c.size[rows] * depth.reshape(-1, 1), depth, c.whole[rows])
    return bool(LEAST_M <= depth.min() and depth.max() <= PARALLEL_M)


@compiled
def metric_size(sizes: Array, depth: Array, whole: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Median width and height (2,) over the nearest views, and their scatter (2,), metres.

    Views cut by the edge of the image are left out where others exist.
    """
    order = np.argsort(depth, kind="mergesort")
    best = order[whole[order]]
    near = sizes[(best if len(best) else order)[:SIZE_VIEWS]]
    middle, scatter = np.empty(2), np.empty(2)
    for j in range(2):
        middle[j] = np.median(near[:, j])
        off = MAD_TO_SIGMA * np.median(np.abs(near[:, j] - middle[j]))
        scatter[j] = max(off, LEAST_SPREAD * middle[j])
    return middle, scatter
