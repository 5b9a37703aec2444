"""Hypotheses: points where the rays of two candidates meet (report eqs. 7.1 to 7.4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled
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
        raise ValueError(f"wanted frames below {n}, found {older}, {newer}")
    c = candidates
    seeds = [np.count_nonzero(c.seeds[c.first[f] : c.first[f + 1]]) for f in (older, newer)]
    most = seeds[0] * seeds[1]
    rows, point = np.empty((most, 2), np.int64), np.empty((most, 3))
    size = np.empty((most, 2))
    count = _pair(
        c.rotation, c.centre, c.focal, c.first, c.ray, c.size, c.seeds, older, newer, gates,
        rows, point, size,
    )  # fmt: skip
    return PairHypotheses(
        rows[:count, 0].copy(), rows[:count, 1].copy(), point[:count].copy(), size[:count].copy()
    )


@compiled
def _pair(
    rotation: Array,
    centre: Array,
    focal: Array,
    first: NDArray[np.int64],
    ray: Array,
    size: Array,
    seeds: NDArray[np.bool_],
    older: int,
    newer: int,
    gates: AssociationGates,
    rows: NDArray[np.int64],
    point: Array,
    metric: Array,
) -> int:
    nearest, taller, wider = gates.nearest_m, gates.taller, gates.wider
    # the newer camera's frame: its axes tell where a panel is plausible
    r = rotation[newer].T @ rotation[older]
    base = rotation[newer].T @ (centre[older] - centre[newer])
    count = 0
    for i in range(first[older], first[older + 1]):
        if not seeds[i]:
            continue
        px = r[0, 0] * ray[i, 0] + r[0, 1] * ray[i, 1] + r[0, 2]
        py = r[1, 0] * ray[i, 0] + r[1, 1] * ray[i, 1] + r[1, 2]
        pz = r[2, 0] * ray[i, 0] + r[2, 1] * ray[i, 1] + r[2, 2]
        for j in range(first[newer], first[newer + 1]):
            if not seeds[j]:
                continue
            qx, qy = ray[j, 0], ray[j, 1]
            # closest approach of base + g p and h q, q = (qx, qy, 1)
            pp = px * px + py * py + pz * pz
            qq = qx * qx + qy * qy + 1.0
            pq = px * qx + py * qy + pz
            pb = px * base[0] + py * base[1] + pz * base[2]
            qb = qx * base[0] + qy * base[1] + base[2]
            square = pp * qq - pq * pq
            if not square > 1e-12:
                continue
            g = (pq * qb - qq * pb) / square
            h = (pp * qb - pq * pb) / square
            if not (g > nearest and nearest < h < gates.farthest_m):
                continue
            ax, ay, az = base[0] + g * px, base[1] + g * py, base[2] + g * pz
            bx, by, bz = h * qx, h * qy, h
            x, y, z = (ax + bx) / 2, (ay + by) / 2, (az + bz) / 2
            # the older camera's depth of a point on its own ray is g
            tall_old, tall_new = size[i, 1] * g, size[j, 1] * h
            wide_old, wide_new = size[i, 0] * g, size[j, 0] * h
            if tall_old > taller * tall_new or tall_new > taller * tall_old:
                continue
            if wide_old > wider * wide_new or wide_new > wider * wide_old:
                continue
            f = focal[newer]
            gap = f * np.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) / z
            if gap > gates.gap_px + gates.gap_share * f * size[j, 1]:
                continue
            loose = gates.horizon_slope * z
            if abs(x) > gates.aside_m + loose:
                continue
            if y > gates.below_m + loose or -y > gates.above_m + loose:
                continue
            wide, tall = np.sqrt(wide_old * wide_new), np.sqrt(tall_old * tall_new)
            if wide < gates.narrowest_m or tall < gates.lowest_m:
                continue
            if wide > gates.widest_m or tall > gates.tallest_m:
                continue
            rows[count, 0], rows[count, 1] = i, j
            metric[count, 0], metric[count, 1] = wide, tall
            for k in range(3):
                point[count, k] = (
                    centre[newer, k]
                    + rotation[newer, k, 0] * x
                    + rotation[newer, k, 1] * y
                    + rotation[newer, k, 2] * z
                )
            count += 1
    return count
