"""Hypotheses: points where the rays of two candidates meet (report eqs. 7.1 to 7.4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import pair_midpoint
from wayside.stages.mapping.association import AssociationGates, WindowCandidates


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
    candidates: WindowCandidates, older: int, newer: int, gates: AssociationGates
) -> PairHypotheses:
    """Pairs of candidates of two frames whose rays meet at a plausible point with like metric sizes.

    The point is the midpoint of the two rays (report eqs. 7.1 to 7.4).

    Parameters
    ----------
    candidates
        The window.
    older, newer
        Frames, as positions in the window.
    gates
        Largest gaps and ratios, and where panels can stand.

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
    loose = gates.horizon_slope * z
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.sqrt(metric.prod(axis=0))
        gap_px = c.focal[newer] * found.gap / z
    good = (depth > gates.nearest_m).all(axis=1) & (depth[:, 0] < gates.farthest_m)
    good &= (most <= least * (gates.wider, gates.taller)).all(axis=1)
    good &= gap_px <= gates.gap_px + gates.gap_share * c.focal[newer] * c.size[j, 1]
    good &= np.abs(x) <= gates.aside_m + loose
    good &= (y <= gates.below_m + loose) & (-y <= gates.above_m + loose)
    good &= (size >= (gates.narrowest_m, gates.lowest_m)).all(axis=1)
    good &= (size <= (gates.widest_m, gates.tallest_m)).all(axis=1)
    point = c.centre[newer] + found.point[good] @ back
    return PairHypotheses(i[good], j[good], point, size[good])
