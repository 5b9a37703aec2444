"""Stable regions of an image of one value: components of a threshold sweep whose box stays the same over levels.

A sign face is one connected region at *some* level of *some* map, seldom at a level known beforehand. So all levels are
swept from the top down; pixels join the components they touch (union-find), and a component's box is reported when it
stayed nearly the same over several levels: the maximally stable extremal regions (MSER) of Matas et al. 2002, with the
stability of the box in the place of the stability of the area.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled

PARENT, AREA, BOX, STAMP, BORN, FIRST, LAST, SIZE = 0, 1, 2, 6, 7, 8, 12, 16
COLUMNS = 17
"""Columns of a component: its parent, pixels, box, level that last touched it, level since when it has the box, that
box at first and at last, and its pixels at last."""


@dataclass(frozen=True, slots=True)
class StableRegions:
    """Stable boxes, m rows.

    box (m, 4) float32 `[x0, y0, x1, y1]`, half open; area (m,) int32 px; lifetime (m,) int32 levels.
    """

    box: NDArray[np.float32]
    area: NDArray[np.int32]
    lifetime: NDArray[np.int32]


def find_stable_regions(
    values: NDArray[np.uint8],
    *,
    first_level: int,
    step: int,
    min_lifetime: int,
    same_iou: float,
    smallest: tuple[int, int],
    largest: tuple[int, int],
    capacity: int,
) -> StableRegions:
    """Boxes of connected components (4 neighbours) of `values >= level` that stay the same over levels.

    Parameters
    ----------
    values : (height, width) uint8
        The map; faces are brighter than what surrounds them.
    first_level : int
        Pixels below take no part (at least 1): the sparser the map, the cheaper.
    step : int
        Levels are `first_level, first_level + step, ...`; finer steps only meet noise.
    min_lifetime : int
        Levels over which a box must stay the same.
    same_iou : float
        A box is the same as the first of its component down to this IoU.
    smallest, largest : (width, height) in pixels
        Boxes outside are not reported.
    capacity : int
        Most rows; the first ones met (from the top level down) are kept.

    Returns
    -------
    StableRegions
        In the order in which the boxes ended; the box reported is the mean of its first and last state.

    Raises
    ------
    ValueError
        Where `values` is no two-dimensional uint8 array or `first_level`, `step` are not positive.
    """
    if values.ndim != 2 or values.dtype != np.uint8:
        raise ValueError(
            f"values must be a two-dimensional uint8 array, found {values.ndim} dimensions of {values.dtype}"
        )
    if first_level < 1 or step < 1:
        raise ValueError(f"first_level and step must be at least 1, found {first_level} and {step}")
    if values.size == 0:
        return StableRegions(
            np.zeros((0, 4), np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
        )
    box, area, lifetime = _sweep(
        np.ascontiguousarray(values),
        first_level,
        step,
        min_lifetime,
        same_iou,
        np.array([*smallest, *largest], np.int32),
        capacity,
    )
    return StableRegions(box, area, lifetime)


@compiled
def _sorted_pixels(values: Any, first_level: Any, step: Any) -> Any:
    """Positions of the pixels that take part, by falling level, and where each level starts."""
    levels = (255 - first_level) // step + 1
    start = np.zeros(levels + 1, np.int64)
    flat = values.reshape(-1)
    rank = np.full(256, -1, np.int16)
    for v in range(first_level, 256):
        rank[v] = levels - 1 - (v - first_level) // step
    count = np.zeros(256, np.int64)
    for i in range(flat.size):
        count[flat[i]] += 1
    for v in range(first_level, 256):
        start[rank[v] + 1] += count[v]
    for k in range(levels):
        start[k + 1] += start[k]
    order = np.empty(start[levels], np.uint32)
    at = start[:-1].copy()
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            v = values[y, x]
            if v >= first_level:
                k = rank[v]
                order[at[k]] = (y << 16) | x
                at[k] += 1
    return order, start


@compiled
def _root(part: Any, i: Any) -> Any:
    while part[i, PARENT] != i:
        part[i, PARENT] = part[part[i, PARENT], PARENT]
        i = part[i, PARENT]
    return i


@compiled
def _same_box(one: Any, same_iou: Any) -> Any:
    """Whether the component's box overlaps the one that it had first by at least `same_iou`."""
    before = (one[FIRST + 2] - one[FIRST]) * (one[FIRST + 3] - one[FIRST + 1])
    now = (one[BOX + 2] - one[BOX]) * (one[BOX + 3] - one[BOX + 1])
    return before >= same_iou * now


