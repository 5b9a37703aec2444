"""Which candidates of neighbouring frames may be one thing that stands still.

Rays are ideal image coordinates (x/z, y/z); sizes are in the same unit, so that size times depth is metres. All
frames of a window share one world: that of the chained motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled

NOT_EXPECTED, EMPTY, SEEN = 0, 1, 2
"""State of a place in a frame: outside the picture or too small, expected but not there, there."""


@dataclass(frozen=True, slots=True)
class Gates:
    """What a link and a place must hold to.

    gap: pixels and share of the height; taller, wider: largest ratio of metric heights and widths; nearest, farthest:
    depth in metres; aside, above, below: reach of places beside, above and below the camera's path, metres;
    narrowest, lowest, widest, tallest: metric size of a panel; value_*: how a candidate's log odds enter
    the sum over views; miss: what an expected view left empty costs; expected_px: height from which a view is expected.
    """

    gap_px: float = 3.0
    gap_share: float = 0.06
    taller: float = 1.35
    wider: float = 1.47
    nearest: float = 4.0
    farthest: float = 220.0
    aside: float = 22.0
    above: float = 9.0
    below: float = 1.6
    narrowest: float = 0.15
    lowest: float = 0.12
    widest: float = 6.5
    tallest: float = 4.5
    value_shift: float = 2.0
    value_least: float = -1.0
    value_most: float = 6.0
    gap_cost: float = 1.0
    miss: float = 0.7
    expected_px: float = 14.0

    def as_array(self) -> NDArray[np.float64]:
        """The numbers in the order of the fields, for the kernels."""
        return np.array([getattr(self, name) for name in self.__slots__], np.float64)


@dataclass(frozen=True, slots=True)
class Sightings:
    """Candidates of n frames as parallel arrays; frame f owns rows `first[f]` to `first[f + 1]`.

    rotation (n, 3, 3) world from camera; centre (n, 3) metres; focal (n,) pixels; bounds (n, 4): rays of the left,
    upper, right and lower edge of the picture; ray (N, 2); size (N, 2); score (N,) log odds; whole (N,): the box
    does not touch the edge of the picture; leads (N,): may propose a place.
    """

    rotation: NDArray[np.float64]
    centre: NDArray[np.float64]
    focal: NDArray[np.float64]
    bounds: NDArray[np.float64]
    first: NDArray[np.int64]
    ray: NDArray[np.float64]
    size: NDArray[np.float64]
    score: NDArray[np.float64]
    whole: NDArray[np.bool_]
    leads: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Refuse shapes that the kernels, which do not check bounds, would run over."""
        n, rows = len(self.rotation), len(self.ray)
        wanted: dict[str, tuple[int, ...]] = {
            "rotation": (n, 3, 3),
            "centre": (n, 3),
            "focal": (n,),
            "bounds": (n, 4),
            "first": (n + 1,),
            "ray": (rows, 2),
            "size": (rows, 2),
            "score": (rows,),
            "whole": (rows,),
            "leads": (rows,),
        }
        for name, shape in wanted.items():
            array = getattr(self, name)
            if array.shape != shape or not array.flags.c_contiguous:
                raise ValueError(
                    f"Sightings.{name}: wanted {shape} in C order, found {array.shape}"
                )
        if self.first[0] != 0 or self.first[-1] != rows or (np.diff(self.first) < 0).any():
            raise ValueError("Sightings.first: wanted ascending from 0 to the number of rows")

    def frame_of(self) -> NDArray[np.int64]:
        """Frame of each row, (N,)."""
        return np.repeat(np.arange(len(self.rotation)), np.diff(self.first))


class Links(NamedTuple):
    """Pairs of rows that may be one thing: older, newer (k,); point (k, 3) in the world; size (k, 2) metres."""

    older: NDArray[np.int64]
    newer: NDArray[np.int64]
    point: NDArray[np.float64]
    size: NDArray[np.float64]


def link(sightings: Sightings, older: int, newer: int, gates: Gates) -> Links:
    """Pairs of candidates of two frames whose rays meet in a plausible place at like metric size.

    The place is the midpoint of the two rays (report eqs. 7.1 to 7.4).

    Parameters
    ----------
    sightings
        The window.
    older, newer
        Frames, as positions in the window.
    gates
        What a link must hold to.
    """
    n = len(sightings.rotation)
    if not (0 <= older < n and 0 <= newer < n):
        raise ValueError(f"wanted frames below {n}, found {older}, {newer}")
    s = sightings
    leading = [np.count_nonzero(s.leads[s.first[f] : s.first[f + 1]]) for f in (older, newer)]
    most = leading[0] * leading[1]
    rows, point = np.empty((most, 2), np.int64), np.empty((most, 3))
    size = np.empty((most, 2))
    count = _link(
        s.rotation, s.centre, s.focal, s.first, s.ray, s.size, s.leads, older, newer, gates.as_array(),
        rows, point, size,
    )  # fmt: skip
    return Links(
        rows[:count, 0].copy(), rows[:count, 1].copy(), point[:count].copy(), size[:count].copy()
    )


