"""An image at full, half and quarter size, and enlarged."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Pyramid = tuple[NDArray[np.uint8], ...]
"""An image at full, half and quarter size, (height, width, 3) uint8 each."""


def pyramid(rgb: NDArray[np.uint8]) -> Pyramid:
    """The image (height, width, 3) at full, half and quarter size."""
    half = halved(rgb)
    return rgb, half, halved(half)


def halved(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image at half size, each pixel the mean of four (an odd last row or column is left out)."""
    height, width = rgb.shape[0] // 2 * 2, rgb.shape[1] // 2 * 2
    if height == 0 or width == 0:
        return np.zeros((0, 0, 3), np.uint8)
    small = cv2.resize(
        rgb[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, np.uint8)


def enlarged(rgb: NDArray[np.uint8], times: int) -> NDArray[np.uint8]:
    """The image so many times as large, cubic between its pixels; itself for 1."""
    if times == 1:
        return rgb
    large = cv2.resize(rgb, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
    return np.asarray(large, np.uint8)
