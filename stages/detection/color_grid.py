"""Colours on a 6 x 6 grid over a box and its surroundings: the cheap features of the pre-filter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.imaging import DARK_LEVEL, Pyramid
from wayside.stages.kernels import compiled, require_array, require_image

GRID = 6
"""Samples each way; the inner 4 x 4 lie in the box or on its border."""

WIDER = 1.6
"""The grid spans the box enlarged by this."""

_LOG = np.log(np.arange(256) + DARK_LEVEL).astype(np.float32)


def color_grid_names() -> tuple[str, ...]:
    """Names of the columns of `color_grid`, in order; `glance` is the older term, kept in the model files."""
    return tuple(
        f"glance_{row}_{column}_{channel}"
        for row in range(GRID)
        for column in range(GRID)
        for channel in ("brightness", "red_green", "blue_green")
    )


def color_grid(levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.float32]:
    """Colours on a grid over each box (n, 4), full-size pixels: shape (n, 108) float32.

    `levels` are the image at full, half and quarter size, (height, width, 3) uint8; each box is sampled at the level
    where a sample is about as large as a pixel. Logarithms of brightness (relative to the grid's mean), R/G and B/G.

    Raises
    ------
    ValueError
        If an image or the boxes are of another type or layout, or an image has no pixels.
    """
    if len(levels) != 3 or any(level.size == 0 for level in levels):
        raise ValueError(f"levels: wanted three images with pixels, found {len(levels)}")
    for level in levels:
        require_image(level, "levels")
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    result = np.empty((len(box), GRID * GRID * 3), np.float32)
    _color_grid(*levels, box, _LOG, result)
    return result


@compiled
def _color_grid(full: Any, half: Any, quarter: Any, box: Any, log: Any, result: Any) -> None:
    for n in range(box.shape[0]):
        x0, y0, x1, y1 = box[n]
        dx = (x1 - x0) * np.float32(WIDER / GRID)
        dy = (y1 - y0) * np.float32(WIDER / GRID)
        spacing = min(dx, dy)
        image = full
        scale = np.float32(1)
        if spacing >= 3:
            image = quarter
            scale = np.float32(0.25)
        elif spacing >= 1.5:
            image = half
            scale = np.float32(0.5)
        height, width = image.shape[:2]
        left = ((x0 + x1) - (GRID - 1) * dx) * np.float32(0.5)
        top = ((y0 + y1) - (GRID - 1) * dy) * np.float32(0.5)
        mean = np.float32(0)
        k = 0
        for i in range(GRID):
            y = min(max(int((top + i * dy) * scale), 0), height - 1)
            for j in range(GRID):
                x = min(max(int((left + j * dx) * scale), 0), width - 1)
                r = np.int32(image[y, x, 0])
                g = np.int32(image[y, x, 1])
                b = np.int32(image[y, x, 2])
                brightness = log[(r + g + b) // 3]
                mean += brightness
                result[n, k] = brightness
                result[n, k + 1] = log[r] - log[g]
                result[n, k + 2] = log[b] - log[g]
                k += 3
        mean /= GRID * GRID
        for q in range(GRID * GRID):
            result[n, 3 * q] -= mean
