"""Which candidates of a window of frames may be one panel: points where two rays meet, and the views of a point.

Rays are ideal image coordinates (x/z, y/z); sizes are in the same unit, so that size times depth is metres. All
frames of a window share one world: that of the chained motion.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Rows
from wayside.stages.geometry import Midpoints, pair_midpoint
from wayside.stages.kernels import compiled
from wayside.stages.mapping.triangulation import projected

# Set on the development drives, where no other reason is given.
GAP_SHARE = 0.06
"""Added to the largest gap of a view, `track.gap_px`, by the height of the panel."""
TALLER, WIDER = 1.35, 1.47
"""Largest ratio of two metric heights, and of two widths, of one panel."""
NEAREST_M, FARTHEST_M = 4.0, 220.0
"""Least and largest depth of a view, m: nearer panels are cut."""
ASIDE_M = 45.0
"""Largest distance of a panel beside the camera, m: the far side of a freeway."""
ABOVE_M, BELOW_M = 12.0, 1.6
"""Largest height of a panel above the camera, and largest depth below it, m."""
HORIZON_SLOPE = 0.06
"""These three grow with depth by so much, m/m: far off, road and horizon are not known well."""
SMALLEST_M, LARGEST_M = (0.15, 0.12), (12.0, 8.0)
"""Least and largest width and height of a panel, m: boards span four lanes."""
VALUE_SHIFT = 2.0
"""Added to the score of a view, log odds."""
LEAST_VALUE, MOST_VALUE = -1.0, 6.0
"""Least and largest value of a view, log odds."""
GAP_COST = 1.0
"""Cost of a view at the gate of its place, and of one at that of its size, log odds; it falls with the square."""
MISS_COST = 0.7
"""Cost of a frame that should show the panel and has no candidate there, log odds."""
LEAST_SUM = -1.0
"""Hypotheses with a smaller sum over their views are dropped, log odds."""
EXPECTED_PX = 14.0
"""Height from which a view is expected, px."""


class WindowCandidates(NamedTuple):
    """Followed candidates of n frames, N rows, as the kernel takes them: C-contiguous, doubles."""

    rotation: NDArray[np.float64]
    """World from camera, (n, 3, 3)."""
    centre: NDArray[np.float64]
    """Of the camera in the world, (n, 3), metres."""
    focal: NDArray[np.float64]
    """Focal length, (n,), pixels."""
    bounds: NDArray[np.float64]
    """Rays of the left, upper, right and lower edge of the image, (n, 4)."""
    first: NDArray[np.int64]
    """Frame f owns rows `first[f]` to `first[f + 1]`, (n + 1,)."""
    table: NDArray[np.void]
    """With the columns of `window.FOLLOWED`, (N,)."""


@dataclass(frozen=True, slots=True)
class Hypotheses(Rows):
    """Landmarks to try: point (m, 3) in the world, size (m, 2) metres, back (m,): of backs, not of faces."""

    point: NDArray[np.float64]
    size: NDArray[np.float64]
    back: NDArray[np.bool_]


class Association(NamedTuple):
    """For m hypotheses: row (m, n) of the candidate in n frames or -1, value (m,) of all views.

    `missed` (m,): number of frames that should show it and have no candidate there.
    """

    row: NDArray[np.int32]
    missed: NDArray[np.int64]
    value: NDArray[np.float64]

    def likely_values(self, fewest_views: int) -> NDArray[np.float64]:
        """The values (m,); -inf where the views are too few, or their sum too low for a landmark."""
        likely = ((self.row >= 0).sum(axis=1) >= fewest_views) & (self.value > LEAST_SUM)
        return np.where(likely, self.value, -np.inf)


def pair_hypotheses(
    candidates: WindowCandidates,
    older: range,
    newer: int,
    gap_px: float,
    likely: NDArray[np.int64] | None = None,
) -> tuple[NDArray[np.int64], Hypotheses]:
    """Pairs of candidates, of older frames and of the newer, whose rays meet plausibly with like sizes: rows (k, 2).

    The point is the midpoint of the two rays (report eqs. 7.1 to 7.4). `older`, `newer`: frames, as positions in the
    window. `gap_px`: largest gap of the two rays, pixels, before the share of the height. `likely` (p, 2): rows to try,
    the first ones ascending; None: all seeds.
    """
    c, ray, size = candidates, candidates.table["ray"], candidates.table["size"]
    if likely is None:
        spans = c.first[[[older.start, older.stop], [newer, newer + 1]]].tolist()
        one, two = (first + np.flatnonzero(c.table["seed"][first:end]) for first, end in spans)
        likely = np.stack([np.repeat(one, len(two)), np.tile(two, len(one))], axis=1)
    back = c.table["back"][likely]
    i, j = likely[back[:, 0] == back[:, 1]].T
    # in the newer camera's frame: its axes tell where a panel is plausible
    to_newer, met = c.rotation[newer].T, []
    ends = np.searchsorted(i, c.first[older.start : older.stop + 1]).tolist()
    for frame, first, end in zip(older, ends, ends[1:], strict=False):
        centre = to_newer @ (c.centre[frame] - c.centre[newer])
        rays = ray[j[first:end]], ray[i[first:end]]
        met.append(pair_midpoint(*rays, to_newer @ c.rotation[frame], centre))
    found = Midpoints._make(map(np.concatenate, zip(*met, strict=True)))
    x, y, z = found.point.T
    depth = found.along / np.sqrt(1 + (ray[np.stack([j, i], axis=1)] ** 2).sum(axis=2))
    metric = size[np.stack([j, i])] * depth.T[:, :, None]
    least, most = metric.min(axis=0), metric.max(axis=0)
    loose = HORIZON_SLOPE * z
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.sqrt(metric.prod(axis=0))
        gap = c.focal[newer] * found.gap / z
    good = (depth > NEAREST_M).all(axis=1) & (depth[:, 0] < FARTHEST_M)
    good &= (most <= least * (WIDER, TALLER)).all(axis=1)
    good &= gap <= gap_px + GAP_SHARE * c.focal[newer] * size[j, 1]
    good &= np.abs(x) <= ASIDE_M + loose
    good &= (y <= BELOW_M + loose) & (-y <= ABOVE_M + loose)
    good &= (metres >= SMALLEST_M).all(axis=1)
    good &= (metres <= LARGEST_M).all(axis=1)
    point = c.centre[newer] + found.point[good] @ to_newer
    pairs = np.stack([i[good], j[good]], axis=1)
    return pairs, Hypotheses(point, metres[good], c.table["back"][pairs[:, 1]])


def associate(
    candidates: WindowCandidates, hypotheses: Hypotheses, free: NDArray[np.bool_], gap_px: float
) -> Association:
    """Best free candidate of each frame for each hypothesis, by where and how large it must appear.

    `free` (N,): rows of the window that may be used. `gap_px`: largest gap of a view, pixels, before the share of its
    height.

    Raises ValueError where `free` has another length: the kernel checks no bounds.
    """
    if free.shape != candidates.table.shape:
        raise ValueError(f"free has shape {free.shape} instead of {candidates.table.shape}")
    m, n = len(hypotheses.point), len(candidates.rotation)
    found = Association(np.empty((m, n), np.int32), np.empty(m, np.int64), np.empty(m))
    associate_free(candidates, hypotheses.point, hypotheses.size, free, gap_px, found)
    return found


@compiled
def associate_free(
    c: WindowCandidates,
    point: NDArray[np.float64],
    size: NDArray[np.float64],
    free: NDArray[np.bool_],
    gap_px: float,
    found: Association,
) -> None:
    """Kernel of `associate`, for other kernels: fills what it found."""
    rays, sizes, scores = c.table["ray"], c.table["size"], c.table["score"]
    for m in range(point.shape[0]):
        wide, tall = size[m, 0], size[m, 1]
        found.value[m], found.missed[m] = 0.0, 0
        for n in range(c.rotation.shape[0]):
            found.row[m, n] = -1
            x, y, z = projected(point[m], c.rotation[n], c.centre[n])
            if not NEAREST_M < z < FARTHEST_M:
                continue
            left, top, right, bottom = c.bounds[n]
            if x < left or x > right or y < top or y > bottom:
                continue
            f = c.focal[n]
            half_wide, half_tall = wide / z / 2, tall / z / 2
            gate = gap_px / f + 2 * GAP_SHARE * half_tall
            best, value = -1, -1e9
            for k in range(c.first[n], c.first[n + 1]):
                du, dv = abs(rays[k, 0] - x), abs(rays[k, 1] - y)
                gap2 = du * du + dv * dv
                if gap2 > gate * gate or not free[k]:
                    continue
                ratio, other = sizes[k, 1] * z / tall, sizes[k, 0] * z / wide
                if max(ratio, 1 / ratio) > TALLER or max(other, 1 / other) > WIDER:
                    continue
                this = min(MOST_VALUE, max(LEAST_VALUE, scores[k] + VALUE_SHIFT))
                off = gap2 / (gate * gate) + np.log(ratio) ** 2 / np.log(TALLER) ** 2
                this -= GAP_COST * off
                if this > value:
                    best, value = k, this
            if best >= 0:
                found.row[m, n] = best
                found.value[m] += value
            elif (
                2 * half_tall * f >= EXPECTED_PX
                and x - half_wide > left
                and x + half_wide < right
                and y - half_tall > top
                and y + half_tall < bottom
            ):
                found.missed[m] += 1
                found.value[m] -= MISS_COST
