"""Association: which candidate of each frame belongs to a point that stands still.

Rays are ideal image coordinates (x/z, y/z); sizes are in the same unit, so that size times depth is metres. All
frames of a window share one world: that of the chained motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, require_array

NOT_EXPECTED, MISSED, SEEN = 0, 1, 2
"""State of a hypothesis in a frame: outside the image or too small; expected, but without a candidate; seen."""

# Set on the development drives, where no other reason is given.
GAP_SHARE = 0.06
"""Added to the largest gap of a view, `track.gap_px`, by the height of the panel."""
TALLER, WIDER = 1.35, 1.47
"""Largest ratio of two metric heights, and of two widths, of one panel."""
NEAREST_M, FARTHEST_M = 4.0, 220.0
"""Least and largest depth of a view, m: nearer panels are cut."""
VALUE_SHIFT = 2.0
"""Added to the score of a view, log odds."""
LEAST_VALUE, MOST_VALUE = -1.0, 6.0
"""Least and largest value of a view, log odds."""
GAP_COST = 1.0
"""Cost of a view at the gate of its place, and of one at that of its size, log odds; it falls with the square."""
MISS_COST = 0.7
"""Cost of a frame that should show the panel and has no candidate there, log odds."""
EXPECTED_PX = 14.0
"""Height from which a view is expected, px."""


@dataclass(frozen=True, slots=True)
class WindowCandidates:
    """Candidates of n frames as parallel arrays, N rows."""

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
    ray: NDArray[np.float64]
    """Ideal image coordinates of the centre, (N, 2)."""
    size: NDArray[np.float64]
    """Width and height in ideal image coordinates, (N, 2)."""
    score: NDArray[np.float64]
    """Log odds, (N,)."""
    whole: NDArray[np.bool_]
    """Whether the box does not touch the edge of the image, (N,)."""
    seeds: NDArray[np.bool_]
    """Whether it may form a hypothesis, (N,)."""

    def __post_init__(self) -> None:
        """Refuse shapes that the kernels, which do not check bounds, would run over."""
        n, rows = len(self.rotation), len(self.ray)
        require_array(self.rotation, "rotation", np.float64, (n, 3, 3))
        require_array(self.centre, "centre", np.float64, (n, 3))
        require_array(self.focal, "focal", np.float64, (n,))
        require_array(self.bounds, "bounds", np.float64, (n, 4))
        require_array(self.first, "first", np.int64, (n + 1,))
        require_array(self.ray, "ray", np.float64, (rows, 2))
        require_array(self.size, "size", np.float64, (rows, 2))
        require_array(self.score, "score", np.float64, (rows,))
        require_array(self.whole, "whole", np.bool_, (rows,))
        require_array(self.seeds, "seeds", np.bool_, (rows,))
        if self.first[0] != 0 or self.first[-1] != rows or (np.diff(self.first) < 0).any():
            raise ValueError("WindowCandidates.first must ascend from 0 to the number of rows")


class Association(NamedTuple):
    """For m hypotheses and n frames: row (m, n) of the candidate or -1; state (m, n) uint8; value (m,) of all views."""

    row: NDArray[np.int32]
    state: NDArray[np.uint8]
    value: NDArray[np.float64]

    def views(self) -> NDArray[np.intp]:
        """Number of frames each hypothesis is seen in, (m,)."""
        return np.asarray(np.count_nonzero(self.row >= 0, axis=1))


def associate(
    candidates: WindowCandidates,
    point: NDArray[np.floating[Any]],
    size: NDArray[np.floating[Any]],
    free: NDArray[np.bool_],
    gap_px: float,
) -> Association:
    """Best free candidate of each frame for each hypothesis, by where and how large it must appear.

    Parameters
    ----------
    candidates
        The window, N rows.
    point, size
        Hypotheses (m, 3) in the world and their metric width and height (m, 2).
    free
        Rows that may be used, (N,).
    gap_px
        Largest gap of a view, pixels, before the share of its height.

    Raises
    ------
    ValueError
        Arrays of other shapes.
    """
    points, sizes = np.ascontiguousarray(point, np.float64), np.ascontiguousarray(size, np.float64)
    usable = np.ascontiguousarray(free, np.bool_)
    m, n = len(points), len(candidates.rotation)
    if points.shape != (m, 3) or sizes.shape != (m, 2) or usable.shape != candidates.score.shape:
        raise ValueError(
            f"points, sizes and usable have shapes {points.shape}, {sizes.shape}, {usable.shape} instead of (m, 3), "
            f"(m, 2), ({len(candidates.score)},)"
        )
    row, state = np.full((m, n), -1, np.int32), np.zeros((m, n), np.uint8)
    value = np.zeros(m)
    c = candidates
    _associate(
        c.rotation, c.centre, c.focal, c.bounds, c.first, c.ray, c.size, c.score, points, sizes, usable,
        gap_px, row, state, value,
    )  # fmt: skip
    return Association(row, state, value)


@compiled
def _associate(
    rotation: Array,
    centre: Array,
    focal: Array,
    bounds: Array,
    first: NDArray[np.int64],
    ray: Array,
    size: Array,
    score: Array,
    point: Array,
    metric: Array,
    free: NDArray[np.bool_],
    gap_px: float,
    row: NDArray[np.int32],
    state: NDArray[np.uint8],
    total: Array,
) -> None:
    for m in range(point.shape[0]):
        wide, tall = metric[m, 0], metric[m, 1]
        for n in range(rotation.shape[0]):
            a = point[m, 0] - centre[n, 0]
            b = point[m, 1] - centre[n, 1]
            c = point[m, 2] - centre[n, 2]
            r = rotation[n]
            z = r[0, 2] * a + r[1, 2] * b + r[2, 2] * c
            if not NEAREST_M < z < FARTHEST_M:
                continue
            x = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / z
            y = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / z
            if x < bounds[n, 0] or x > bounds[n, 2] or y < bounds[n, 1] or y > bounds[n, 3]:
                continue
            f = focal[n]
            half_wide, half_tall = wide / z / 2, tall / z / 2
            gate = gap_px / f + 2 * GAP_SHARE * half_tall
            best, value = -1, -1e9
            for k in range(first[n], first[n + 1]):
                du = abs(ray[k, 0] - x)
                if du > gate or not free[k]:
                    continue
                dv = abs(ray[k, 1] - y)
                gap2 = du * du + dv * dv
                if gap2 > gate * gate:
                    continue
                ratio = size[k, 1] * z / tall
                if ratio > TALLER or ratio * TALLER < 1:
                    continue
                other = size[k, 0] * z / wide
                if other > WIDER or other * WIDER < 1:
                    continue
                this = min(MOST_VALUE, max(LEAST_VALUE, score[k] + VALUE_SHIFT))
                off = gap2 / (gate * gate) + np.log(ratio) ** 2 / np.log(TALLER) ** 2
                this -= GAP_COST * off
                if this > value:
                    best, value = k, this
            if best >= 0:
                row[m, n], state[m, n] = best, SEEN
                total[m] += value
            elif (
                2 * half_tall * f >= EXPECTED_PX
                and x - half_wide > bounds[n, 0]
                and x + half_wide < bounds[n, 2]
                and y - half_tall > bounds[n, 1]
                and y + half_tall < bounds[n, 3]
            ):
                state[m, n] = MISSED
                total[m] -= MISS_COST
