"""Regions at all levels of a picture of one value: a component tree, kept only where a box lasts.

A sign face is one connected region at *some* level of *some* map, seldom at a level known beforehand. So
all levels are swept from the top down; pixels join the components they touch (union-find), and a
component's box is reported when it stayed nearly the same over several levels: the maximally stable
regions of Matas et al. 2002, with the stability of the box in the place of the stability of the area.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled

SAME_BOX = 0.8
"""Overlap (IoU) down to which a growing component still has the box it had."""

PARENT, AREA, BOX, STAMP, BORN, FIRST, LAST, SIZE = 0, 1, 2, 6, 7, 8, 12, 16
COLUMNS = 17
"""Columns of a component: the one it was joined to, pixels, box, level that last touched it, level since when it has
the box, that box at first and at last, and its pixels at last."""


@dataclass(frozen=True, slots=True)
class LevelRegions:
    """Boxes that lasted, m rows.

    box (m, 4) float32 `[x0, y0, x1, y1]`, half open; area (m,) int32 px; lasted (m,) int32 levels.
    """

    box: NDArray[np.float32]
    area: NDArray[np.int32]
    lasted: NDArray[np.int32]


def level_regions(
    values: NDArray[np.uint8],
    *,
    lowest: int,
    step: int = 1,
    lasting: int = 2,
    smallest: tuple[int, int] = (5, 8),
    largest: tuple[int, int] = (400, 400),
    capacity: int = 20_000,
) -> LevelRegions:
    """Boxes of connected components (4 neighbours) of `values >= level` that last over levels.

    Parameters
    ----------
    values : (height, width) uint8
        The map; faces are brighter than what surrounds them.
    lowest : int
        Pixels below never take part (at least 1): the sparser the map, the cheaper.
    step : int
        Levels are `lowest, lowest + step, ...`; finer steps only meet noise.
    lasting : int
        Levels over which a box must last (IoU of at least `SAME_BOX` with its first).
    smallest, largest : (width, height) in pixels
        Boxes outside are not reported.
    capacity : int
        At most so many rows, the first ones met (from the top level down).

    Returns
    -------
    LevelRegions
        In the order in which the boxes ended; the box reported is the mean of its first and last state.

    Raises
    ------
    ValueError
        Where `values` is no two-dimensional uint8 array or `lowest`, `step` are not positive.
    """
    if values.ndim != 2 or values.dtype != np.uint8:
        raise ValueError(
            f"values must be a two-dimensional uint8 array, found {values.ndim} dimensions of {values.dtype}"
        )
    if lowest < 1 or step < 1:
        raise ValueError(f"lowest and step must be at least 1, found {lowest} and {step}")
    if values.size == 0:
        return LevelRegions(
            np.zeros((0, 4), np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)
        )
    box, area, lasted = _sweep(
        np.ascontiguousarray(values),
        lowest,
        step,
        lasting,
        np.array([*smallest, *largest], np.int32),
        capacity,
    )
    return LevelRegions(box, area, lasted)


@compiled
def _sorted_pixels(values: Any, lowest: Any, step: Any) -> Any:
    """Positions of the pixels that take part, by falling level, and where each level starts."""
    levels = (255 - lowest) // step + 1
    start = np.zeros(levels + 1, np.int64)
    flat = values.reshape(-1)
    rank = np.full(256, -1, np.int16)
    for v in range(lowest, 256):
        rank[v] = levels - 1 - (v - lowest) // step
    count = np.zeros(256, np.int64)
    for i in range(flat.size):
        count[flat[i]] += 1
    for v in range(lowest, 256):
        start[rank[v] + 1] += count[v]
    for k in range(levels):
        start[k + 1] += start[k]
    order = np.empty(start[levels], np.uint32)
    at = start[:-1].copy()
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            v = values[y, x]
            if v >= lowest:
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
def _same_box(one: Any) -> Any:
    """Whether the box that the component has now still is the one that it had first."""
    before = (one[FIRST + 2] - one[FIRST]) * (one[FIRST + 3] - one[FIRST + 1])
    now = (one[BOX + 2] - one[BOX]) * (one[BOX + 3] - one[BOX + 1])
    return before >= SAME_BOX * now


@compiled
def _report(one: Any, level: Any, limits: Any, lasting: Any, out: Any) -> None:
    """Note the box that a component had since level `BORN`, if it lasted and has a size of interest."""
    box, areas, lasted, m = out
    n = m[0]
    if one[BORN] < 0 or level - one[BORN] < lasting or n >= len(areas):
        return
    for k in range(4):
        box[n, k] = np.float32(0.5) * np.float32(one[FIRST + k] + one[LAST + k])
    width = box[n, 2] - box[n, 0]
    height = box[n, 3] - box[n, 1]
    if width >= limits[0] and height >= limits[1] and width <= limits[2] and height <= limits[3]:
        areas[n] = one[SIZE]
        lasted[n] = level - one[BORN]
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
def _settle(one: Any, level: Any, limits: Any, lasting: Any, out: Any) -> None:
    """At the end of a level: the box goes on, or it is reported and a new one begins."""
    width = one[BOX + 2] - one[BOX]
    height = one[BOX + 3] - one[BOX + 1]
    if width < limits[0] - 2 or height < limits[1] - 2:
        return
    if one[BORN] < 0 or not _same_box(one):
        _report(one, level, limits, lasting, out)
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
def _sweep(values: Any, lowest: Any, step: Any, lasting: Any, limits: Any, capacity: Any) -> Any:
    height, width = values.shape
    order, start = _sorted_pixels(values, lowest, step)
    # Component of each pixel; a frame of one pixel spares the border tests.
    pitch = width + 2
    of = np.full((height + 2) * pitch, -1, np.int32)
    # The pixels that begin a component are no neighbours of each other, so they are at most half of the picture. One
    # row for each component, since a pixel touches most of it.
    most = min(len(order), (values.size + 1) // 2)
    part = np.empty((most, COLUMNS), np.int32)
    touched = np.empty(len(part), np.int32)
    box = np.empty((capacity, 4), np.float32)
    area = np.empty(capacity, np.int32)
    lasted = np.empty(capacity, np.int32)
    m = np.zeros(1, np.int64)
    out = (box, area, lasted, m)
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
                    _report(part[r], level, limits, lasting, out)
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
                _settle(part[touched[q]], level, limits, lasting, out)
    for c in range(n):
        if part[c, PARENT] == c:
            _report(part[c], len(start) - 1, limits, lasting, out)
    return box[: m[0]].copy(), area[: m[0]].copy(), lasted[: m[0]].copy()
