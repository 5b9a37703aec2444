"""When two boxes in one image show the same thing."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import box_areas, iou_matrix

SMALLEST_IOU, LARGEST_AREA_RATIO = 0.3, 5.0

Box = Sequence[float]


def same_thing(a: Box, b: Box) -> bool:
    """Whether boxes overlap well, or `a` has its centre in `b` and about its size."""
    return bool(overlap(np.array([a]), b)[0] > 0)


def overlap(boxes: NDArray[np.floating[Any]], box: Box) -> NDArray[np.float64]:
    """IoU (n,) of each of `boxes` (n, 4) with `box` where both show the same thing (see `same_thing`), else 0."""
    if len(boxes) == 0:
        return np.zeros(0)
    target = np.asarray(box, np.float64)[None]
    a = np.asarray(boxes, np.float64)
    iou = iou_matrix(a, target)[:, 0]
    ratio = np.maximum(box_areas(a), 1e-9) / np.maximum(box_areas(target), 1e-9)
    centre = (a[:, :2] + a[:, 2:]) / 2
    inside = ((target[:, :2] <= centre) & (centre <= target[:, 2:])).all(axis=1)
    alike = inside & (ratio >= 1 / LARGEST_AREA_RATIO) & (ratio <= LARGEST_AREA_RATIO)
    return np.where((iou >= SMALLEST_IOU) | alike, np.maximum(iou, 1e-9), 0.0)
