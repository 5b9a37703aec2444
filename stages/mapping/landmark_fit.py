"""Landmarks fitted to their views, point, covariance and metric size, and accepted best first."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import TrackSettings
from wayside.stages.kernels import Array, Numbers, compiled, compiled_within, require_array
from wayside.stages.mapping.association import (
    LEAST_SUM,
    Association,
    Hypotheses,
    WindowCandidates,
    associate_free,
)
from wayside.stages.mapping.triangulation import Views, projected, solve_point

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of normal errors."""
# Set on the development drives, where no other reason is given.
BOX_SIGMA = (1.0, 0.02)
"""Scatter of the centre of a box: px, and heights added to it, since some boxes follow the inner field of a face."""
DRIFT_RAD = 2.5e-4
"""Scatter of a ray, rad, times the root of the frames to the nearest view: chained motion."""
FITTED_VIEWS = 8
"""Nearest views that the point is fitted to: more add nothing (measured; the drives are not on record)."""
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
    """Position of the frame of each view in the window, (v,)."""
    rows: NDArray[np.int64]
    """Number of each view among the followed candidates of its frame, (v,)."""
    seen: NDArray[np.void]
    """Those candidates, (v,), with the columns of `window.FOLLOWED`."""
    used: NDArray[np.bool_]
    """Whether the point was fitted to the view, (v,)."""
    point: Array
    """Position by the rays alone, (3,), world, m."""
    covariance: Array
    """Of the point, (3, 3), world, m^2."""
    residual_px: Array
    """Distance of the point from the view, (v,), px."""
    depth: Array
    """Of the point in each view, (v,), m."""
    metric: Array
    """Width and height, (2,), m."""
    spread: Array
    """Scatter of width and height over the views, (2,), m."""
    weight_sigma: Array
    """Standard deviation by which each view was weighted, (v,), rad."""
    ray_sigma: Array
    """Standard deviation of the ray of each view alone, (v,), rad."""
    missed: int
    """Number of frames that should show it and have no candidate there."""
    value: float
    """Sum over the views, log odds."""
    back: bool
    """Whether it is followed as the back of a panel."""

    @property
    def rms_px(self) -> float:
        """RMS of the residuals of the views that were used."""
        return float(np.sqrt((self.residual_px[self.used] ** 2).mean()))


class _Fit(NamedTuple):
    """Hypotheses in the kernels, or one: row (n,), as found again, views (4, n): residual, depth, sigmas."""

    row: NDArray[np.int32]
    found: Association
    views: Array
    point: Array
    covariance: Array
    metric: Array
    spread: Array


def accept_greedily(
    candidates: WindowCandidates,
    hypotheses: Hypotheses,
    free: NDArray[np.bool_],
    settings: TrackSettings,
    box_sigma: tuple[float, float] = BOX_SIGMA,
) -> list[LandmarkFit]:
    """Landmarks of a window, best first; each removes its candidates from the rest.

    They are fitted and associated again until their views stay the same. Those that have too few views, or whose rays
    do not meet ahead, are left out. Other boxes on a face make landmarks of their own: which one is the face, all
    evidence decides (`verdicts.same_face`).

    free (N,): candidates of the window that may be used. box_sigma: scatter of the centres of boxes, as `BOX_SIGMA`.
    Raises ValueError where `free` has another length: the kernels check no bounds.
    """
    require_array(free, "free", np.bool_, candidates.table.shape)
    m, n = len(hypotheses), len(candidates.rotation)
    found = Association(np.empty((m, n), np.int32), np.empty(m, np.int64), np.empty(m))
    where, shapes = (hypotheses.point, hypotheses.size), ((4, n), (1, 3), (3, 3), (1, 2), (2,))
    associate_free(candidates, *where, free, settings.gap_px, found)
    again = Association(found.row[:, None], found.missed[:, None], found.value[:, None])
    fit = _Fit(np.empty((m, n), np.int32), again, *(np.empty((m, *shape)) for shape in shapes))
    limits, fits = (settings.fewest_views, settings.gap_px, box_sigma), list[LandmarkFit]()
    points, sizes = (one[:, None] for one in where)
    for k in _accept(candidates, points, sizes, free.copy(), *limits, fit).tolist():
        frames = np.flatnonzero(fit.row[k] >= 0)
        rows, count = fit.row[k, frames].astype(np.int64), len(frames)
        seen, used = candidates.table[rows], np.arange(count) >= count - FITTED_VIEWS
        residual_px, depth, weight_sigma, ray_sigma = fit.views[k, :, :count].copy()
        views = frames, rows - candidates.first[frames], seen, used
        fitted = fit.point[k, 0], fit.covariance[k], residual_px, depth, fit.metric[k, 0]
        total = found.missed.item(k), found.value.item(k), bool(seen["back"][0])
        fits.append(LandmarkFit(*views, *fitted, fit.spread[k], weight_sigma, ray_sigma, *total))
    return fits


