"""Axis-aligned boxes `[x0, y0, x1, y1]`, half open: areas, intersection over union, suppression of overlapping ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled, require_array

SLOTS = 1 << 13
"""Length of the hash table of kept boxes, a power of two."""


def box_areas(box: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Areas (...) of boxes (..., 4); 0 where a right or lower side lies before its opposite one."""
    sides = np.clip(box[..., 2:] - box[..., :2], 0, None)
    return np.asarray(np.prod(sides, axis=-1, dtype=np.float64))


def intersection_areas(
    a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]
) -> NDArray[np.float64]:
    """Area that each box a (n, 4) shares with each box b (m, 4): (n, m)."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    return box_areas(np.concatenate([low, high], axis=-1))


def iou_matrix(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Intersection over union of each box a (n, 4) with each box b (m, 4): (n, m); 0 where both have no area."""
    shared = intersection_areas(a, b)
    union = box_areas(a)[:, None] + box_areas(b)[None] - shared
    return np.asarray(shared / np.maximum(union, 1e-9))


def covered_fractions(
    a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]
) -> NDArray[np.float64]:
    """Fraction of the area of each box a (n, 4) that lies in each box b (m, 4): (n, m); 0 where a has no area."""
    return np.asarray(intersection_areas(a, b) / np.maximum(box_areas(a)[:, None], 1e-9))


def non_maximum_suppression(box: NDArray[np.float32], max_iou: float) -> NDArray[np.int64]:
    """Rows of the boxes (n, 4) float32, given best first, that no better kept box overlaps by more than `max_iou`.

    Greedy, as usual. Boxes that overlap by more than `max_iou` are about equally wide, and their centres lie within a
    fraction of the width of each other. Only boxes of such widths in the neighbouring vertical strips are compared. A
    hash of width class and strip finds them.

    Raises ValueError where the boxes are not (n, 4).
    """
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    kept = np.empty(len(box), np.int64)
    if len(box) == 0:
        return kept
    width = np.maximum(box[:, 2] - box[:, 0], np.float32(1e-3)).astype(np.float64)
    width_class = np.floor(np.log(width) / -np.log(max_iou)).astype(np.int64)
    return kept[: _suppress(box, max_iou, width_class, kept)]


@compiled
def _strip(box: Any, width_class: Any, max_iou: Any) -> Any:
    """Number of the vertical strip of the centre; strips suit boxes of that width class and the next."""
    strip = max_iou ** -(width_class + 2.0) * (1 - max_iou) / (1 + max_iou)
    return int(np.floor((box[0] + box[2]) / 2 / strip))


@compiled
def _slot(width_class: Any, strip: Any) -> Any:
    """Hash of a width class and a strip; several may share one slot."""
    return (width_class * 73856093 ^ strip * 19349663) & (SLOTS - 1)


@compiled
def _suppress(box: Any, max_iou: Any, width_class: Any, kept: Any) -> Any:
    # The kept boxes of each slot as a linked list: the last one, and the one before each.
    last = np.full(SLOTS, -1)
    before = np.empty(box.shape[0], np.int64)
    m = 0
    for i in range(box.shape[0]):
        own = (box[i, 2] - box[i, 0]) * (box[i, 3] - box[i, 1])
        new = True
        for near in range(9):
            other_class = width_class[i] + near // 3 - 1
            j = last[_slot(other_class, _strip(box[i], other_class, max_iou) + near % 3 - 1)]
            while j >= 0:
                w = min(box[i, 2], box[j, 2]) - max(box[i, 0], box[j, 0])
                h = min(box[i, 3], box[j, 3]) - max(box[i, 1], box[j, 1])
                if w > 0 and h > 0:
                    other = (box[j, 2] - box[j, 0]) * (box[j, 3] - box[j, 1])
                    if w * h > max_iou * (own + other - w * h):
                        new = False
                        break
                j = before[j]
            if not new:
                break
        if new:
            slot = _slot(width_class[i], _strip(box[i], width_class[i], max_iou))
            before[i] = last[slot]
            last[slot] = i
            kept[m] = i
            m += 1
    return m
