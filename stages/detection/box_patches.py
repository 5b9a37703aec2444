"""The pixels of a box and its surroundings: a patch of 48 x 48 samples with the box in its middle 28 x 28.

Every box is resampled to the same size, so that a far diamond and a near one look alike. The sizes below are the layout
that the box network was learned with, no settings.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.imaging import halved
from wayside.stages.kernels import compiled, compiled_within, require_array, require_image

SIDE, INNER = 48, 28
"""Samples of the patch and of the box in it, each way."""
PATCH_DARK_LEVEL = 16.0
"""Added to a level before its logarithm, so that noise of dark pixels is no contrast."""
_LOGARITHMS = np.log(np.arange(256, dtype=np.float32) + np.float32(PATCH_DARK_LEVEL))


def drawn_patches(rgb: NDArray[np.uint8], box: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The patch of each box, (n, 48, 48, 3), from the image at full, half or quarter size: the next above its own.

    `rgb`: (height, width, 3). `box` (n, 4) float32: corners `[x0, y0, x1, y1]`, half open, pixels. Beyond the image its
    border is repeated.

    Raises ValueError where the image or the boxes are of another type or layout.
    """
    require_image(rgb)
    require_array(box, "box", np.float32, (None, 4))
    result = np.empty((len(box), SIDE, SIDE * 3), np.uint8)
    longest = (box[:, 2:] - box[:, :2]).max(axis=1) / INNER
    _draw_all((rgb, 1, 0, 0), box, np.flatnonzero(longest < 2), result)
    for row in np.flatnonzero(longest >= 2).tolist():
        part = _shown(rgb, box[row], 2 if longest[row] < 4 else 4)
        _draw_all(part, box, np.array([row]), result)
    return result.reshape(-1, SIDE, SIDE, 3)


def _shown(
    rgb: NDArray[np.uint8], box: NDArray[np.float32], scale: int
) -> tuple[NDArray[np.uint8], int, int, int]:
    """The part of an image that the patch of a box shows, `scale` smaller, and its left column and top row there."""
    x0, y0, x1, y1 = box.tolist()
    around = (SIDE - INNER) / 2 / INNER
    beside, above = around * (x1 - x0) + scale, around * (y1 - y0) + scale
    left = int(min(max(x0 - beside, 0), rgb.shape[1] - scale)) // scale
    top = int(min(max(y0 - above, 0), rgb.shape[0] - scale)) // scale
    right, bottom = max(int(x1 + beside) // scale, left) + 1, max(int(y1 + above) // scale, top) + 1
    part = rgb[scale * top : scale * bottom, scale * left : scale * right]
    return halved(part if scale == 2 else halved(part)), scale, left, top


def log_levels(patches: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Logarithms of the levels of one patch and more, (n, 48, 48, 3), in which light that multiplies is an offset."""
    rows = cv2.LUT(patches.reshape(-1, SIDE * 3), _LOGARITHMS)
    return np.asarray(rows, np.float32).reshape(patches.shape)


@compiled_within
def _draw(part: Any, box: Any, at: Any, above: Any, below: Any, pixels: Any) -> None:
    """Sample the patch (48, 144), rows of red, green and blue, linear between pixels, from a part as of `_shown`.

    at (48, 3), above, below (144,) int32: room for columns and their weights, and for two rows of the image at these
    columns. Boxes are mostly smaller than their patches: the rows between two rows of the image use the same ones.
    """
    image, scale, x, y = part
    x0, y0, x1, y1 = box
    height, width = image.shape[:2]
    dx = np.float32((x1 - x0) / (INNER * scale))
    dy = np.float32((y1 - y0) / (INNER * scale))
    left = np.float32(((x0 + x1) / scale - 1) / 2) - dx * np.float32((SIDE - 1) / 2)
    top = np.float32(((y0 + y1) / scale - 1) / 2) - dy * np.float32((SIDE - 1) / 2)
    # Weights are whole 256ths: integers are quick, and the same on every machine.
    for j in range(SIDE):
        column = min(max(left + j * dx - x, np.float32(0)), np.float32(width - 1))
        at[j, 0] = int(column)
        at[j, 1] = min(int(column) + 1, width - 1)
        at[j, 2] = int((column - int(column)) * 256)
    first = second = -1
    for i in range(SIDE):
        line = min(max(top + i * dy - y, np.float32(0)), np.float32(height - 1))
        row = int(line)
        if row != first:
            if row == second:
                above, below = below, above
            else:
                _sample_row(image[row], at, above)
            first = row
            second = min(row + 1, height - 1)
            _sample_row(image[second], at, below)
        weight = np.int32((line - row) * 256)
        for j in range(3 * SIDE):
            pixels[i, j] = ((256 - weight) * above[j] + weight * below[j]) >> 16


@compiled_within
def _sample_row(row: Any, at: Any, samples: Any) -> None:
    """A row (width, 3) of an image at the columns of a patch, times 256."""
    for j in range(SIDE):
        left, right, weight = at[j, 0], at[j, 1], at[j, 2]
        for k in range(3):
            samples[3 * j + k] = (256 - weight) * row[left, k] + weight * row[right, k]


@compiled
def _draw_all(part: Any, box: Any, rows: Any, pixels: Any) -> None:
    """The patch of each of those rows of the boxes."""
    at = np.empty((SIDE, 3), np.int32)
    above, below = np.empty(3 * SIDE, np.int32), np.empty(3 * SIDE, np.int32)
    for n in rows:
        _draw(part, box[n], at, above, below, pixels[n])
