"""From candidates of a window to places: the best place first, then the rest without its candidates.

The order matters: a place takes its candidates away before the next is sought, so that a plaque under a sign is
found after the sign, and the several regions of one face end up in one place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled
from wayside.stages.mapping.association import EMPTY, Associated, Gates, Sightings, associate
from wayside.stages.mapping.triangulation import triangulate_views

CENTRE_SIGMA_PX, CENTRE_SIGMA_SHARE = 1.0, 0.02
"""Scatter of a box's centre: a pixel, and a share of the box's height (inner field taken for the face)."""
DRIFT_RAD = 2.5e-4
"""Scatter of a ray for each frame between it and the nearest view: error of the chained motion."""
NEAREST_VIEWS = 8
"""More than this many of the nearest views add nothing safe (measured)."""
SIZE_VIEWS = 6
PART_WITHIN, PART_LARGEST, PART_VIEWS, MOST_PARTS, PART_WORTH = 0.85, 0.85, 6, 12, 1.5
"""Parts of a place: share of a part's box within the whole's, and largest share of the whole; in how many of the
nearest views that is asked, half of which must show it; how many parts are looked at; mean value of a view."""
PARTS_FILL, PARTS_SHARE, PARTS_WORTH = 0.75, 0.15, 1.25
"""Two parts fill so much of the whole's box, share so little of the smaller one, and are worth so much more."""
FIRST = 1e6
"""Added to the sum of values of a place that is to come before all others."""
NEAREST_M, FARTHEST_M = 1.0, 1000.0
"""Rays that meet nearer or farther than this are as good as parallel: no panel is seen there."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A place fitted to its views.

    rows (v,): sightings, oldest first; frames (v,): their positions in the window; used (v,): those that the point
    was fitted to; point (3,), covariance (3, 3) in the world; residual_px, depth (v,): pixels, metres; metric,
    spread (2,): width and height and their scatter, metres; weight_sigma, ray_sigma (v,): what the views were
    weighted by, and the scatter of their rays alone; chi: sum of squares of the used residuals in that scatter; empty:
    expected views left empty; total: sum of values; covered: rows of other candidates that show the same face;
    back: it is followed as the back of a panel.
    """

    rows: NDArray[np.int64]
    frames: NDArray[np.int64]
    used: NDArray[np.bool_]
    point: NDArray[np.float64]
    covariance: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    depth: NDArray[np.float64]
    metric: NDArray[np.float64]
    spread: NDArray[np.float64]
    weight_sigma: NDArray[np.float64]
    ray_sigma: NDArray[np.float64]
    chi: float
    empty: int
    total: float
    covered: NDArray[np.int64]
    back: bool = False

    @property
    def rms_px(self) -> float:
        """RMS of the residuals of the views that were used."""
        return float(np.sqrt((self.residual_px[self.used] ** 2).mean()))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of `chi`."""
        return max(2.0 * float(self.used.sum()) - 3.0, 1.0)


def solve_places(
    sightings: Sightings,
    point: NDArray[np.float64],
    size: NDArray[np.float64],
    free: NDArray[np.bool_],
    gates: Gates,
    *,
    fewest: int,
    least_total: float,
) -> list[Fit]:
    """Places of a window, best first, each with candidates of its own.

    Parameters
    ----------
    sightings
        The window, N candidates.
    point, size
        Places to try (m, 3), metres, and their width and height (m, 2).
    free
        Candidates not yet taken, (N,).
    gates
        What places must hold to.
    fewest
        Views a place needs.
    least_total
        Sum of values a place needs.
    """
    left = free.copy()
    row, state, total = associate(sightings, point, size, left, gates)
    alive = ((row >= 0).sum(axis=1) >= fewest) & (total > least_total)
    due = np.zeros(len(alive))  # the other part of a place that was shared out comes next
    fits: list[Fit] = []
    while alive.any():
        best = int(np.argmax(np.where(alive, total + due, -np.inf)))
        alive[best] = False
        shared = np.zeros(0, np.int64)
        while (parts := share_out(sightings, row, total, best, alive, gates)) is not None:
            best, shared = parts.one, np.concatenate([shared, parts.shared])
            alive[best] = False
            due[parts.other] = FIRST
        seen = Associated(row[best : best + 1], state[best : best + 1], total[best : best + 1])
        fit = refine(sightings, seen, left, gates, fewest=fewest)
        if fit is None or fit.total <= least_total:
            continue
        covered = np.union1d(covered_rows(sightings, fit, left), shared[left[shared]])
        fit = replace(fit, covered=np.setdiff1d(covered, fit.rows))
        fits.append(fit)
        left[fit.rows] = False
        left[fit.covered] = False
        touched = alive & ((row >= 0) & ~left[row]).any(axis=1)
        again = np.flatnonzero(touched)
        if len(again):
            redone = associate(sightings, point[again], size[again], left, gates)
            row[again], state[again], total[again] = redone
            alive[again] = (redone.views() >= fewest) & (redone.total > least_total)
    return fits


class Parts(NamedTuple):
    """Two places that a third one is shared out between, the better first, and its rows (k,) where both are seen."""

    one: int
    other: int
    shared: NDArray[np.int64]


def share_out(
    s: Sightings,
    row: NDArray[np.int32],
    total: NDArray[np.float64],
    whole: int,
    alive: NDArray[np.bool_],
    gates: Gates,
) -> Parts | None:
    """Two places that share out the boxes of a third one between them and are worth more; None: none do.

    A sign and its plaque also make one box together, and no worse a one. Two faces are the better account of it where
    both hold in the nearest views (far ones show both as one): halves of one face do not, as they are no faces to the
    judge. The boxes of both together are then a face of nobody's.
    """
    frames = np.flatnonzero(row[whole] >= 0)[-PART_VIEWS:]
    likely = np.flatnonzero(alive & (total > 0))
    fewest = max(2, len(frames) // 2)
    if len(likely) < 2 or len(frames) < fewest:
        return None
    box, parts = _boxes(s, row[whole, frames]), row[likely][:, frames]
    part_box = _boxes(s, np.maximum(parts, 0))
    own, area = _areas(part_box), _areas(box)
    inner = np.concatenate(
        [np.maximum(part_box, box)[..., :2], np.minimum(part_box, box)[..., 2:]], axis=-1
    )
    within = (parts >= 0) & (_areas(inner) > PART_WITHIN * own) & (own < PART_LARGEST * area)
    chosen = np.flatnonzero(within.sum(axis=1) >= fewest)
    chosen = chosen[np.argsort(-total[likely[chosen]], kind="stable")]
    _, first = np.unique(np.where(within, parts, -1)[chosen], axis=0, return_index=True)
    chosen = chosen[np.sort(first)][:MOST_PARTS]
    worth = np.clip(s.score + gates.value_shift, gates.value_least, gates.value_most)
    of_whole, of_part = worth[row[whole, frames]], worth[np.maximum(parts, 0)]
    best: Parts | None = None
    most = PARTS_WORTH
    for i, a in enumerate(chosen):
        for b in chosen[i + 1 :]:
            both = within[a] & within[b]
            if both.sum() < fewest:
                continue
            values = of_part[[a, b]][:, both].mean(axis=1)
            ratio = float(values.sum() / max(of_whole[both].mean(), 1.0))
            one, other = part_box[a, both], part_box[b, both]
            low, high = np.minimum(one, other), np.maximum(one, other)
            hull = _areas(np.concatenate([low[:, :2], high[:, 2:]], axis=1))
            shared = _areas(np.concatenate([high[:, :2], low[:, 2:]], axis=1))
            smaller = np.minimum(own[a, both], own[b, both])
            fills = np.median(hull / area[both]) > PARTS_FILL
            if ratio > most and values.min() > PART_WORTH and fills:
                if np.median(shared / smaller) < PARTS_SHARE:
                    rows = row[whole, frames[both]].astype(np.int64)
                    best, most = Parts(int(likely[a]), int(likely[b]), rows), ratio
    return best


def _boxes(s: Sightings, rows: NDArray[np.int32]) -> NDArray[np.float64]:
    """Boxes (..., 4) of sightings as ideal image coordinates."""
    return np.concatenate([s.ray[rows] - s.size[rows] / 2, s.ray[rows] + s.size[rows] / 2], axis=-1)


def _areas(box: NDArray[np.float64]) -> NDArray[np.float64]:
    """Areas (...) of boxes (..., 4); 0 where the sides are the wrong way round."""
    return np.asarray(np.clip(box[..., 2:] - box[..., :2], 0, None).prod(axis=-1))


def refine(
    sightings: Sightings, seen: Associated, free: NDArray[np.bool_], gates: Gates, *, fewest: int
) -> Fit | None:
    """Fit a place to its views, look for its views again, until they stay the same (three times at most)."""
    for _ in range(3):
        frames = np.flatnonzero(seen.row[0] >= 0)
        if len(frames) < max(fewest, 2):
            return None
        fit = fit_views(sightings, seen.row[0, frames].astype(np.int64), frames)
        if fit is None:
            return None
        after = associate(sightings, fit.point[None], fit.metric[None], free, gates)
        same = np.array_equal(after.row, seen.row)
        seen = after
        if same:
            break
    frames = np.flatnonzero(seen.row[0] >= 0)
    if len(frames) < max(fewest, 2):
        return None
    last = fit_views(sightings, seen.row[0, frames].astype(np.int64), frames)
    if last is None:
        return None
    empty = int((seen.state[0] == EMPTY).sum())
    return replace(last, empty=empty, total=float(seen.total[0]))


def fit_views(
    s: Sightings,
    rows: NDArray[np.int64],
    frames: NDArray[np.int64],
    nearest: int = NEAREST_VIEWS,
) -> Fit | None:
    """Point, covariance and metric size from the views; None where the rays do not meet ahead.

    The point is fitted to the `nearest` latest views; the covariance is that of the rays alone, in the world.
    """
    tall_px = s.size[rows, 1] * s.focal[frames]
    nearness = np.argsort(-frames, kind="stable")
    used = np.zeros(len(rows), bool)
    used[nearness[:nearest]] = True
    own = (CENTRE_SIGMA_PX + CENTRE_SIGMA_SHARE * tall_px) / s.focal[frames]
    sigma = np.hypot(own, DRIFT_RAD * np.sqrt(frames.max() - frames))
    point, covariance, _ = triangulate_views(
        s.rotation[frames[used]], s.centre[frames[used]], s.ray[rows[used]], sigma[used]
    )
    if not np.isfinite(point).all() or not np.isfinite(covariance).all():
        return None
    local = np.einsum("ni,nij->nj", point - s.centre[frames], s.rotation[frames])
    depth = local[:, 2]
    if depth.min() < NEAREST_M or depth.max() > FARTHEST_M:
        return None
    gap = (local[:, :2] / depth[:, None] - s.ray[rows]) * s.focal[frames][:, None]
    metric, spread = metric_size(s.size[rows] * depth[:, None], depth, s.whole[rows])
    none = np.zeros(0, np.int64)
    residual = np.hypot(gap[:, 0], gap[:, 1])
    chi = float(((residual[used] / (own[used] * s.focal[frames[used]])) ** 2).sum())
    return Fit(
        rows,
        frames,
        used,
        point,
        covariance,
        residual,
        depth,
        metric,
        spread,
        sigma,
        own,
        chi,
        0,
        0.0,
        none,
    )


def metric_size(
    sizes: NDArray[np.float64], depth: NDArray[np.float64], whole: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median width and height (2,) over the nearest views, and their scatter (2,), metres.

    Views cut by the edge of the picture are left out where others exist.
    """
    order = np.argsort(depth, kind="stable")
    best = order[whole[order]]
    near = sizes[(best if len(best) else order)[:SIZE_VIEWS]]
    middle = np.median(near, axis=0)
    scatter = 1.4826 * np.median(np.abs(near - middle), axis=0)
    return middle, np.maximum(scatter, 0.02 * middle)


