"""Maps of one value in which a sign face is brighter than what surrounds it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled, require_image

MAPS = ("red", "blue", "green", "yellow", "lighter", "darker")
"""Red over green; blue over red; green over red; red and green over blue; lighter and darker.

Each less what the neighbourhood has of it. Orange and brown show in the first and fourth, fluorescent yellow-green in
the third and fourth.
"""

LOWEST = (12, 10, 8, 14, 10, 10)
"""First level of each map that can matter: below it lie road, sky and foliage."""

DARK_LEVEL = 64
"""Added to the largest channel before a difference of channels is divided by it: keeps the noise of shadows down."""

NEIGHBOURHOOD = 104
"""Side of the square whose mean stands for the neighbourhood, pixels of the map."""


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
    require_image(rgb)
    result = np.empty((len(MAPS), *rgb.shape[:2]), np.uint8)
    if rgb.size:
        own = np.stack(cv2.split(rgb))
        near = np.stack(cv2.split(neighbourhood(rgb)))
        _face_maps(own.astype(np.uint8, copy=False), near.astype(np.uint8, copy=False), result)
    return result


@compiled
def _excess(a: Any, b: Any, over: Any, p: Any, q: Any, around: Any, result: Any) -> None:
    """By how much a exceeds b, relative to `over`, less the same of the neighbourhood, p, q and `around`: one row."""
    for x in range(a.size):
        own = (np.float32(a[x]) - np.float32(b[x])) * over[x]
        near = max(np.float32(p[x]) - np.float32(q[x]), np.float32(0)) * around[x]
        result[x] = np.uint8(np.int32(min(max(own - near, np.float32(0)), np.float32(255))))


@compiled
def _largest(a: Any, b: Any, c: Any, result: Any) -> None:
    for x in range(a.size):
        result[x] = max(max(a[x], b[x]), c[x])


@compiled
def _smallest(a: Any, b: Any, c: Any, result: Any) -> None:
    for x in range(a.size):
        result[x] = min(min(a[x], b[x]), c[x])


@compiled
def _scale(largest: Any, result: Any) -> None:
    for x in range(largest.size):
        result[x] = np.float32(256) / (np.float32(largest[x]) + np.float32(DARK_LEVEL))


@compiled
def _above(a: Any, b: Any, result: Any) -> None:
    for x in range(a.size):
        result[x] = a[x] - min(a[x], b[x])


@compiled
def _face_maps(own: Any, near: Any, result: Any) -> None:
    """Row by row and one thing at a time, so that each loop runs over many pixels at once."""
    width = own.shape[2]
    value = np.empty((4, width), np.uint8)
    scale = np.empty((2, width), np.float32)
    for y in range(own.shape[1]):
        r = own[0, y]
        g = own[1, y]
        b = own[2, y]
        p = near[0, y]
        q = near[1, y]
        s = near[2, y]
        _largest(r, g, b, value[0])
        _largest(p, q, s, value[1])
        _scale(value[0], scale[0])
        _scale(value[1], scale[1])
        _excess(r, g, scale[0], p, q, scale[1], result[0, y])
        _excess(b, r, scale[0], s, p, scale[1], result[1, y])
        _excess(g, r, scale[0], q, p, scale[1], result[2, y])
        _above(value[1], value[0], result[5, y])
        _smallest(r, g, g, value[2])
        _smallest(p, q, q, value[3])
        _excess(value[2], b, scale[0], value[3], s, scale[1], result[3, y])
        _smallest(r, g, b, value[2])
        _smallest(p, q, s, value[3])
        _above(value[2], value[3], result[4, y])
