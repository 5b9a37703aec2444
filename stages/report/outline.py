"""Outlines of regions, traced along the edges of pixels (report chapter 4).

An outline is the closed polygon through the middles of the pixel edges between a region and the rest, in order,
clockwise as seen. Along rows, columns and diagonals it is straight, and it encloses the pixels, not their centres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import RegionOutlineSettings
from wayside.stages.kernels import compiled, require_array

SAMPLES = 64
"""Points at equal steps of arc length that stand for an outline."""

_NAN = complex(np.nan, np.nan)


def traced_sequences(
    labels: NDArray[np.uint8], boxes: NDArray[Any], settings: RegionOutlineSettings
) -> NDArray[np.complex128]:
    """Resampled outlines (n, SAMPLES) of the connected regions (4 neighbours) that fill boxes (n, 4) exactly.

    u + iv in pixels of the label image (height, width) uint8, clockwise as seen; nan where no region has this box. No
    two regions fill the same box: where both touched all four sides they would have to cross. Raises ValueError where
    an array is of another type, shape or layout.
    """
    require_array(labels, "labels", np.uint8, (None, None))
    rows = _box_rows(boxes)
    sequences = np.full((len(rows), SAMPLES), _NAN)
    _trace_boxes(labels, rows, np.empty((settings.longest_edges, 2)), sequences)
    return sequences


def _box_rows(boxes: NDArray[Any]) -> NDArray[np.int64]:
    rows = np.ascontiguousarray(np.rint(np.asarray(boxes, np.float64)), np.int64)
    require_array(rows, "boxes", np.int64, (None, 4))
    return rows


@compiled
def _resample(outline: NDArray[np.float64], sequence: NDArray[np.complex128]) -> None:
    """Equal steps along the closed polygon (n, 2), clockwise as seen (v points down); untouched if it has no length."""
    n = outline.shape[0]
    length = 0.0
    twice_area = 0.0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        length += np.hypot(outline[j, 0] - outline[i, 0], outline[j, 1] - outline[i, 1])
        twice_area += outline[i, 0] * outline[j, 1] - outline[j, 0] * outline[i, 1]
    if length <= 0.0:
        return
    sense = 1 if twice_area >= 0 else -1
    here = 0
    there = (sense + n) % n
    side = np.hypot(outline[there, 0] - outline[here, 0], outline[there, 1] - outline[here, 1])
    behind = 0.0
    passed = 1
    for s in range(sequence.size):
        target = s * length / sequence.size
        while behind + side < target and passed < n:
            behind += side
            here = there
            there = (there + sense + n) % n
            passed += 1
            side = np.hypot(
                outline[there, 0] - outline[here, 0], outline[there, 1] - outline[here, 1]
            )
        fraction = (target - behind) / side if side > 0 else 0.0
        u = outline[here, 0] + fraction * (outline[there, 0] - outline[here, 0])
        v = outline[here, 1] + fraction * (outline[there, 1] - outline[here, 1])
        sequence[s] = complex(u, v)


@compiled
def _trace(
    labels: NDArray[np.uint8],
    x: int,
    y: int,
    box: NDArray[np.int64],
    points: NDArray[np.float64],
) -> int:
    """Trace the region of pixel (x, y), whose upper edge is a border, until it closes; the number of points.

    Corner (x, y) is the upper left one of pixel (x, y); the region lies to the right. 0 where the region's
    outline does not have exactly this box or is too long.
    """
    height, width = labels.shape
    label = labels[y, x]
    at_x, at_y, dx, dy = x, y, 1, 0
    left, top, right, bottom = x, y, x, y
    n = 0
    while n < points.shape[0]:
        points[n, 0] = at_x + 0.5 * dx - 0.5
        points[n, 1] = at_y + 0.5 * dy - 0.5
        n += 1
        at_x += dx
        at_y += dy
        left, right = min(left, at_x), max(right, at_x)
        top, bottom = min(top, at_y), max(bottom, at_y)
        if left < box[0] or top < box[1] or right > box[2] or bottom > box[3]:
            return 0
        # The pixels ahead of corner (at_x, at_y): to the left and to the right.
        left_x, left_y = at_x + (dx + dy - 1) // 2, at_y + (dy - dx - 1) // 2
        right_x, right_y = at_x + (dx - dy - 1) // 2, at_y + (dy + dx - 1) // 2
        on_right = 0 <= right_x < width and 0 <= right_y < height
        on_left = 0 <= left_x < width and 0 <= left_y < height
        if not on_right or labels[right_y, right_x] != label:
            dx, dy = -dy, dx
        elif on_left and labels[left_y, left_x] == label:
            dx, dy = dy, -dx
        if at_x == x and at_y == y and dx == 1:
            same = left == box[0] and top == box[1] and right == box[2] and bottom == box[3]
            return n if same else 0
    return 0


@compiled
def _trace_box(
    labels: NDArray[np.uint8], box: NDArray[np.int64], points: NDArray[np.float64]
) -> int:
    """Trace the regions in the first row of the box until one fills it; the number of points, 0 if none does."""
    height, width = labels.shape
    if box[0] < 0 or box[1] < 0 or box[2] > width or box[3] > height:
        return 0
    if box[0] >= box[2] or box[1] >= box[3]:
        return 0
    y = box[1]
    for x in range(box[0], box[2]):
        if x > box[0] and labels[y, x] == labels[y, x - 1]:
            continue
        if y > 0 and labels[y - 1, x] == labels[y, x]:
            continue
        n = _trace(labels, x, y, box, points)
        if n > 0:
            return n
    return 0


@compiled
def _trace_boxes(
    labels: NDArray[np.uint8],
    boxes: NDArray[np.int64],
    points: NDArray[np.float64],
    sequences: NDArray[np.complex128],
) -> None:
    for i in range(boxes.shape[0]):
        n = _trace_box(labels, boxes[i], points)
        if n > 0:
            _resample(points[:n], sequences[i])
