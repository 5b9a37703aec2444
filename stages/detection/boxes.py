"""Small things done with many boxes `[x0, y0, x1, y1]`, half open, pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled, require_array, require_image

STACKED_EDGE, STACKED_GAP, STACKED_EDGE_PX, STACKED_GAP_PX = 0.15, 0.35, 1.5, 2.0
"""How far the sides of stacked boxes may differ, and how far one may stand above the other: shares of the narrower and
of the lower of the two, but at least so many pixels."""

SLOTS = 1 << 13
"""Length of the table by which like boxes are found."""


def distinct_boxes(box: NDArray[np.float32], same: float) -> NDArray[np.int64]:
    """Rows of the boxes (n, 4) float32 that overlap no earlier kept one by more than `same` (IoU), in order."""
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    kept = np.empty(len(box), np.int64)
    if len(box) == 0:
        return kept
    # Boxes that overlap by more than `same` are about equally wide, and their centres lie within a share of the width
    # of each other: so it is enough to look among boxes of such widths in the neighbouring strips of the picture.
    width = np.maximum(box[:, 2] - box[:, 0], np.float32(1e-3)).astype(np.float64)
    size = np.floor(np.log(width) / -np.log(same)).astype(np.int64)
    return kept[: _distinct(box, same, size, kept)]


def suppressed_boxes(box: NDArray[np.float32], same: float) -> NDArray[np.bool_]:
    """Which boxes (n, 4), given best first, overlap a better one that stays by more than `same` (IoU)."""
    hidden = np.ones(len(box), np.bool_)
    hidden[distinct_boxes(box, same)] = False
    return hidden


def stacked_pairs(box: NDArray[np.float32]) -> NDArray[np.int64]:
    """Pairs of rows (m, 2) of boxes (n, 4) that stand one above the other, equally wide: upper, lower.

    Faces of several colours come apart into such pieces: stripes, halves, a shield under its band.
    """
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    order = np.argsort(box[:, 0], kind="stable")
    count = _stacked(box[order], np.empty((0, 2), np.int64))
    pairs = np.empty((count, 2), np.int64)
    _stacked(box[order], pairs)
    return np.asarray(order[pairs], np.int64).reshape(-1, 2)


def overlap_of(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """IoU of each box a (n, 4) with each box b (m, 4): (n, m)."""
    shared = shared_of(a, b)
    own = np.prod(a[:, 2:] - a[:, :2], axis=1, dtype=np.float64)
    other = np.prod(b[:, 2:] - b[:, :2], axis=1, dtype=np.float64)
    return np.asarray(shared / np.maximum(own[:, None] + other[None] - shared, 1e-9))


def shared_of(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Area that each box a (n, 4) shares with each box b (m, 4): (n, m), square pixels."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    return np.asarray(np.prod(np.clip(high - low, 0, None), axis=2, dtype=np.float64))


def patch_means(
    rgb: NDArray[np.uint8], values: NDArray[np.uint8], box: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Mean colour (n, 3) of the brighter part of a map in each box: where `values` is at least its mean there.

    rgb (height, width, 3) and values (height, width) uint8; boxes inside the picture.
    At most about 24 x 24 samples a box are looked at.
    """
    require_image(rgb)
    require_array(values, "values", np.uint8, rgb.shape[:2])
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    result = np.zeros((len(box), 3), np.float32)
    _patch_means(rgb, values, box, result)
    return result


@compiled
def _stacked(box: Any, pairs: Any) -> Any:
    # Boxes by their left side; writes the pairs as long as there is room, and counts them all.
    m = 0
    for i in range(box.shape[0]):
        wide = box[i, 2] - box[i, 0]
        for j in range(i + 1, box.shape[0]):
            if box[j, 0] - box[i, 0] > max(STACKED_EDGE * wide, STACKED_EDGE_PX):
                break
            edge = max(STACKED_EDGE * min(wide, box[j, 2] - box[j, 0]), STACKED_EDGE_PX)
            if box[j, 0] - box[i, 0] > edge or abs(box[j, 2] - box[i, 2]) > edge:
                continue
            upper, lower = (i, j) if box[i, 1] + box[i, 3] < box[j, 1] + box[j, 3] else (j, i)
            tall = min(box[i, 3] - box[i, 1], box[j, 3] - box[j, 1])
            gap = box[lower, 1] - box[upper, 3]
            if gap < -STACKED_GAP * tall or gap > max(STACKED_GAP * tall, STACKED_GAP_PX):
                continue
            if m < pairs.shape[0]:
                pairs[m, 0], pairs[m, 1] = upper, lower
            m += 1
    return m


@compiled
def _strip(box: Any, size: Any, same: Any) -> Any:
    """Number of the vertical strip that the centre lies in; strips suit boxes of that size and the next."""
    return int(np.floor((box[0] + box[2]) / 2 / (same ** -(size + 2.0) * (1 - same) / (1 + same))))


@compiled
def _slot(size: Any, strip: Any) -> Any:
    """Place of a strip in the table of chains; several strips may share one."""
    return (size * 73856093 ^ strip * 19349663) & (SLOTS - 1)


@compiled
def _distinct(box: Any, same: Any, size: Any, kept: Any) -> Any:
    # The kept boxes of each slot as a chain: the last one, and the one before each.
    last = np.full(SLOTS, -1)
    before = np.empty(box.shape[0], np.int64)
    m = 0
    for i in range(box.shape[0]):
        own = (box[i, 2] - box[i, 0]) * (box[i, 3] - box[i, 1])
        new = True
        for near in range(9):
            other_size = size[i] + near // 3 - 1
            j = last[_slot(other_size, _strip(box[i], other_size, same) + near % 3 - 1)]
            while j >= 0:
                w = min(box[i, 2], box[j, 2]) - max(box[i, 0], box[j, 0])
                h = min(box[i, 3], box[j, 3]) - max(box[i, 1], box[j, 1])
                if w > 0 and h > 0:
                    other = (box[j, 2] - box[j, 0]) * (box[j, 3] - box[j, 1])
                    if w * h > same * (own + other - w * h):
                        new = False
                        break
                j = before[j]
            if not new:
                break
        if new:
            slot = _slot(size[i], _strip(box[i], size[i], same))
            before[i] = last[slot]
            last[slot] = i
            kept[m] = i
            m += 1
    return m


@compiled
def _patch_means(rgb: Any, values: Any, box: Any, result: Any) -> None:
    height, width = values.shape
    for i in range(box.shape[0]):
        x0 = max(0, int(box[i, 0]))
        y0 = max(0, int(box[i, 1]))
        x1 = min(width, int(np.ceil(box[i, 2])))
        y1 = min(height, int(np.ceil(box[i, 3])))
        dx = max(1, (x1 - x0) // 24)
        dy = max(1, (y1 - y0) // 24)
        total = 0
        n = 0
        for y in range(y0, y1, dy):
            for x in range(x0, x1, dx):
                total += values[y, x]
                n += 1
        r = 0
        g = 0
        b = 0
        m = 0
        for y in range(y0, y1, dy):
            for x in range(x0, x1, dx):
                if values[y, x] * n >= total:
                    r += rgb[y, x, 0]
                    g += rgb[y, x, 1]
                    b += rgb[y, x, 2]
                    m += 1
        if m > 0:
            result[i, 0] = r / m
            result[i, 1] = g / m
            result[i, 2] = b / m