class Associated(NamedTuple):
    """For m places and n frames: row (m, n) of the sighting or -1; state (m, n) uint8; total (m,) sum of values."""

    row: NDArray[np.int32]
    state: NDArray[np.uint8]
    total: NDArray[np.float64]

    def views(self) -> NDArray[np.intp]:
        """Number of frames each place is seen in, (m,)."""
        return np.asarray(np.count_nonzero(self.row >= 0, axis=1))


def associate(
    sightings: Sightings,
    point: NDArray[np.floating[Any]],
    size: NDArray[np.floating[Any]],
    free: NDArray[np.bool_],
    gates: Gates,
) -> Associated:
    """Best free candidate for each place in each frame, by where and how large it must appear.

    Parameters
    ----------
    sightings
        The window, N rows.
    point, size
        Places (m, 3) in the world and their metric width and height (m, 2).
    free
        Rows that may be used, (N,).
    gates
        What a view must hold to, and what it is worth.
    """
    points, sizes = np.ascontiguousarray(point, np.float64), np.ascontiguousarray(size, np.float64)
    usable = np.ascontiguousarray(free, np.bool_)
    m, n = len(points), len(sightings.rotation)
    if points.shape != (m, 3) or sizes.shape != (m, 2) or usable.shape != sightings.score.shape:
        raise ValueError(
            f"wanted (m, 3), (m, 2), ({len(sightings.score)},), "
            f"found {points.shape}, {sizes.shape}, {usable.shape}"
        )
    row, state = np.full((m, n), -1, np.int32), np.zeros((m, n), np.uint8)
    total = np.zeros(m)
    s = sightings
    _associate(
        s.rotation, s.centre, s.focal, s.bounds, s.first, s.ray, s.size, s.score, points, sizes,
        usable, gates.as_array(), row, state, total,
    )  # fmt: skip
    return Associated(row, state, total)


@compiled
def _link(
    rotation: Array,
    centre: Array,
    focal: Array,
    first: NDArray[np.int64],
    ray: Array,
    size: Array,
    leads: NDArray[np.bool_],
    older: int,
    newer: int,
    gates: Array,
    rows: NDArray[np.int64],
    point: Array,
    metric: Array,
) -> int:
    gap_px, gap_share, taller, wider, nearest, farthest = gates[:6]
    aside, above, below, narrowest, lowest, widest, tallest = gates[6:13]
    # the newer camera's frame: its axes tell where a place is plausible
    r = rotation[newer].T @ rotation[older]
    base = rotation[newer].T @ (centre[older] - centre[newer])
    count = 0
    for i in range(first[older], first[older + 1]):
        if not leads[i]:
            continue
        px = r[0, 0] * ray[i, 0] + r[0, 1] * ray[i, 1] + r[0, 2]
        py = r[1, 0] * ray[i, 0] + r[1, 1] * ray[i, 1] + r[1, 2]
        pz = r[2, 0] * ray[i, 0] + r[2, 1] * ray[i, 1] + r[2, 2]
        for j in range(first[newer], first[newer + 1]):
            if not leads[j]:
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
            if not (g > nearest and nearest < h < farthest):
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
            if gap > gap_px + gap_share * f * size[j, 1]:
                continue
            # far away the horizon is not known well: the reach opens with depth
            loose = 0.06 * z
            if abs(x) > aside + loose or y > below + loose or -y > above + loose:
                continue
            wide, tall = np.sqrt(wide_old * wide_new), np.sqrt(tall_old * tall_new)
            if wide < narrowest or tall < lowest or wide > widest or tall > tallest:
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
    gates: Array,
    row: NDArray[np.int32],
    state: NDArray[np.uint8],
    total: Array,
) -> None:
    gap_px, gap_share, taller, wider, nearest, farthest = gates[:6]
    shift, least, most, gap_cost, miss, expected_px = gates[13:19]
    for m in range(point.shape[0]):
        wide, tall = metric[m, 0], metric[m, 1]
        for n in range(rotation.shape[0]):
            a = point[m, 0] - centre[n, 0]
            b = point[m, 1] - centre[n, 1]
            c = point[m, 2] - centre[n, 2]
            r = rotation[n]
            z = r[0, 2] * a + r[1, 2] * b + r[2, 2] * c
            if not nearest < z < farthest:
                continue
            x = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / z
            y = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / z
            if x < bounds[n, 0] or x > bounds[n, 2] or y < bounds[n, 1] or y > bounds[n, 3]:
                continue
            f = focal[n]
            half_wide, half_tall = wide / z / 2, tall / z / 2
            gate = gap_px / f + 2 * gap_share * half_tall
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
                if ratio > taller or ratio * taller < 1:
                    continue
                other = size[k, 0] * z / wide
                if other > wider or other * wider < 1:
                    continue
                this = min(most, max(least, score[k] + shift))
                this -= gap_cost * (gap2 / (gate * gate) + np.log(ratio) ** 2 / np.log(taller) ** 2)
                if this > value:
                    best, value = k, this
            if best >= 0:
                row[m, n], state[m, n] = best, SEEN
                total[m] += value
            elif (
                2 * half_tall * f >= expected_px
                and x - half_wide > bounds[n, 0]
                and x + half_wide < bounds[n, 2]
                and y - half_tall > bounds[n, 1]
                and y + half_tall < bounds[n, 3]
            ):
                state[m, n] = EMPTY
                total[m] -= miss
