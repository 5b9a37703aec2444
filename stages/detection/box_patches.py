"""The pixels of a box and its surroundings: a patch of 48 x 48 samples with the box in its middle 28 x 28.

Every box is resampled to the same size, so that a far diamond and a near one look alike. The sizes below are the layout
that the box network was learned with, no settings.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.imaging import Pyramid
from wayside.stages.kernels import compiled, require_array, require_image

SIDE, INNER = 48, 28
"""Samples of the patch and of the box in it, each way."""


def drawn_patches(levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The patch of each box, (n, 48, 48, 3).

    Parameters
    ----------
    levels
        The image at full, half and quarter size, (height, width, 3) uint8 each.
    box
        (n, 4) float32 `[x0, y0, x1, y1]`, half open, full-size pixels; beyond the image its border is repeated.

    Raises
    ------
    ValueError
        If an image or the boxes are of another type or layout.
    """
    box = _checked(levels, box)
    result = np.zeros((len(box), SIDE, SIDE, 3), np.uint8)
    full, half, quarter = levels
    _draw_all(full, half, quarter, box, result)
    return result


def _checked(levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.float32]:
    """The boxes as the kernels want them; raises ValueError."""
    if len(levels) != 3:
        raise ValueError(f"levels: wanted full, half and quarter size, found {len(levels)} images")
    for level in levels:
        require_image(level, "levels")
        if level.size == 0:
            raise ValueError("levels: wanted images with pixels, found an empty one")
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    return box


@compiled
def _draw(
    full: Any, half: Any, quarter: Any, x0: Any, y0: Any, x1: Any, y1: Any, pixels: Any
) -> None:
    """Sample the patch (48, 48, 3), linear between pixels, from the size that is nearest above its own."""
    longest = max(x1 - x0, y1 - y0) / INNER
    scale = 1
    image = full
    if longest >= 4:
        image = quarter
        scale = 4
    elif longest >= 2:
        image = half
        scale = 2
    height, width = image.shape[:2]
    dx = np.float32((x1 - x0) / (INNER * scale))
    dy = np.float32((y1 - y0) / (INNER * scale))
    left = np.float32(((x0 + x1) / scale - 1) / 2) - dx * np.float32((SIDE - 1) / 2)
    top = np.float32(((y0 + y1) / scale - 1) / 2) - dy * np.float32((SIDE - 1) / 2)
    # Weights are whole 256ths: integers are quick, and the same on every machine.
    at = np.empty((SIDE, 3), np.int32)
    for j in range(SIDE):
        x = min(max(left + j * dx, np.float32(0)), np.float32(width - 1))
        at[j, 0] = int(x)
        at[j, 1] = min(int(x) + 1, width - 1)
        at[j, 2] = int((x - int(x)) * 256)
    for i in range(SIDE):
        y = min(max(top + i * dy, np.float32(0)), np.float32(height - 1))
        above = image[int(y)]
        below = image[min(int(y) + 1, height - 1)]
        b = np.int32((y - int(y)) * 256)
        for j in range(SIDE):
            c0 = at[j, 0]
            c1 = at[j, 1]
            w01 = at[j, 2] * (256 - b)
            w11 = at[j, 2] * b
            w00 = (256 - at[j, 2]) * (256 - b)
            w10 = (256 - at[j, 2]) * b
            pixels[i, j, 0] = (
                w00 * above[c0, 0] + w01 * above[c1, 0] + w10 * below[c0, 0] + w11 * below[c1, 0]
            ) >> 16
            pixels[i, j, 1] = (
                w00 * above[c0, 1] + w01 * above[c1, 1] + w10 * below[c0, 1] + w11 * below[c1, 1]
            ) >> 16
            pixels[i, j, 2] = (
                w00 * above[c0, 2] + w01 * above[c1, 2] + w10 * below[c0, 2] + w11 * below[c1, 2]
            ) >> 16


@compiled
def _draw_all(full: Any, half: Any, quarter: Any, box: Any, pixels: Any) -> None:
    for n in range(box.shape[0]):
        _draw(full, half, quarter, box[n, 0], box[n, 1], box[n, 2], box[n, 3], pixels[n])
