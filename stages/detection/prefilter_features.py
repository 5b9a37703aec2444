"""A first glance at a box: 6 x 6 colours of it and what surrounds it, for a quick gate before the full patch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.imaging import DARK_LEVEL
from wayside.stages.kernels import compiled, require_array, require_image

GRID = 6
"""Samples each way; the inner 4 x 4 lie in the box or on its border."""

WIDER = 1.6
"""The grid spans the box enlarged by this."""

_LOG = np.log(np.arange(256) + DARK_LEVEL).astype(np.float32)


def glance_names() -> tuple[str, ...]:
    """Names of the columns of `glances`, in order."""
    return tuple(
        f"glance_{row}_{column}_{channel}"
        for row in range(GRID)
        for column in range(GRID)
        for channel in ("brightness", "red_green", "blue_green")
    )


def glances(levels: tuple[NDArray[np.uint8], ...], box: NDArray[np.float32]) -> NDArray[np.float32]:
    """Colours on a grid over each box (n, 4), full-size pixels: shape (n, 108) float32.

    `levels` are the picture at full, half and quarter size, (height, width, 3) uint8; each box is looked at where a
    sample is about as large as a pixel. Logarithms of brightness (relative to the grid's mean), R/G and B/G.

    Raises
    ------
    ValueError
        If a picture or the boxes are of another type or layout, or a picture has no pixels.
    """
    if len(levels) != 3 or any(level.size == 0 for level in levels):
        raise ValueError(f"levels: wanted three pictures with pixels, found {len(levels)}")
    for level in levels:
        require_image(level, "levels")
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    result = np.empty((len(box), GRID * GRID * 3), np.float32)
    _glances(*levels, box, _LOG, result)
    return result


@compiled
def _glances(full: Any, half: Any, quarter: Any, box: Any, log: Any, result: Any) -> None:
    for n in range(box.shape[0]):
        x0, y0, x1, y1 = box[n]
        dx = (x1 - x0) * np.float32(WIDER / GRID)
        dy = (y1 - y0) * np.float32(WIDER / GRID)
        spacing = min(dx, dy)
        picture = full
        scale = np.float32(1)
        if spacing >= 3:
            picture = quarter
            scale = np.float32(0.25)
        elif spacing >= 1.5:
            picture = half
            scale = np.float32(0.5)
        height, width = picture.shape[:2]
        left = ((x0 + x1) - (GRID - 1) * dx) * np.float32(0.5)
        top = ((y0 + y1) - (GRID - 1) * dy) * np.float32(0.5)
        mean = np.float32(0)
        k = 0
        for i in range(GRID):
            y = min(max(int((top + i * dy) * scale), 0), height - 1)
            for j in range(GRID):
                x = min(max(int((left + j * dx) * scale), 0), width - 1)
                r = np.int32(picture[y, x, 0])
                g = np.int32(picture[y, x, 1])
                b = np.int32(picture[y, x, 2])
                brightness = log[(r + g + b) // 3]
                mean += brightness
                result[n, k] = brightness
                result[n, k + 1] = log[r] - log[g]
                result[n, k + 2] = log[b] - log[g]
                k += 3
        mean /= GRID * GRID
        for q in range(GRID * GRID):
            result[n, 3 * q] -= mean
