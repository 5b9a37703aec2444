"""Outlines of regions, traced along the edges of pixels (report chapter 4).

An outline is the closed polygon through the middles of the pixel edges between a region and the rest, in order,
clockwise as seen. Along rows, columns and diagonals it is straight, and it encloses the pixels, not their centres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled, require_array, require_image

SAMPLES = 64
"""Points at equal steps of arc length that stand for an outline."""

LONGEST_OUTLINE = 20_000
"""Regions with a longer outline, in pixel edges, get none: no face is so ragged."""

LONGEST_SIDE = 64
"""A larger box is looked at in steps, so that the longer side has at most twice as many samples."""

MARGIN = 0.15
"""A box is enlarged by this share of its longer side, at least 2 px, to see the surroundings."""

_NAN = complex(np.nan, np.nan)
_OPEN, _PATCH = (
    np.uint8(1),
    np.uint8(2),
)  # values of a mask: inside, inside and part of a patch found


def region_outline(
    rgb: NDArray[np.uint8], box: NDArray[Any], mean_rgb: NDArray[Any]
) -> NDArray[np.float64] | None:
    """Outline of what stands in a box: the largest patch nearer to its colour than to its surroundings.

    The surroundings are the mean colours of the four strips between the box and the box enlarged by `MARGIN`.

    Parameters
    ----------
    rgb
        The picture, (height, width, 3) uint8, C-contiguous.
    box
        [x0, y0, x1, y1] of the region, pixels, half open; rounded to whole pixels, cut at the picture.
    mean_rgb
        Mean colour of the region, shape (3,); of its main patch where it has legends or a border.

    Returns
    -------
    Outline (n, 2), n >= 4, u and v in picture pixels; holes are filled. None where no pixel is nearer to the colour, or
    the box misses the picture.

    Raises
    ------
    ValueError
        If an array is of another type, shape or layout.
    """
    require_image(rgb)
    boxes, colors = _box_rows(np.asarray(box)[None]), _color_rows(np.asarray(mean_rgb)[None], 1)
    points = np.empty((LONGEST_OUTLINE, 2))
    n = _outline_in_box(rgb, boxes[0], colors[0], points)
    return points[:n].copy() if n else None


def trace_region(labels: NDArray[np.uint8], box: NDArray[Any]) -> NDArray[np.float64] | None:
    """Outline of the connected region (4 neighbours) that fills a box of a label image exactly.

    No two regions fill the same box: where both touched all four sides they would have to cross.

    Parameters
    ----------
    labels
        Label image, (height, width) uint8, C-contiguous.
    box
        [x0, y0, x1, y1] of the region, pixels, half open.

    Returns
    -------
    Outline (n, 2), n >= 4, u and v in pixels of the label image. None where no region has this box.

    Raises
    ------
    ValueError
        If the label image is of another type or layout.
    """
    require_array(labels, "labels", np.uint8, (None, None))
    points = np.empty((LONGEST_OUTLINE, 2))
    n = _trace_box(labels, _box_rows(np.asarray(box)[None])[0], points)
    return points[:n].copy() if n else None


def region_sequences(
    rgb: NDArray[np.uint8], boxes: NDArray[Any], mean_rgb: NDArray[Any]
) -> NDArray[np.complex128]:
    """`region_outline` of n boxes (n, 4) with colours (n, 3), resampled: (n, SAMPLES), nan where there is none."""
    require_image(rgb)
    rows = _box_rows(boxes)
    sequences = np.full((len(rows), SAMPLES), _NAN)
    _outlines_in_boxes(rgb, rows, _color_rows(mean_rgb, len(rows)), sequences)
    return sequences


def traced_sequences(labels: NDArray[np.uint8], boxes: NDArray[Any]) -> NDArray[np.complex128]:
    """`trace_region` of n boxes (n, 4), resampled: (n, SAMPLES), nan where there is none."""
    require_array(labels, "labels", np.uint8, (None, None))
    rows = _box_rows(boxes)
    sequences = np.full((len(rows), SAMPLES), _NAN)
    _trace_boxes(labels, rows, sequences)
    return sequences


def resample_outline(outline: NDArray[Any], samples: int = SAMPLES) -> NDArray[np.complex128]:
    """The closed outline as complex numbers u + iv at equal steps of arc length.

    Parameters
    ----------
    outline
        Corners or boundary points in order, shape (n, 2), u right and v down, n >= 3; the last joins the first.
    samples
        How many points come out.

    Returns
    -------
    Shape (samples,), clockwise as seen, whatever the order of the input. All nan for an outline of no length.

    Raises
    ------
    ValueError
        If the outline is not (n, 2) with n >= 3.
    """
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise ValueError(
            f"outline: wanted (n, 2) points with n >= 3, found {outline.shape}; skip smaller ones"
        )
    sequence = np.full(samples, _NAN)
    _resample(np.ascontiguousarray(outline, np.float64), sequence)
    return sequence


def _box_rows(boxes: NDArray[Any]) -> NDArray[np.int64]:
    rows = np.ascontiguousarray(np.rint(np.asarray(boxes, np.float64)), np.int64)
    require_array(rows, "boxes", np.int64, (None, 4))
    return rows


def _color_rows(mean_rgb: NDArray[Any], count: int) -> NDArray[np.float32]:
    colors = np.ascontiguousarray(mean_rgb, np.float32)
    require_array(colors, "mean_rgb", np.float32, (count, 3))
    return colors


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
    way = 1 if twice_area >= 0 else -1
    here = 0
    there = (way + n) % n
    side = np.hypot(outline[there, 0] - outline[here, 0], outline[there, 1] - outline[here, 1])
    behind = 0.0
    passed = 1
    for s in range(sequence.size):
        want = s * length / sequence.size
        while behind + side < want and passed < n:
            behind += side
            here = there
            there = (there + way + n) % n
            passed += 1
            side = np.hypot(
                outline[there, 0] - outline[here, 0], outline[there, 1] - outline[here, 1]
            )
        share = (want - behind) / side if side > 0 else 0.0
        u = outline[here, 0] + share * (outline[there, 0] - outline[here, 0])
        v = outline[here, 1] + share * (outline[there, 1] - outline[here, 1])
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

    Corner (x, y) is the upper left one of pixel (x, y); the region lies to the right of the way. 0 where the region's
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
        # The pixels ahead of corner (at_x, at_y): to the left and to the right of the way.
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
    """Trace the regions met in the first row of the box until one fills it; the number of points, 0 if none does."""
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
    labels: NDArray[np.uint8], boxes: NDArray[np.int64], sequences: NDArray[np.complex128]
) -> None:
    points = np.empty((LONGEST_OUTLINE, 2))
    for i in range(boxes.shape[0]):
        n = _trace_box(labels, boxes[i], points)
        if n > 0:
            _resample(points[:n], sequences[i])


@compiled
def _outlines_in_boxes(
    rgb: NDArray[np.uint8],
    boxes: NDArray[np.int64],
    colors: NDArray[np.float32],
    sequences: NDArray[np.complex128],
) -> None:
    points = np.empty((LONGEST_OUTLINE, 2))
    for i in range(boxes.shape[0]):
        n = _outline_in_box(rgb, boxes[i], colors[i], points)
        if n > 0:
            _resample(points[:n], sequences[i])


@compiled
def _outline_in_box(
    rgb: NDArray[np.uint8],
    box: NDArray[np.int64],
    color: NDArray[np.float32],
    points: NDArray[np.float64],
) -> int:
    """Outline of the largest patch of a box in picture pixels; the number of points, 0 if there is none."""
    height, width, _ = rgb.shape
    margin = max(2, int(MARGIN * max(box[2] - box[0], box[3] - box[1]) + 0.5))
    left, top = max(0, box[0] - margin), max(0, box[1] - margin)
    right, bottom = min(width, box[2] + margin), min(height, box[3] + margin)
    x0, y0, x1, y1 = max(0, box[0]), max(0, box[1]), min(width, box[2]), min(height, box[3])
    if x1 <= x0 or y1 <= y0:
        return 0
    step = (max(x1 - x0, y1 - y0) + LONGEST_SIDE - 1) // LONGEST_SIDE
    part = rgb[top:bottom:step, left:right:step]
    mask = np.zeros(part.shape[:2], np.uint8)
    bounds = (x0 - left, y0 - top, x1 - left, y1 - top)
    _nearer_to_inside(part, step, bounds, color, mask)
    patch = _largest_patch(mask)
    n = _trace_box(mask, patch, points)
    for i in range(n):
        points[i, 0] = left + step * points[i, 0]
        points[i, 1] = top + step * points[i, 1]
    return n


@compiled
def _nearer_to_inside(
    part: NDArray[np.uint8],
    step: int,
    bounds: tuple[int, int, int, int],
    color: NDArray[np.float32],
    mask: NDArray[np.uint8],
) -> None:
    """Set `mask` where a sample is nearer to `color` than to the mean of each strip outside the bounds.

    Sample (i, j) stands at pixel step * (j, i) of the part, whose inner box is `bounds`.
    """
    x0, y0, x1, y1 = bounds
    rows, columns = mask.shape
    strips = np.zeros((4, 4), np.float32)
    for i in range(rows):
        y = i * step
        for j in range(columns):
            x = j * step
            strip = 0 if y < y0 else 1 if y >= y1 else 2 if x < x0 else 3 if x >= x1 else -1
            if strip >= 0:
                for c in range(3):
                    strips[strip, c] += part[i, j, c]
                strips[strip, 3] += 1
    for strip in range(4):
        if strips[strip, 3] > 0:
            strips[strip, :3] /= strips[strip, 3]
        else:
            strips[strip, :3] = np.float32(1e6)  # the box reaches the picture's border here
    for i in range(rows):
        for j in range(columns):
            red = np.float32(part[i, j, 0])
            green = np.float32(part[i, j, 1])
            blue = np.float32(part[i, j, 2])
            own = (red - color[0]) ** 2 + (green - color[1]) ** 2 + (blue - color[2]) ** 2
            other = np.float32(np.inf)
            for strip in range(4):
                gap = (
                    (red - strips[strip, 0]) ** 2
                    + (green - strips[strip, 1]) ** 2
                    + (blue - strips[strip, 2]) ** 2
                )
                other = min(other, gap)
            mask[i, j] = _OPEN if own < other else 0


@compiled
def _largest_patch(mask: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Box of the largest connected patch (4 neighbours; the first among equals); all open pixels become `_PATCH`."""
    rows, columns = mask.shape
    waiting = np.empty(mask.size + 1, np.int32)
    best = np.zeros(4, np.int64)
    largest = 0
    for start in range(mask.size):
        if mask[start // columns, start % columns] != _OPEN:
            continue
        mask[start // columns, start % columns] = _PATCH
        waiting[0] = start
        size, area = 1, 0
        x0, y0, x1, y1 = columns, rows, 0, 0
        while size > 0:
            size -= 1
            i, j = waiting[size] // columns, waiting[size] % columns
            area += 1
            x0, x1 = min(x0, j), max(x1, j + 1)
            y0, y1 = min(y0, i), max(y1, i + 1)
            for side in range(4):
                y = i + (side == 0) - (side == 1)
                x = j + (side == 2) - (side == 3)
                if 0 <= y < rows and 0 <= x < columns and mask[y, x] == _OPEN:
                    mask[y, x] = _PATCH
                    waiting[size] = y * columns + x
                    size += 1
        if area > largest:
            largest = area
            best[0], best[1], best[2], best[3] = x0, y0, x1, y1
    return best
