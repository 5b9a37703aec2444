"""Matches of binary descriptors of corners inside predicted bands."""

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, compiled_within, require_array

CELL_PX = 32.0
"""Side of a cell of the index of corners; any value gives the same matches."""
SAME_CORNER_PX = 6.0
"""Corners this near to the best one are no second best: a corner is often found at several scales."""

Numbers = NDArray[np.int64]


def match_in_bands(
    bands: Array,
    descriptors: NDArray[np.uint8],
    points: Array,
    others: NDArray[np.uint8],
    farthest: int,
    ratio: float,
) -> Numbers:
    """Pairs of corners whose descriptors agree, one to one.

    `bands` (n, 6): where the match of each first corner may lie, px. Start (u, v), unit direction (u, v), length along
    it, half width across it and beyond both ends. `descriptors` (n, 32): of the first corners. `points` (m, 2), px,
    `others` (m, 32): positions and descriptors of the second corners. `farthest`: largest Hamming distance, bits.
    `ratio`: the best distance must lie below this fraction of the second best in the band.

    Returns (k, 2) rows: first corner, second corner; the closest first.

    Raises ValueError where an array has another shape or type.
    """
    n, m = len(bands), len(points)
    require_array(bands, "bands", np.float64, (n, 6))
    require_array(points, "points", np.float64, (m, 2))
    require_array(descriptors, "descriptors", np.uint8, (n, 32))
    require_array(others, "others", np.uint8, (m, 32))
    best = np.full((2, m), -1, np.int64)
    if m > 0:
        kinds = descriptors.view(np.uint64), others.view(np.uint64)
        _match(bands, *kinds, points, _by_cell(points), farthest, ratio, best)
    found = np.flatnonzero(best[0] >= 0)
    found = found[np.argsort(best[1, found], kind="stable")]
    return np.stack([best[0, found], found], axis=1)


def _by_cell(points: Array) -> tuple[Numbers, Numbers, Array, int, int]:
    # Points by cell, row after row, and the place of the first of each cell in that order. Corner and size of the grid.
    across = points.T.copy()
    low = across.min(axis=1)
    column, row = ((across - low[:, None]) / CELL_PX).astype(np.int64)
    columns, rows = int(column.max()) + 1, int(row.max()) + 1
    key = row * columns + column
    first = np.cumsum(np.bincount(key + 1, minlength=columns * rows + 1))
    # numbers of 16 bits are sorted several times as fast
    order = np.argsort(key.astype(np.min_scalar_type(columns * rows)), kind="stable")
    return order, first, low, columns, rows


@compiled_within
def _bits(word: np.uint64) -> np.uint64:
    # Population count; the compiler turns it into one instruction.
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@compiled
def _match(
    bands: Array,
    descriptors: NDArray[np.uint64],
    others: NDArray[np.uint64],
    points: Array,
    grid: tuple[Numbers, Numbers, Array, int, int],
    farthest: int,
    ratio: float,
    best: Numbers,
) -> None:
    # Fills the first corner that each second one matches best, and their distance.
    order, first, low, columns, rows = grid
    candidates, distances = np.empty((2, points.shape[0]), np.int64)
    for i in range(bands.shape[0]):
        u, v, du, dv, length, width = bands[i]
        # the cells that the band's box touches; clipped so that a band outside touches none
        left = np.floor((min(u, u + length * du) - width - low[0]) / CELL_PX)
        right = np.floor((max(u, u + length * du) + width - low[0]) / CELL_PX)
        top = np.floor((min(v, v + length * dv) - width - low[1]) / CELL_PX)
        bottom = np.floor((max(v, v + length * dv) + width - low[1]) / CELL_PX)
        if not (left < columns and top < rows and right >= 0 and bottom >= 0):
            continue
        column_from, column_to = int(max(0.0, left)), int(min(columns - 1.0, right))
        row_from, row_to = int(max(0.0, top)), int(min(rows - 1.0, bottom))
        count, least, winner = 0, 257, -1
        for row in range(row_from, row_to + 1):
            begin = first[row * columns + column_from]
            for j in order[begin : first[row * columns + column_to + 1]]:
                x, y = points[j, 0] - u, points[j, 1] - v
                along = x * du + y * dv
                if abs(x * dv - y * du) > width or along < -width or along > length + width:
                    continue
                bits = 0
                for word in range(4):
                    bits += int(_bits(descriptors[i, word] ^ others[j, word]))
                candidates[count], distances[count] = j, bits
                count += 1
                if bits < least:
                    least, winner = bits, j
        if winner < 0 or least > farthest:
            continue
        second = 257
        for k in range(count):
            j = candidates[k]
            apart = max(
                abs(points[j, 0] - points[winner, 0]), abs(points[j, 1] - points[winner, 1])
            )
            if apart > SAME_CORNER_PX and distances[k] < second:
                second = distances[k]
        if least < ratio * second and (best[0, winner] < 0 or least < best[1, winner]):
            # of several with the same best one the closest keeps it
            best[0, winner], best[1, winner] = i, least
