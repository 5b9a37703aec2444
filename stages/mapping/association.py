"""Which candidates of a window of frames may be one panel: points where two rays meet, and the views of a point.

Rays are ideal image coordinates (x/z, y/z); sizes are in the same unit, so that size times depth is metres. All
frames of a window share one world: that of the chained motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Rows
from wayside.stages.geometry import meet_rays
from wayside.stages.kernels import Array, Flags, Numbers, compiled, compiled_within
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

    rotation: Array
    """World from camera, (n, 3, 3)."""
    centre: Array
    """Of the camera in the world, (n, 3), metres."""
    focal: Array
    """Focal length, (n,), pixels."""
    bounds: Array
    """Rays of the left, upper, right and lower edge of the image, (n, 4)."""
    first: Numbers
    """Frame f owns rows `first[f]` to `first[f + 1]`, (n + 1,)."""
    table: NDArray[np.void]
    """With the columns of `window.FOLLOWED`, (N,)."""
    ray: Array
    """Its column of this name, (N, 2), side by side: the one that is read most."""
    across: Numbers
    """Rows (N,) in the order of the frames, and of each frame from left to right."""

    @classmethod
    def of(cls, poses: Sequence[Any], first: Numbers, table: NDArray[np.void]) -> Self:
        """Of the columns up to `bounds`, and these."""
        ray, frame = np.ascontiguousarray(table["ray"]), np.arange(len(first) - 1)
        across = np.lexsort((ray[:, 0], np.repeat(frame, np.diff(first))))
        return cls._make((*poses, first, table, ray, across))


@dataclass(frozen=True, slots=True)
class Hypotheses(Rows):
    """Landmarks to try: point (m, 3) in the world, size (m, 2) metres, back (m,): of backs, not of faces."""

    point: Array
    size: Array
    back: Flags


class Association(NamedTuple):
    """For m hypotheses: row (m, n) of the candidate in n frames or -1, value (m,) of all views.

    `missed` (m,): number of frames that should show it and have no candidate there.
    """

    row: NDArray[np.int32]
    missed: Numbers
    value: Array


def pair_hypotheses(
    c: WindowCandidates, older: range, newer: int, gap_px: float, likely: Numbers | None = None
) -> tuple[Numbers, Hypotheses]:
    """Pairs of candidates, of older frames and of the newer, whose rays meet plausibly with like sizes: rows (k, 2).

    The point is the midpoint of the two rays (report eqs. 7.1 to 7.4). `older`, `newer`: frames, as positions in the
    window. `gap_px`: largest gap of the two rays, pixels, before the share of the height. `likely` (p, 2): rows to try,
    the first ones ascending; None: all seeds.
    """
    if likely is None:
        spans = c.first[[[older.start, older.stop], [newer, newer + 1]]].tolist()
        one, two = (first + np.flatnonzero(c.table["seed"][first:end]) for first, end in spans)
        likely = np.stack([np.repeat(one, len(two)), np.tile(two, len(one))], axis=1)
    pairs, point, size = likely.copy(), np.empty((len(likely), 3)), np.empty((len(likely), 2))
    pairs = pairs[: _meet(c, pairs, older.start, newer, gap_px, point, size)]
    back = c.table["back"][pairs[:, 1]]
    return pairs, Hypotheses(point[: len(pairs)], size[: len(pairs)], back)


@compiled
def _meet(
    c: WindowCandidates,
    pairs: Numbers,
    f: int,
    newer: int,
    gap_px: float,
    points: Array,
    size: Array,
) -> int:
    """Move the plausible pairs to the front, and fill what they may show; their number. `f`: frame of the first one."""
    rays, sizes, back = c.table["ray"], c.table["size"], c.table["back"]
    one, other, point = np.ones((1, 3)), np.ones((1, 3)), np.empty((1, 3))
    gap, along, count, focal = np.empty(1), np.empty((1, 2)), 0, c.focal[newer]
    # world axes about the newer camera, whose axes tell where a panel is plausible
    axes, zero = c.rotation[newer], np.zeros(3)
    for n in range(pairs.shape[0]):
        i, j = pairs[n]
        while i >= c.first[f + 1]:
            f += 1
        if back[i] != back[j]:
            continue
        for k in range(3):
            r, s = c.rotation[f, k], axes[k]
            one[0, k] = s[0] * rays[j, 0] + s[1] * rays[j, 1] + s[2]
            other[0, k] = r[0] * rays[i, 0] + r[1] * rays[i, 1] + r[2]
        meet_rays(zero, c.centre[f] - c.centre[newer], one, other, point, gap, along)
        u, v, z = projected(point[0], axes, zero)
        near = along[0, 0] / np.sqrt(1 + rays[j, 0] ** 2 + rays[j, 1] ** 2)
        far = along[0, 1] / np.sqrt(1 + rays[i, 0] ** 2 + rays[i, 1] ** 2)
        loose, good = HORIZON_SLOPE * z, far > NEAREST_M and NEAREST_M < near < FARTHEST_M
        good &= focal * gap[0] / z <= gap_px + GAP_SHARE * focal * sizes[j, 1]
        good &= abs(u * z) <= ASIDE_M + loose and -ABOVE_M - loose <= v * z <= BELOW_M + loose
        for k in range(2):
            a, b = sizes[j, k] * near, sizes[i, k] * far
            size[count, k] = np.sqrt(a * b)
            good &= max(a, b) <= (WIDER, TALLER)[k] * min(a, b)
            good &= SMALLEST_M[k] <= size[count, k] <= LARGEST_M[k]
        if good:
            pairs[count, 0], pairs[count, 1] = i, j
            points[count] = c.centre[newer] + point[0]
            count += 1
    return count


@compiled
def associate_free(
    c: WindowCandidates, point: Array, size: Array, free: Flags, gap_px: float, found: Association
) -> None:
    """Best free candidate of each frame for each hypothesis, by where and how large it must appear: fills `found`.

    `free` (N,): rows of the window that may be used. `gap_px`: largest gap of a view, pixels, before the share of its
    height.
    """
    rays, sizes, scores = c.ray, c.table["size"], c.table["score"]
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
            for k in c.across[_first_from(c, n, x - gate) : c.first[n + 1]]:
                du, dv = rays[k, 0] - x, rays[k, 1] - y
                if du > gate:
                    break
                gap2 = du * du + dv * dv
                if gap2 > gate * gate or not free[k]:
                    continue
                ratio, other = sizes[k, 1] * z / tall, sizes[k, 0] * z / wide
                if max(ratio, 1 / ratio) > TALLER or max(other, 1 / other) > WIDER:
                    continue
                this = min(MOST_VALUE, max(LEAST_VALUE, scores[k] + VALUE_SHIFT))
                off = gap2 / (gate * gate) + np.log(ratio) ** 2 / np.log(TALLER) ** 2
                this -= GAP_COST * off
                if this > value or (this == value and k < best):
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


@compiled_within
def _first_from(c: WindowCandidates, frame: int, x: float) -> int:
    """Position in `across` of the first candidate of a frame that is not left of x."""
    low, high = c.first[frame], c.first[frame + 1]
    while low < high:
        middle = (low + high) // 2
        if c.ray[c.across[middle], 0] < x:
            low = middle + 1
        else:
            high = middle
    return int(low)
