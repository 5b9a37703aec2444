"""Connected regions of a label image by run-length union-find, with area, box and mean colour.

Each row becomes runs of one label; runs that overlap a run of the same label in the row above are joined (4
neighbours). The loops over pixels and over pairs of runs have no branches: an image of a road has some 10^6 runs, and
their number, not arithmetic, is what this costs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled, require_array

WIDEST = 65535
"""Ends of runs are kept in 16 bits."""


@dataclass(frozen=True, slots=True)
class ConnectedRegions:
    """Regions between the two sizes, m parallel rows in reading order of their first pixel.

    `box` (m, 4) int32 [x0, y0, x1, y1] half open, area (m,) int32 pixels, rgb (m, 3) float32 mean colour. `total`: how
    many regions the image has before the gate.
    """

    box: NDArray[np.int32]
    area: NDArray[np.int32]
    rgb: NDArray[np.float32]
    total: int


def connected_regions(
    labels: NDArray[np.uint8],
    rgb: NDArray[np.uint8],
    smallest_px: int,
    largest_px: int,
) -> ConnectedRegions:
    """Regions of equal label (4 neighbours) whose area is from `smallest_px` to `largest_px`, both included.

    Parameters
    ----------
    labels
        Label image, (height, width) uint8, C-contiguous.
    rgb
        The image, (height, width, 3) uint8, C-contiguous.
    smallest_px, largest_px
        The size gate (report chapter 3.1); at least 1.

    Raises
    ------
    ValueError
        If an array is of another type, shape or layout, the image is wider than 65535 px, or the gate is below 1 px.
    """
    require_array(labels, "labels", np.uint8, (None, None))
    height, width = labels.shape
    require_array(rgb, "rgb", np.uint8, (height, width, 3))
    if width > WIDEST:
        raise ValueError(f"labels: {width} columns are more than {WIDEST}. Tile the image.")
    if smallest_px < 1:
        raise ValueError(f"smallest_px: {smallest_px} is less than 1")
    if width == 0:
        labels, rgb, height = labels[:0], rgb[:0], 0
    runs = height * width
    end, label = np.empty(runs + 1, np.uint16), np.empty(runs + 1, np.uint8)
    parent, area = np.empty(runs, np.int32), np.empty(runs, np.int32)
    first = np.empty(height + 1, np.int32)
    total = _join_runs(labels, end, label, parent, first)
    kept = _sum_areas(end, parent, first, area, smallest_px, largest_px)
    box, region_area = np.empty((kept, 4), np.int32), np.empty(kept, np.int32)
    sums = np.zeros((kept, 3), np.int64)
    _measure(rgb, end, parent, first, area, box, region_area, sums)
    rgb_mean = (sums / np.maximum(region_area, 1)[:, None]).astype(np.float32)
    return ConnectedRegions(box, region_area, rgb_mean, total)


@compiled
def _runs_of_row(
    row: NDArray[np.uint8], n: int, end: NDArray[np.uint16], label: NDArray[np.uint8]
) -> int:
    """Append the runs of one row; entry n is written over until its run ends."""
    last = row[0]
    for x in range(1, row.size):
        this = row[x]
        end[n] = x
        label[n] = last
        n += this != last
        last = this
    end[n] = row.size
    label[n] = last
    return n + 1


@compiled
def _pairs(
    above: int,
    start: int,
    stop: int,
    end: NDArray[np.uint16],
    label: NDArray[np.uint8],
    upper: NDArray[np.int32],
    lower: NDArray[np.int32],
) -> int:
    """List the runs of the row above (above..start) that touch an equal one of this row (start..stop).

    Runs tile their rows, so every pair met on the way overlaps.
    """
    i = above
    j = start
    n = 0
    while j < stop:
        a = end[i]
        b = end[j]
        upper[n] = i
        lower[n] = j
        n += label[i] == label[j]
        i += a <= b
        j += b <= a
    return n


@compiled
def _join_runs(
    labels: NDArray[np.uint8],
    end: NDArray[np.uint16],
    label: NDArray[np.uint8],
    parent: NDArray[np.int32],
    first: NDArray[np.int32],
) -> int:
    """Runs of all rows and the tree of those that belong together; a parent has the smaller number. Number of trees."""
    height, width = labels.shape
    upper = np.empty(2 * width + 2, np.int32)
    lower = np.empty(2 * width + 2, np.int32)
    joined = 0
    first[0] = 0
    for y in range(height):
        start = first[y]
        n = _runs_of_row(labels[y], start, end, label)
        first[y + 1] = n
        for i in range(start, n):
            parent[i] = i
        if y > 0:
            pairs = _pairs(first[y - 1], start, n, end, label, upper, lower)
            for k in range(pairs):
                i = upper[k]
                j = lower[k]
                a = parent[i]
                while parent[a] != a:
                    parent[a] = parent[parent[a]]
                    a = parent[a]
                b = parent[j]
                if b == j:
                    parent[j] = a
                    joined += 1
                    continue
                while parent[b] != b:
                    b = parent[b]
                if a < b:
                    parent[b] = a
                    parent[j] = a
                    joined += 1
                elif b < a:
                    parent[a] = b
                    parent[i] = b
                    joined += 1
    return int(first[height]) - joined


@compiled
def _sum_areas(
    end: NDArray[np.uint16],
    parent: NDArray[np.int32],
    first: NDArray[np.int32],
    area: NDArray[np.int32],
    smallest: int,
    largest: int,
) -> int:
    """Let every run point at its root and sum up areas there; number of regions inside the gate.

    Parents have smaller numbers, so in rising order the parent's parent is the root already.
    """
    height = first.shape[0] - 1
    for i in range(first[height]):
        area[i] = 0
    for y in range(height):
        x = np.int32(0)
        for i in range(first[y], first[y + 1]):
            stop = np.int32(end[i])
            root = parent[parent[i]]
            parent[i] = root
            area[root] += stop - x
            x = stop
    kept = 0
    for i in range(first[height]):
        inside = (area[i] >= smallest) & (area[i] <= largest)
        kept += inside
        area[i] = area[i] if inside else 0
    return kept


@compiled
def _measure(
    rgb: NDArray[np.uint8],
    end: NDArray[np.uint16],
    parent: NDArray[np.int32],
    first: NDArray[np.int32],
    area: NDArray[np.int32],
    box: NDArray[np.int32],
    region_area: NDArray[np.int32],
    sums: NDArray[np.int64],
) -> None:
    """Box, area and colour sums of the regions inside the gate; only their pixels are read.

    `area` at a root is 0 where its region is left out, the area before it has a row, and minus one minus its row then.
    """
    rows = 0
    for y in range(rgb.shape[0]):
        start = first[y]
        for i in range(start, first[y + 1]):
            root = parent[i]
            mark = area[root]
            if mark == 0:
                continue
            x0 = np.int32(end[i - 1]) if i > start else np.int32(0)
            x1 = np.int32(end[i])
            if mark > 0:
                box[rows, 0] = x0
                box[rows, 1] = y
                box[rows, 2] = x1
                region_area[rows] = mark
                mark = np.int32(-1 - rows)
                area[root] = mark
                rows += 1
            row = -1 - mark
            red, green, blue = 0, 0, 0
            for x in range(x0, x1):
                red += rgb[y, x, 0]
                green += rgb[y, x, 1]
                blue += rgb[y, x, 2]
            sums[row, 0] += red
            sums[row, 1] += green
            sums[row, 2] += blue
            box[row, 0] = min(box[row, 0], x0)
            box[row, 2] = max(box[row, 2], x1)
            box[row, 3] = y + 1