@compiled
def _report(one: Any, level: Any, limits: Any, min_lifetime: Any, out: Any) -> None:
    """Note the box that a component had since level `BORN`, if it lifetime and has a size of interest."""
    box, areas, lifetime, m = out
    n = m[0]
    if one[BORN] < 0 or level - one[BORN] < min_lifetime or n >= len(areas):
        return
    for k in range(4):
        box[n, k] = np.float32(0.5) * np.float32(one[FIRST + k] + one[LAST + k])
    width = box[n, 2] - box[n, 0]
    height = box[n, 3] - box[n, 1]
    if width >= limits[0] and height >= limits[1] and width <= limits[2] and height <= limits[3]:
        areas[n] = one[SIZE]
        lifetime[n] = level - one[BORN]
        m[0] = n + 1


@compiled
def _merge(a: Any, b: Any) -> None:
    """Add component b to component a."""
    a[AREA] += b[AREA]
    a[BOX] = min(a[BOX], b[BOX])
    a[BOX + 1] = min(a[BOX + 1], b[BOX + 1])
    a[BOX + 2] = max(a[BOX + 2], b[BOX + 2])
    a[BOX + 3] = max(a[BOX + 3], b[BOX + 3])


@compiled
def _end_level(
    one: Any, level: Any, limits: Any, min_lifetime: Any, same_iou: Any, out: Any
) -> None:
    """At the end of a level: the box goes on, or it is reported and a new one begins."""
    width = one[BOX + 2] - one[BOX]
    height = one[BOX + 3] - one[BOX + 1]
    if width < limits[0] - 2 or height < limits[1] - 2:
        return
    if one[BORN] < 0 or not _same_box(one, same_iou):
        _report(one, level, limits, min_lifetime, out)
        if width > limits[2] + 2 or height > limits[3] + 2:
            one[BORN] = -1
            return
        one[BORN] = level
        for k in range(4):
            one[FIRST + k] = one[BOX + k]
    for k in range(4):
        one[LAST + k] = one[BOX + k]
    one[SIZE] = one[AREA]


@compiled
def _sweep(
    values: Any,
    first_level: Any,
    step: Any,
    min_lifetime: Any,
    same_iou: Any,
    limits: Any,
    capacity: Any,
) -> Any:
    height, width = values.shape
    order, start = _sorted_pixels(values, first_level, step)
    # Component of each pixel; a frame of one pixel spares the border tests.
    pitch = width + 2
    of = np.full((height + 2) * pitch, -1, np.int32)
    # The pixels that begin a component are no neighbours of each other, so they are at most half of the image. One
    # row for each component, since a pixel touches most of it.
    most = min(len(order), (values.size + 1) // 2)
    part = np.empty((most, COLUMNS), np.int32)
    touched = np.empty(len(part), np.int32)
    box = np.empty((capacity, 4), np.float32)
    area = np.empty(capacity, np.int32)
    lifetime = np.empty(capacity, np.int32)
    m = np.zeros(1, np.int64)
    out = (box, area, lifetime, m)
    n = 0
    previous = -1
    c = -1
    for level in range(len(start) - 1):
        t = 0
        for q in range(start[level], start[level + 1]):
            y = np.int32(order[q] >> 16)
            x = np.int32(order[q] & 0xFFFF)
            p = (y + 1) * pitch + x + 1
            # Right after its left neighbour a pixel belongs to what that one belongs to.
            if p != previous + 1:
                c = -1
                if of[p - 1] >= 0:
                    c = _root(part, of[p - 1])
            previous = p
            for side in range(3):
                o = of[p + 1 if side == 0 else p - pitch if side == 1 else p + pitch]
                if o < 0 or o == c:
                    continue
                r = _root(part, o)
                if c < 0:
                    c = r
                elif r != c:
                    if part[r, AREA] > part[c, AREA]:
                        r, c = c, r
                    _report(part[r], level, limits, min_lifetime, out)
                    part[r, PARENT] = c
                    _merge(part[c], part[r])
            if c < 0:
                c = n
                n += 1
                part[c, PARENT] = c
                part[c, AREA] = 0
                part[c, BOX] = x
                part[c, BOX + 1] = y
                part[c, BOX + 2] = x + 1
                part[c, BOX + 3] = y + 1
                part[c, BORN] = -1
                part[c, STAMP] = -1
            of[p] = c
            part[c, AREA] += 1
            part[c, BOX] = min(part[c, BOX], x)
            part[c, BOX + 1] = min(part[c, BOX + 1], y)
            part[c, BOX + 2] = max(part[c, BOX + 2], x + 1)
            part[c, BOX + 3] = max(part[c, BOX + 3], y + 1)
            if part[c, STAMP] != level:
                part[c, STAMP] = level
                touched[t] = c
                t += 1
        for q in range(t):
            if part[touched[q], PARENT] == touched[q]:
                _end_level(part[touched[q]], level, limits, min_lifetime, same_iou, out)
    for c in range(n):
        if part[c, PARENT] == c:
            _report(part[c], len(start) - 1, limits, min_lifetime, out)
    return box[: m[0]].copy(), area[: m[0]].copy(), lifetime[: m[0]].copy()
