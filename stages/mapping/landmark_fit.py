"""Landmarks fitted to their views, point, covariance and metric size, and accepted best first."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import TrackSettings
from wayside.stages.geometry import median_of_few
from wayside.stages.kernels import Array
from wayside.stages.mapping.association import MISSED, Hypotheses, WindowCandidates, associate
from wayside.stages.mapping.triangulation import triangulate_views

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
    seen: NDArray[np.void]
    """Those candidates, (v,), with the columns of `window.FOLLOWED`."""
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
    missed, back = int((found.state[0] == MISSED).sum()), bool(fit.seen["back"][0])
    return replace(fit, missed=missed, value=float(found.value[0]), back=back)


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
    c, focal, seen = candidates, candidates.focal[frames], candidates.table[rows]
    own = (box_sigma[0] + box_sigma[1] * (seen["size"][:, 1] * focal)) / focal
    sigma = np.hypot(own, DRIFT_RAD * np.sqrt(frames[-1] - frames))
    late, rays = frames[-FITTED_VIEWS:], seen["ray"]
    point, covariance = triangulate_views(
        c.rotation[late], c.centre[late], rays[-FITTED_VIEWS:], sigma[-FITTED_VIEWS:]
    )
    if not (np.isfinite(point).all() and np.isfinite(covariance).all()):
        return None
    x, y, depth = ((point - c.centre[frames])[:, :, None] * c.rotation[frames]).sum(axis=1).T
    if not (depth.min() >= LEAST_M and depth.max() <= PARALLEL_M):
        return None
    u, v = rays.T
    residual_px = np.hypot((x / depth - u) * focal, (y / depth - v) * focal)
    metric, spread = metric_size(seen["size"] * depth[:, None], depth, seen["whole"])
    used = np.arange(len(rows)) >= len(rows) - FITTED_VIEWS
    views = frames, rows - c.first[frames], seen, used
    return LandmarkFit(*views, point, covariance, residual_px, depth, metric, spread, sigma, own)


def metric_size(sizes: Array, depth: Array, whole: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Median width and height (2,) over the nearest views, and their scatter (2,), metres.

    Views cut by the edge of the image are left out where others exist.
    """
    order = np.argsort(depth, kind="stable")
    best = order[whole[order]]
    near = sizes[(best if len(best) else order)[:SIZE_VIEWS]].T
    middle = median_of_few(near)
    scatter = MAD_TO_SIGMA * median_of_few(np.abs(near - middle[:, None]))
    return middle, np.maximum(scatter, LEAST_SPREAD * middle)