def covered_rows(s: Sightings, fit: Fit, free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Free candidates that show the same face as the place's own views: overlap or lie within."""
    mark = np.zeros(len(s.ray), np.bool_)
    _cover(s.first, s.ray, s.size, fit.rows, fit.frames, free, mark)
    mark[fit.rows] = False
    return np.flatnonzero(mark)


@compiled
def _cover(
    first: NDArray[np.int64],
    ray: Array,
    size: Array,
    rows: NDArray[np.int64],
    frames: NDArray[np.int64],
    free: NDArray[np.bool_],
    mark: NDArray[np.bool_],
) -> None:
    for i in range(rows.shape[0]):
        r, n = rows[i], frames[i]
        for k in range(first[n], first[n + 1]):
            if not free[k]:
                continue
            wide = min(ray[r, 0] + size[r, 0] / 2, ray[k, 0] + size[k, 0] / 2) - max(
                ray[r, 0] - size[r, 0] / 2, ray[k, 0] - size[k, 0] / 2
            )
            tall = min(ray[r, 1] + size[r, 1] / 2, ray[k, 1] + size[k, 1] / 2) - max(
                ray[r, 1] - size[r, 1] / 2, ray[k, 1] - size[k, 1] / 2
            )
            if wide <= 0 or tall <= 0:
                continue
            inner = wide * tall
            mine, other = size[r, 0] * size[r, 1], size[k, 0] * size[k, 1]
            if inner > 0.4 * (mine + other - inner) or inner > 0.75 * other:
                mark[k] = True


def overlap_share(s: Sightings, one: Fit, other: Fit, frame: int) -> tuple[float, float]:
    """How much of each place's box the other covers in a frame, (share of one, share of other)."""
    boxes = []
    for fit in (one, other):
        x, y, z = (fit.point - s.centre[frame]) @ s.rotation[frame]
        if z < 0.5:
            return 0.0, 0.0
        wide, tall = fit.metric / z / 2
        boxes.append((x / z - wide, y / z - tall, x / z + wide, y / z + tall))
    (a, b) = boxes
    wide = min(a[2], b[2]) - max(a[0], b[0])
    tall = min(a[3], b[3]) - max(a[1], b[1])
    if wide <= 0 or tall <= 0:
        return 0.0, 0.0
    inner = wide * tall
    return (
        inner / ((a[2] - a[0]) * (a[3] - a[1])),
        inner / ((b[2] - b[0]) * (b[3] - b[1])),
    )
