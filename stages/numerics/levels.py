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

from wayside.stages.numerics.compiled import compiled

SAME_BOX = 0.8
"""Overlap (IoU) down to which a growing component still has the box it had."""


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
    order = np.empty(start[levels], np.int32)
    at = start[:-1].copy()
    for i in range(flat.size):
        v = flat[i]
        if v >= lowest:
            k = rank[v]
            order[at[k]] = i
            at[k] += 1
    return order, start


@compiled
def _root(parent: Any, i: Any) -> Any:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled
def _overlap(a: Any, b: Any) -> Any:
    """IoU of two boxes, where a lies within b."""
    inner = (a[2] - a[0]) * (a[3] - a[1])
    outer = (b[2] - b[0]) * (b[3] - b[1])
    return inner / outer


@compiled
def _close(
    c: Any,
    level: Any,
    first: Any,
    last: Any,
    size: Any,
    born: Any,
    area: Any,
    limits: Any,
    lasting: Any,
    out: Any,
) -> None:
    """Report the box that component c had since level `born`, if it lasted and has a size of interest."""
    box, areas, lasted, m = out
    n = m[0]
    if born[c] < 0 or level - born[c] < lasting or n >= len(areas):
        return
    for k in range(4):
        box[n, k] = np.float32(0.5) * np.float32(first[c, k] + last[c, k])
    width = box[n, 2] - box[n, 0]
    height = box[n, 3] - box[n, 1]
    if width >= limits[0] and height >= limits[1] and width <= limits[2] and height <= limits[3]:
        areas[n] = size[c]
        lasted[n] = level - born[c]
        m[0] = n + 1


@compiled
def _sweep(values: Any, lowest: Any, step: Any, lasting: Any, limits: Any, capacity: Any) -> Any:
    height, width = values.shape
    order, start = _sorted_pixels(values, lowest, step)
    levels = len(start) - 1
    # Component of each pixel; a frame of one pixel spares the border tests.
    pitch = width + 2
    of = np.full((height + 2) * pitch, -1, np.int32)
    most = len(order) // 2 + 2
    parent = np.empty(most, np.int32)
    area = np.empty(most, np.int32)
    box = np.empty((most, 4), np.int16)
    first = np.empty((most, 4), np.int16)
    last = np.empty((most, 4), np.int16)
    size = np.zeros(most, np.int32)
    born = np.empty(most, np.int16)
    touched = np.empty(most, np.int32)
    stamp = np.empty(most, np.int16)
    out_box = np.empty((capacity, 4), np.float32)
    out_area = np.empty(capacity, np.int32)
    out_lasted = np.empty(capacity, np.int32)
    m = np.zeros(1, np.int64)
    out = (out_box, out_area, out_lasted, m)
    n = 0
    beside = np.array([-1, 1, -pitch, pitch])
    for level in range(levels):
        t = 0
        for q in range(start[level], start[level + 1]):
            y = order[q] // width
            x = order[q] - y * width
            p = (y + 1) * pitch + x + 1
            c = -1
            for k in range(4):
                o = of[p + beside[k]]
                if o < 0:
                    continue
                r = _root(parent, o)
                if c < 0:
                    c = r
                elif r != c:
                    if area[r] > area[c]:
                        r, c = c, r
                    if size[r] > 0:
                        _close(r, level, first, last, size, born, area, limits, lasting, out)
                    parent[r] = c
                    area[c] += area[r]
                    box[c, 0] = min(box[c, 0], box[r, 0])
                    box[c, 1] = min(box[c, 1], box[r, 1])
                    box[c, 2] = max(box[c, 2], box[r, 2])
                    box[c, 3] = max(box[c, 3], box[r, 3])
            if c < 0:
                c = n
                n += 1
                parent[c] = c
                area[c] = 0
                box[c, 0] = x
                box[c, 1] = y
                box[c, 2] = x + 1
                box[c, 3] = y + 1
                size[c] = 0
                born[c] = -1
                stamp[c] = -1
            of[p] = c
            area[c] += 1
            box[c, 0] = min(box[c, 0], x)
            box[c, 1] = min(box[c, 1], y)
            box[c, 2] = max(box[c, 2], x + 1)
            box[c, 3] = max(box[c, 3], y + 1)
            if stamp[c] != level:
                stamp[c] = level
                touched[t] = c
                t += 1
        for q in range(t):
            c = touched[q]
            if parent[c] != c:
                continue
            w = box[c, 2] - box[c, 0]
            h = box[c, 3] - box[c, 1]
            if w < limits[0] - 2 or h < limits[1] - 2:
                continue
            if born[c] >= 0 and _overlap(first[c], box[c]) >= SAME_BOX:
                last[c] = box[c]
                size[c] = area[c]
                continue
            _close(c, level, first, last, size, born, area, limits, lasting, out)
            if w > limits[2] + 2 or h > limits[3] + 2:
                born[c] = -1
                size[c] = 0
                continue
            first[c] = box[c]
            last[c] = box[c]
            size[c] = area[c]
            born[c] = level
    for c in range(n):
        if parent[c] == c and size[c] > 0:
            _close(c, levels, first, last, size, born, area, limits, lasting, out)
    k = m[0]
    return out_box[:k].copy(), out_area[:k].copy(), out_lasted[:k].copy()
