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
        _match(bands, *kinds, points, farthest, ratio, best)
    found = np.flatnonzero(best[0] >= 0)
    found = found[np.argsort(best[1, found], kind="stable")]
    return np.stack([best[0, found], found], axis=1)


@compiled_within
def _bits(word: np.uint64) -> np.uint64:
    # Population count; the compiler turns it into one instruction.
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@compiled_within
def _by_cell(points: Array) -> tuple[Numbers, Numbers, tuple[float, float], int, int]:
    # The points cell by cell of a grid, row after row, and the place of the first of each cell in that order.
    low_u, low_v = points[:, 0].min(), points[:, 1].min()
    columns = int((points[:, 0].max() - low_u) / CELL_PX) + 1
    rows = int((points[:, 1].max() - low_v) / CELL_PX) + 1
    key, order = np.empty((2, len(points)), np.int64)
    count = np.zeros(columns * rows + 1, np.int64)
    for j in range(len(points)):
        row, column = int((points[j, 1] - low_v) / CELL_PX), int((points[j, 0] - low_u) / CELL_PX)
        key[j] = row * columns + column
        count[key[j]] += 1
    first = np.cumsum(count)
    for j in range(len(points) - 1, -1, -1):
        first[key[j]] -= 1
        order[first[key[j]]] = j
    return order, first, (low_u, low_v), columns, rows


@compiled
def _match(
    bands: Array,
    descriptors: NDArray[np.uint64],
    others: NDArray[np.uint64],
    points: Array,
    farthest: int,
    ratio: float,
    best: Numbers,
) -> None:
    # Fills the first corner that each second one matches best, and their distance.
    order, first, (low_u, low_v), columns, rows = _by_cell(points)
    place, (candidates, distances) = points[order], np.empty((2, len(points) + 1), np.int64)
    for i in range(bands.shape[0]):
        u, v, du, dv, length, width = bands[i]
        # the cells that the band's box touches; clipped so that a band outside touches none
        left = (min(u, u + length * du) - width - low_u) / CELL_PX
        right = (max(u, u + length * du) + width - low_u) / CELL_PX
        top = (min(v, v + length * dv) - width - low_v) / CELL_PX
        bottom = (max(v, v + length * dv) + width - low_v) / CELL_PX
        if not (left < columns and top < rows and right >= 0 and bottom >= 0):
            continue
        column_from, column_to = int(max(0.0, left)), int(min(columns - 1.0, right))
        near = 0
        for row in range(int(max(0.0, top)), int(min(rows - 1.0, bottom)) + 1):
            begin, end = first[row * columns + column_from], first[row * columns + column_to + 1]
            for k in range(np.uint64(begin), np.uint64(end)):  # signed: tested for negative
                x, y = place[k, 0] - u, place[k, 1] - v
                along = x * du + y * dv
                candidates[np.uint64(near)] = order[k]
                inside = (along >= -width) & (along <= length + width)
                near += int(inside & (abs(x * dv - y * du) <= width))
        least, winner = 257, -1
        for k in range(near):
            bits = 0
            for word in range(4):
                bits += int(_bits(descriptors[i, word] ^ others[np.uint64(candidates[k]), word]))
            distances[k] = bits
            if bits < least:
                least, winner = bits, candidates[k]
        if winner < 0 or least > farthest:
            continue
        second = 257
        for k in range(near):
            j = candidates[k]
            aside, below = points[j, 0] - points[winner, 0], points[j, 1] - points[winner, 1]
            if max(abs(aside), abs(below)) > SAME_CORNER_PX and distances[k] < second:
                second = distances[k]
        if least < ratio * second and (best[0, winner] < 0 or least < best[1, winner]):
            # of several with the same best one the closest keeps it
            best[0, winner], best[1, winner] = i, least
