"""The pixels of a box and its surroundings: a patch of 48 x 48 samples with the box in its middle 28 x 28.

Every box is resampled to the same size, so that a far diamond and a near one look alike. The sizes below are the layout
that the box network was learned with, no settings.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.imaging import Pyramid, pyramid
from wayside.stages.kernels import compiled, compiled_within, require_array, require_image

SIDE, INNER = 48, 28
"""Samples of the patch and of the box in it, each way."""
PATCH_DARK_LEVEL = 16.0
"""Added to a level before its logarithm, so that noise of dark pixels is no contrast."""
_LOGARITHMS = np.log(np.arange(256, dtype=np.float32) + np.float32(PATCH_DARK_LEVEL))


def pyramid_of_boxes(
    rgb: NDArray[np.uint8], box: NDArray[np.float32]
) -> tuple[Pyramid, NDArray[np.float32]]:
    """What boxes (n, 4) of an image are drawn from, and they in it: the image, or what they show at three sizes."""
    size = box[:, 2:] - box[:, :2]
    if not (size / INNER >= 2).any():
        return (rgb, rgb[:0], rgb[:0]), box
    # four pixels make one of the smallest size
    left, top = np.maximum((box[:, :2] - size).min(axis=0) // 4 * 4, 0).astype(int).tolist()
    right, bottom = ((box[:, 2:] + size).max(axis=0) // 4 * 4 + 4).astype(int).tolist()
    part = np.ascontiguousarray(rgb[top:bottom, left:right])
    return pyramid(part), box - np.array([left, top, left, top], np.float32)


def drawn_patches(levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The patch of each box, (n, 48, 48, 3).

    `levels`: the image at full, half and quarter size, `(height, width, 3)` uint8 each. `box` (n, 4) float32: corners
    `[x0, y0, x1, y1]`, half open, full-size pixels. Beyond the image its border is repeated.

    Raises ValueError where an image or the boxes are of another type or layout.
    """
    for level in levels:
        require_image(level, "levels")
    require_array(box, "box", np.float32, (None, 4))
    result = np.empty((len(box), SIDE, SIDE * 3), np.uint8)
    _draw_all(levels, box, result)
    return result.reshape(-1, SIDE, SIDE, 3)


def log_levels(patches: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Logarithms of the levels of one patch and more, (n, 48, 48, 3), in which light that multiplies is an offset."""
    rows = cv2.LUT(patches.reshape(-1, SIDE * 3), _LOGARITHMS)
    return np.asarray(rows, np.float32).reshape(patches.shape)


@compiled_within
def _draw(image: Any, scale: Any, box: Any, at: Any, above: Any, below: Any, pixels: Any) -> None:
    """Sample the patch (48, 144), rows of red, green and blue, linear between pixels, from an image `scale` smaller.

    at (48, 3), above, below (144,) int32: room for columns and their weights, and for two rows of the image at these
    columns. Boxes are mostly smaller than their patches: the rows between two rows of the image use the same ones.
    """
    x0, y0, x1, y1 = box
    height, width = image.shape[:2]
    dx = np.float32((x1 - x0) / (INNER * scale))
    dy = np.float32((y1 - y0) / (INNER * scale))
    left = np.float32(((x0 + x1) / scale - 1) / 2) - dx * np.float32((SIDE - 1) / 2)
    top = np.float32(((y0 + y1) / scale - 1) / 2) - dy * np.float32((SIDE - 1) / 2)
    # Weights are whole 256ths: integers are quick, and the same on every machine.
    for j in range(SIDE):
        x = min(max(left + j * dx, np.float32(0)), np.float32(width - 1))
        at[j, 0] = int(x)
        at[j, 1] = min(int(x) + 1, width - 1)
        at[j, 2] = int((x - int(x)) * 256)
    first = second = -1
    for i in range(SIDE):
        y = min(max(top + i * dy, np.float32(0)), np.float32(height - 1))
        row = int(y)
        if row != first:
            if row == second:
                above, below = below, above
            else:
                _sample_row(image[row], at, above)
            first = row
            second = min(row + 1, height - 1)
            _sample_row(image[second], at, below)
        weight = np.int32((y - row) * 256)
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
def _draw_all(levels: Any, box: Any, pixels: Any) -> None:
    """The patch of each box, from the size of the image that is nearest above its own."""
    at = np.empty((SIDE, 3), np.int32)
    above, below = np.empty(3 * SIDE, np.int32), np.empty(3 * SIDE, np.int32)
    for n in range(box.shape[0]):
        longest = max(box[n, 2] - box[n, 0], box[n, 3] - box[n, 1]) / INNER
        level = int(longest >= 2) + int(longest >= 4)
        _draw(levels[level], 1 << level, box[n], at, above, below, pixels[n])