@compiled
def _accept(
    c: WindowCandidates,
    points: Array,
    sizes: Array,
    free: NDArray[np.bool_],
    fewest: int,
    gap_px: float,
    box_sigma: tuple[float, float],
    fits: _Fit,
) -> Numbers:
    """Fit hypotheses, best first, and associate those again that lose a candidate to one; numbers of those that fit."""
    found, (m, n), count = fits.found, fits.row.shape, 0
    order, value = np.empty(m, np.int64), found.value.copy()
    while count < m:
        best = np.argmax(value)
        if value[best, 0] <= LEAST_SUM:
            break
        value[best, 0] = -np.inf
        row = fits.row[best]
        own = Association(found.row[best], found.missed[best], found.value[best])
        shown = fits.views[best], fits.point[best], fits.covariance[best]
        fit = _Fit(row, own, shown[0], shown[1], shown[2], fits.metric[best], fits.spread[best])
        row[:] = own.row[0]
        if not _fit(c, free, fewest, gap_px, box_sigma, fit) or own.value[0] <= LEAST_SUM:
            continue
        order[count] = best
        count += 1
        free[row[row >= 0]] = False
        for k in range(m):
            shared = 0
            for frame in range(n):
                shared += row[frame] >= 0 and found.row[k, 0, frame] == row[frame]
            if shared and value[k, 0] > LEAST_SUM:
                own = Association(found.row[k], found.missed[k], found.value[k])
                associate_free(c, points[k], sizes[k], free, gap_px, own)
                value[k, 0] = own.value[0]
    return order[:count]


@compiled_within
def _fit(
    c: WindowCandidates,
    free: NDArray[np.bool_],
    fewest: int,
    gap_px: float,
    box_sigma: tuple[float, float],
    fit: _Fit,
) -> bool:
    row, again = fit.row, fit.found.row[0]
    for rounds in range(ROUNDS + 1):
        if not _fit_views(c, fewest, box_sigma, fit):
            return False
        if rounds < ROUNDS:
            associate_free(c, fit.point, fit.metric, free, gap_px, fit.found)
        same = True
        for frame in range(row.size):
            same &= row[frame] == again[frame]
            row[frame] = again[frame]
        if same:
            break
    return True


@compiled_within
def _fit_views(c: WindowCandidates, fewest: int, box_sigma: tuple[float, float], fit: _Fit) -> bool:
    """Fit the point to the latest views, and the size to those that are whole, or to any; whether it can be done."""
    rays, sizes, whole = c.ray, c.table["size"], c.table["whole"]
    frames, point, near = np.flatnonzero(fit.row >= 0), fit.point[0], np.empty((2, SIZE_VIEWS))
    n, count, cut = len(frames), 0, True
    if n < fewest:
        return False
    late, seen = max(0, n - FITTED_VIEWS), np.empty((n, 2))
    for i in range(n):
        frame, k = frames[i], fit.row[frames[i]]
        seen[i, 0], seen[i, 1] = rays[k, 0], rays[k, 1]
        own = (box_sigma[0] + box_sigma[1] * (sizes[k, 1] * c.focal[frame])) / c.focal[frame]
        fit.views[2, i] = np.hypot(own, DRIFT_RAD * np.sqrt(frames[n - 1] - frame))
        fit.views[3, i] = own
        cut &= not whole[k]
    used = Views(c.rotation, c.centre, frames[late:], seen[late:], fit.views[2, late:n])
    scale = solve_point(used, point, fit.covariance)
    for i in range(9):
        fit.covariance[i // 3, i % 3] *= scale
        if not np.isfinite(fit.covariance[i // 3, i % 3]):
            return False
    for i in range(n - 1, -1, -1):
        k, focal = fit.row[frames[i]], c.focal[frames[i]]
        x, y, z = projected(point, c.rotation[frames[i]], c.centre[frames[i]])
        if not LEAST_M <= z <= PARALLEL_M:
            return False
        fit.views[0, i] = np.hypot((x - rays[k, 0]) * focal, (y - rays[k, 1]) * focal)
        fit.views[1, i] = z
        if count < SIZE_VIEWS and (whole[k] or cut):
            near[0, count], near[1, count] = sizes[k, 0] * z, sizes[k, 1] * z
            count += 1
    for a in range(2):
        fit.metric[0, a] = middle = _median(near[a, :count])
        for i in range(count):
            near[a, i] = abs(near[a, i] - middle)
        fit.spread[a] = max(MAD_TO_SIGMA * _median(near[a, :count]), LEAST_SPREAD * middle)
    return True


@compiled_within
def _median(values: Array) -> float:
    """The median of a few values, which it puts in order."""
    n = len(values)
    for i in range(1, n):
        for k in range(i, 0, -1):
            if values[k] < values[k - 1]:
                values[k], values[k - 1] = values[k - 1], values[k]
    return float(values[(n - 1) // 2] + values[n // 2]) / 2
