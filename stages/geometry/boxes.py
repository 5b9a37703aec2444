"""Axis-aligned boxes `[x0, y0, x1, y1]`, half open: areas, intersection over union, suppression of overlapping ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, require_array


def box_areas(box: NDArray[np.floating[Any]]) -> Array:
    """Areas (...) of boxes (..., 4); 0 where a right or lower side lies before its opposite one."""
    sides = np.clip(box[..., 2:] - box[..., :2], 0, None)
    return np.asarray(np.prod(sides, axis=-1, dtype=np.float64))


def intersection_areas(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> Array:
    """Area that each box a (n, 4) shares with each box b (m, 4): (n, m)."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    return box_areas(np.concatenate([low, np.minimum(a[:, None, 2:], b[None, :, 2:])], axis=-1))


def iou_matrix(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> Array:
    """Intersection over union of each box a (n, 4) with each box b (m, 4): (n, m); 0 where both have no area."""
    shared = intersection_areas(a, b)
    union = box_areas(a)[:, None] + box_areas(b)[None] - shared
    return np.asarray(shared / np.maximum(union, 1e-9))


def covered_fractions(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> Array:
    """Fraction of the area of each box a (n, 4) that lies in each box b (m, 4): (n, m); 0 where a has no area."""
    return np.asarray(intersection_areas(a, b) / np.maximum(box_areas(a)[:, None], 1e-9))


def non_maximum_suppression(box: NDArray[np.float32], max_iou: float) -> NDArray[np.int64]:
    """Rows of the boxes (n, 4) float32, given best first, that no better kept box overlaps by more than `max_iou`.

    Greedy, as usual: each box is compared with those kept so far.

    Raises ValueError where the boxes are not (n, 4).
    """
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    kept = np.empty(len(box), np.int64)
    return kept[: _suppress(box, max_iou, kept)]


@compiled
def _suppress(box: Any, max_iou: Any, kept: Any) -> Any:
    count = 0
    for i in range(box.shape[0]):
        own = (box[i, 2] - box[i, 0]) * (box[i, 3] - box[i, 1])
        new = True
        for j in kept[:count]:
            w = min(box[i, 2], box[j, 2]) - max(box[i, 0], box[j, 0])
            if w <= 0:
                continue
            h = min(box[i, 3], box[j, 3]) - max(box[i, 1], box[j, 1])
            other = (box[j, 2] - box[j, 0]) * (box[j, 3] - box[j, 1])
            if h > 0 and w * h > max_iou * (own + other - w * h):
                new = False
                break
        if new:
            kept[count] = i
            count += 1
    return count
