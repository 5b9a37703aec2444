"""Outlines of regions: which pixels belong to one, and the boundary around them (report chapter 4)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.numerics.compiled import compiled
from wayside.stages.numerics.guards import require_array, require_picture

LONGEST_SIDE = 64
"""A larger box is looked at in steps, so that no side has more samples than twice this."""

FILLED, PASSED = np.uint8(1), np.uint8(2)
"""Marks of a flood: the region asked for, and those tried before it."""

MARGIN = 0.15
"""The box is enlarged by this share of its larger side, at least 2 px, to see the surroundings."""


def region_outline(
    rgb: NDArray[np.uint8], box: NDArray[Any], mean_rgb: NDArray[Any]
) -> NDArray[np.float64] | None:
    """Boundary of what stands in a box: the largest patch nearer to its colour than to its surroundings.

    Parameters
    ----------
    rgb
        The picture, (height, width, 3) uint8, C-contiguous.
    box
        [x0, y0, x1, y1] of the region, pixels, half open; it may reach beyond the picture.
    mean_rgb
        Mean colour of the region, shape (3,); of its main patch where it has legends or a border.

    Returns
    -------
    Boundary pixels in order, shape (n, 2), u and v in picture pixels; holes are filled. None where nothing of
    at least 3 boundary pixels is found.
    """
    found = color_mask(rgb, box, mean_rgb)
    return None if found is None else mask_outline(*found)


def color_mask(
    rgb: NDArray[np.uint8], box: NDArray[Any], mean_rgb: NDArray[Any]
) -> tuple[NDArray[np.uint8], tuple[int, int], int] | None:
    """Pixels of the enlarged box nearer to the mean colour than to the mean of any of the four strips round the box.

    Returns
    -------
    Mask (rows, columns) of 0 and 1, picture pixel (u, v) of its first sample, and the step between samples in
    pixels; None where the box misses the picture.
    """
    require_picture(rgb)
    height, width = rgb.shape[:2]
    x0, y0, x1, y1 = (int(v) for v in np.round(np.asarray(box, np.float64)))
    margin = max(2, round(MARGIN * max(x1 - x0, y1 - y0)))
    left, right = max(0, x0 - margin), min(width, x1 + margin)
    top, bottom = max(0, y0 - margin), min(height, y1 + margin)
    x0, y0, x1, y1 = max(0, x0), max(0, y0), min(width, x1), min(height, y1)
    if x1 <= x0 or y1 <= y0:
        return None
    step = -(-max(x1 - x0, y1 - y0) // LONGEST_SIDE)
    mask = np.zeros((-(-(bottom - top) // step), -(-(right - left) // step)), np.uint8)
    color = np.ascontiguousarray(mean_rgb, np.float32).reshape(-1)
    require_array(color, "mean_rgb", np.float32, (3,))
    _nearer_to_inside(rgb, left, top, (x0, y0, x1, y1), step, color, mask)
    return mask, (left, top), step


def label_mask(
    labels: NDArray[np.uint8], box: tuple[int, int, int, int], area_px: int
) -> NDArray[np.uint8] | None:
    """Pixels of the connected region (4 neighbours) that fills a box of a label image exactly.

    Parameters
    ----------
    labels
        Label image, (rows, width) uint8, C-contiguous.
    box
        x0, y0, x1, y1 of the region in it, half open.
    area_px
        Its number of pixels.

    Returns
    -------
    Mask (y1 - y0, x1 - x0) of 0 and 1; None where no region has this box and area. The first in reading order where
    several have.

    Raises
    ------
    ValueError
        If the label image is of another type or layout, or the box reaches beyond it.
    """
    require_array(labels, "labels", np.uint8, (None, None))
    x0, y0, x1, y1 = box
    if not (0 <= x0 < x1 <= labels.shape[1] and 0 <= y0 < y1 <= labels.shape[0]):
        raise ValueError(
            f"box: wanted one inside the {labels.shape[1]} x {labels.shape[0]} label image, found "
            f"{box}; clip it first"
        )
    seen = np.zeros((y1 - y0, x1 - x0), np.uint8)
    stack = np.empty(seen.size, np.int32)
    if not _fill_region(labels, x0, y0, area_px, seen, stack):
        return None
    return np.asarray(seen == FILLED).view(np.uint8)


def mask_outline(
    mask: NDArray[np.uint8], origin: tuple[int, int] = (0, 0), step: int = 1
) -> NDArray[np.float64] | None:
    """Boundary pixels of the largest patch of a mask, holes filled, in order: shape (n, 2) as u, v.

    Sample (row, column) of the mask stands at pixel `origin + step * (column, row)`. None where no patch has 3 boundary
    pixels and an area.
    """
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    best, best_area = None, 0.0
    for contour in sorted(contours, key=len, reverse=True)[:3]:
        area = cv2.contourArea(contour)
        if len(contour) >= 3 and area > best_area:
            best, best_area = contour, area
    if best is None:
        return None
    return best[:, 0, :].astype(np.float64) * step + np.array(origin, np.float64)


@compiled
def _nearer_to_inside(
    rgb: NDArray[np.uint8],
    left: int,
    top: int,
    box: tuple[int, int, int, int],
    step: int,
    color: NDArray[np.float32],
    mask: NDArray[np.uint8],
) -> None:
    """Fill `mask` with 1 where the sample is nearer to `color` than to the means of the strips round the box."""
    x0, y0, x1, y1 = box
    rows, columns = mask.shape
    strips = np.zeros((4, 4), np.float32)
    for i in range(rows):
        y = top + i * step
        for j in range(columns):
            x = left + j * step
            strip = -1
            if y < y0:
                strip = 0
            elif y >= y1:
                strip = 1
            elif x < x0:
                strip = 2
            elif x >= x1:
                strip = 3
            if strip >= 0:
                for c in range(3):
                    strips[strip, c] += rgb[y, x, c]
                strips[strip, 3] += 1
    for strip in range(4):
        if strips[strip, 3] > 0:
            for c in range(3):
                strips[strip, c] /= strips[strip, 3]
    for i in range(rows):
        y = top + i * step
        for j in range(columns):
            x = left + j * step
            r = np.float32(rgb[y, x, 0])
            g = np.float32(rgb[y, x, 1])
            b = np.float32(rgb[y, x, 2])
            own = (r - color[0]) ** 2 + (g - color[1]) ** 2 + (b - color[2]) ** 2
            inside = np.uint8(1)
            for strip in range(4):
                other = (
                    (r - strips[strip, 0]) ** 2
                    + (g - strips[strip, 1]) ** 2
                    + (b - strips[strip, 2]) ** 2
                )
                if strips[strip, 3] > 0 and other <= own:
                    inside = np.uint8(0)
            mask[i, j] = inside


@compiled
def _fill_region(
    labels: NDArray[np.uint8],
    x0: int,
    y0: int,
    area_px: int,
    seen: NDArray[np.uint8],
    stack: NDArray[np.int32],
) -> bool:
    """Flood from each run of the box's first row until a region has that area and box: it is left `FILLED`."""
    rows, columns = seen.shape
    for start in range(columns):
        if seen[0, start] != 0:
            continue
        label = labels[y0, x0 + start]
        seen[0, start] = FILLED
        stack[0] = start
        size = 1
        area = 0
        bottom = 0
        first = start
        last = start
        while size > 0:
            size -= 1
            i = stack[size] // columns
            j = stack[size] % columns
            area += 1
            bottom = max(bottom, i)
            first = min(first, j)
            last = max(last, j)
            for side in range(4):
                di = (side == 0) - (side == 1)
                dj = (side == 2) - (side == 3)
                y = i + di
                x = j + dj
                if 0 <= y < rows and 0 <= x < columns and seen[y, x] == 0:
                    if labels[y0 + y, x0 + x] == label:
                        seen[y, x] = FILLED
                        stack[size] = y * columns + x
                        size += 1
        if area == area_px and bottom == rows - 1 and first == 0 and last == columns - 1:
            return True
        for i in range(rows):
            for j in range(columns):
                if seen[i, j] == FILLED:
                    seen[i, j] = PASSED
    return False
