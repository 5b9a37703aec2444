"""Hypotheses: points where the rays of two candidates meet (report eqs. 7.1 to 7.4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import pair_midpoint
from wayside.stages.mapping.association import (
    FARTHEST_M,
    GAP_SHARE,
    NEAREST_M,
    TALLER,
    WIDER,
    WindowCandidates,
)

# Set on the development drives, where no other reason is given.
ASIDE_M = 45.0
"""Largest distance of a panel beside the camera, m: the far side of a freeway."""
ABOVE_M, BELOW_M = 12.0, 1.6
"""Largest height of a panel above the camera, and largest depth below it, m."""
HORIZON_SLOPE = 0.06
"""These three grow with depth by so much, m/m: far off, road and horizon are not known well."""
SMALLEST_M, LARGEST_M = (0.15, 0.12), (12.0, 8.0)
"""Least and largest width and height of a panel, m: boards span four lanes."""


class Hypotheses(NamedTuple):
    """Landmarks to try: point (m, 3) in the world, size (m, 2) metres, back (m,): of backs, not of faces."""

    point: NDArray[np.float64]
    size: NDArray[np.float64]
    back: NDArray[np.bool_]

    @staticmethod
    def joined(parts: Sequence[Hypotheses]) -> Hypotheses:
        """The hypotheses of all parts, in their order."""
        none = Hypotheses(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0, np.bool_))
        columns = zip(none, *parts, strict=True)
        return Hypotheses._make(np.concatenate(column) for column in columns)

    def select(self, rows: NDArray[np.bool_]) -> Hypotheses:
        """Some of them."""
        return Hypotheses._make(column[rows] for column in self)


class PairHypotheses(NamedTuple):
    """Pairs of rows that may show one panel: older, newer (k,); point (k, 3) in the world; size (k, 2) metres."""

    older: NDArray[np.int64]
    newer: NDArray[np.int64]
    point: NDArray[np.float64]
    size: NDArray[np.float64]


def pair_hypotheses(
    candidates: WindowCandidates, older: int, newer: int, gap_px: float
) -> PairHypotheses:
    """Pairs of candidates of two frames whose rays meet at a plausible point with like metric sizes.

    The point is the midpoint of the two rays (report eqs. 7.1 to 7.4).

    Parameters
    ----------
    candidates
        The window.
    older, newer
        Frames, as positions in the window.
    gap_px
        Largest gap of the two rays, pixels, before the share of the height.

    Raises
    ------
    ValueError
        A frame that is not in the window.
    """
    n = len(candidates.rotation)
    if not (0 <= older < n and 0 <= newer < n):
        raise ValueError(f"frames {older}, {newer} are not below {n}")
    c = candidates
    rows = [
        c.first[f] + np.flatnonzero(c.seeds[c.first[f] : c.first[f + 1]]) for f in (older, newer)
    ]
    i, j = (side.ravel() for side in np.meshgrid(*rows, indexing="ij"))
    # in the newer camera's frame: its axes tell where a panel is plausible
    back = c.rotation[newer].T
    older_axes, older_centre = back @ c.rotation[older], back @ (c.centre[older] - c.centre[newer])
    found = pair_midpoint(c.ray[j], c.ray[i], older_axes, older_centre)
    x, y, z = found.point.T
    depth = found.along / np.sqrt(1 + (c.ray[np.stack([j, i], axis=1)] ** 2).sum(axis=2))
    metric = np.stack([c.size[j], c.size[i]]) * depth.T[:, :, None]
    least, most = metric.min(axis=0), metric.max(axis=0)
    loose = HORIZON_SLOPE * z
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.sqrt(metric.prod(axis=0))
        gap = c.focal[newer] * found.gap / z
    good = (depth > NEAREST_M).all(axis=1) & (depth[:, 0] < FARTHEST_M)
    good &= (most <= least * (WIDER, TALLER)).all(axis=1)
    good &= gap <= gap_px + GAP_SHARE * c.focal[newer] * c.size[j, 1]
    good &= np.abs(x) <= ASIDE_M + loose
    good &= (y <= BELOW_M + loose) & (-y <= ABOVE_M + loose)
    good &= (size >= SMALLEST_M).all(axis=1)
    good &= (size <= LARGEST_M).all(axis=1)
    point = c.centre[newer] + found.point[good] @ back
    return PairHypotheses(i[good], j[good], point, size[good])
