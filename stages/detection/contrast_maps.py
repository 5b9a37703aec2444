"""Contrast maps: images of one value in which a sign face is brighter than its surroundings."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled, require_array, require_image

MAPS = ("red", "blue", "green", "yellow", "lighter", "darker")
"""Red over green; blue over red; green over red; red and green over blue; lighter and darker.

Each less that of the neighbourhood. Orange and brown show in the first and fourth, fluorescent yellow-green in the
third and fourth.
"""


def neighbourhood(rgb: NDArray[np.uint8], side_px: int) -> NDArray[np.uint8]:
    """Mean colour of the square around each pixel, exact for every eighth pixel, between them linear."""
    height, width = rgb.shape[:2]
    coarse = (max(1, width // 8), max(1, height // 8))
    small = cv2.resize(rgb, coarse, interpolation=cv2.INTER_AREA)
    side = side_px // 8
    mean = cv2.blur(small, (side, side), borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(mean, (width, height)), np.uint8)


def contrast_maps(
    rgb: NDArray[np.uint8], dark_level: int, neighbourhood_px: int
) -> NDArray[np.uint8]:
    """The maps of an image or band: shape (6, height, width) uint8, in the order of `MAPS`.

    The four chromatic ones are differences of channels over the largest channel plus `dark_level` (a face in shadow
    keeps its value), times 256. Raises ValueError where `rgb` is not (height, width, 3) uint8.
    """
    require_image(rgb)
    result = np.empty((len(MAPS), *rgb.shape[:2]), np.uint8)
    if rgb.size == 0:
        return result
    r, g, b = cv2.split(rgb)
    p, q, s = cv2.split(neighbourhood(rgb, neighbourhood_px))
    light, dark = cv2.max(cv2.max(r, g), b), cv2.min(cv2.min(r, g), b)
    near_light, near_dark = cv2.max(cv2.max(p, q), s), cv2.min(cv2.min(p, q), s)
    scale = np.float32(256) / (np.arange(256, dtype=np.float32) + np.float32(dark_level))
    over, near_over = cv2.LUT(light, scale), cv2.LUT(near_light, scale)
    excesses = (
        (r, g, p, q),
        (b, r, s, p),
        (g, r, q, p),
        (cv2.min(r, g), b, cv2.min(p, q), s),
    )
    for values, (one, other, near, near_other) in zip(result, excesses, strict=False):
        _excess(one, other, over, near, near_other, near_over, values)
    cv2.subtract(dark, near_dark, dst=result[4])
    cv2.subtract(near_light, light, dst=result[5])
    return result


def foreground_means(
    rgb: NDArray[np.uint8], values: NDArray[np.uint8], box: NDArray[np.float32], samples: int
) -> NDArray[np.float32]:
    """Mean colour (n, 3) of the brighter part of a map in each box: where `values` is at least its mean there.

    rgb (height, width, 3) and values (height, width) uint8; boxes (n, 4) inside the image. About `samples` each way are
    taken from a box. Raises ValueError where an array is of another type or shape.
    """
    require_image(rgb)
    require_array(values, "values", np.uint8, rgb.shape[:2])
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    result = np.zeros((len(box), 3), np.float32)
    _foreground_means(rgb, values, box, samples, result)
    return result


@compiled
def _excess(a: Any, b: Any, over: Any, p: Any, q: Any, near_over: Any, result: Any) -> None:
    """Excess of a over b, relative to `over`, less that of the neighbourhood, p over q by `near_over`."""
    for y in range(a.shape[0]):
        for x in range(a.shape[1]):
            own = (np.float32(a[y, x]) - np.float32(b[y, x])) * over[y, x]
            near = max(np.float32(p[y, x]) - np.float32(q[y, x]), np.float32(0)) * near_over[y, x]
            result[y, x] = np.uint8(np.int32(min(max(own - near, np.float32(0)), np.float32(255))))


@compiled
def _foreground_means(rgb: Any, values: Any, box: Any, samples: Any, result: Any) -> None:
    height, width = values.shape
    for i in range(box.shape[0]):
        x0 = max(0, int(box[i, 0]))
        y0 = max(0, int(box[i, 1]))
        x1 = min(width, int(np.ceil(box[i, 2])))
        y1 = min(height, int(np.ceil(box[i, 3])))
        dx = max(1, (x1 - x0) // samples)
        dy = max(1, (y1 - y0) // samples)
        total = 0
        n = 0
        for y in range(y0, y1, dy):
            for x in range(x0, x1, dx):
                total += values[y, x]
                n += 1
        r = 0
        g = 0
        b = 0
        m = 0
        for y in range(y0, y1, dy):
            for x in range(x0, x1, dx):
                if values[y, x] * n >= total:
                    r += rgb[y, x, 0]
                    g += rgb[y, x, 1]
                    b += rgb[y, x, 2]
                    m += 1
        if m > 0:
            result[i, 0] = r / m
            result[i, 1] = g / m
            result[i, 2] = b / m
