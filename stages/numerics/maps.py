"""Maps of one value in which a sign face is brighter than what surrounds it, and the pyramid they are made on."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.numerics.compiled import compiled
from wayside.stages.numerics.guards import require_picture

MAPS = ("red", "blue", "green", "yellow", "lighter", "darker")
"""Red over green; blue over red; green over red; red and green over blue; lighter and darker than the neighbourhood.

Orange and brown show in the first and fourth, fluorescent yellow-green in the third and fourth.
"""

LOWEST = (12, 10, 8, 14, 10, 10)
"""First level of each map that can matter: below it lie road, sky and foliage."""

DARK_LEVEL = 64
"""Added to the largest channel before a difference of channels is divided by it: keeps the noise of shadows down."""

NEIGHBOURHOOD = 104
"""Side of the square whose mean stands for the neighbourhood, pixels of the map."""


def halved(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture at half size, each pixel the mean of four (an odd last row or column is left out)."""
    height, width = rgb.shape[0] // 2 * 2, rgb.shape[1] // 2 * 2
    if height == 0 or width == 0:
        return np.zeros((0, 0, 3), np.uint8)
    small = cv2.resize(
        rgb[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, np.uint8)


def neighbourhood(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Mean colour of the `NEIGHBOURHOOD` of each pixel, on a grid of every eighth pixel, between them linear."""
    height, width = rgb.shape[:2]
    coarse = (max(1, width // 8), max(1, height // 8))
    small = cv2.resize(rgb, coarse, interpolation=cv2.INTER_AREA)
    side = NEIGHBOURHOOD // 8
    mean = cv2.blur(small, (side, side), borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(mean, (width, height)), np.uint8)


def face_maps(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The maps of a picture or band: shape (6, height, width) uint8, in the order of `MAPS`.

    The four chromatic ones are differences of channels over the largest channel (a face in shadow keeps its
    value), times 256.
    """
    require_picture(rgb)
    result = np.empty((len(MAPS), *rgb.shape[:2]), np.uint8)
    if rgb.size:
        _face_maps(rgb, neighbourhood(rgb), result)
    return result


@compiled
def _face_maps(rgb: Any, local: Any, result: Any) -> None:
    scale = np.empty(256, np.int32)
    for v in range(256):
        scale[v] = (256 << 8) // (v + DARK_LEVEL)
    for y in range(rgb.shape[0]):
        for x in range(rgb.shape[1]):
            r = np.int32(rgb[y, x, 0])
            g = np.int32(rgb[y, x, 1])
            b = np.int32(rgb[y, x, 2])
            largest = max(r, g, b)
            smallest = min(r, g, b)
            p = np.int32(local[y, x, 0])
            q = np.int32(local[y, x, 1])
            s = np.int32(local[y, x, 2])
            k = scale[largest]
            near = scale[max(p, q, s)]
            values = (
                (r - g) * k - max(p - q, 0) * near,
                (b - r) * k - max(s - p, 0) * near,
                (g - r) * k - max(q - p, 0) * near,
                (min(r, g) - b) * k - max(min(p, q) - s, 0) * near,
            )
            for m in range(4):
                result[m, y, x] = min(max(values[m] >> 8, 0), 255)
            result[4, y, x] = max(smallest - min(p, q, s), 0)
            result[5, y, x] = max(max(p, q, s) - largest, 0)
