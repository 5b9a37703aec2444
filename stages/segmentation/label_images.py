"""Nearest palette colour of every pixel, exactly: the label image of pass one and the difference image.

Distances are packed with labels: s_j = 16 (|m_j|^2 - 2 m_j.x) + j. This is an integer below 2^24 in size for integer
colours and at most 16 centres, and exact in single precision, fused or not. As min_j s_j + 16 |x|^2 = 16 d^2 + label,
one minimum gives the nearest centre (the lower label on a tie) and the squared distance. Both are the same on every
machine. More centres are compared in groups of 16, whose minima are packed as 256 d^2 + label in whole numbers.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled_exact, require_array, require_image

MOST_CENTERS = 256
"""A label image holds bytes."""

DIFFERENCES = 443
"""Rounded distances between colours: 0 to 442 = round(255 sqrt 3)."""

_GROUP = 16
"""Centres compared at a time: their labels take the low four bits of a number whose others are a squared distance."""

_FAR = np.float32(8e6)
_CHUNK = 1024
_ROUNDED = np.arange(DIFFERENCES, dtype=np.uint16)

Number = TypeVar("Number", bound=np.integer)


def packed_centers(centers: NDArray[Any]) -> NDArray[np.float32]:
    """Constants of s_j for integer centres (k, 3): shape (k rounded up to a multiple of 4, 4), j counted in each group.

    Raises
    ------
    ValueError
        If there are not 1 to 256 centres or one is no integer colour from 0 to 255.
    """
    colors = np.asarray(centers, np.float64)
    if colors.ndim != 2 or colors.shape[1] != 3 or not 1 <= len(colors) <= MOST_CENTERS:
        raise ValueError(
            f"centres: shape {colors.shape} instead of (k, 3) with k from 1 to {MOST_CENTERS}"
        )
    if not np.array_equal(colors, np.clip(np.rint(colors), 0, 255)):
        raise ValueError("centres: not whole numbers from 0 to 255. Round and clip them first.")
    packed = np.zeros((-(-len(colors) // 4) * 4, 4), np.float32)
    packed[:, 0] = _FAR
    packed[: len(colors), 0] = 16 * (colors**2).sum(axis=1) + np.arange(len(colors)) % _GROUP
    packed[: len(colors), 1:] = -32 * colors
    return packed


def label_both_passes(
    rgb: NDArray[np.uint8], centers: NDArray[Any], difference_class: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Nearest centre of each pixel, and the class of its rounded distance to it: the label images of both passes.

    The distance is the difference image of the report (chapter 2.3).

    Parameters
    ----------
    rgb
        Image, (height, width, 3) uint8, C-contiguous; whole rows of a larger one may be given.
    centers
        Whole-numbered colours, (k, 3), k from 1 to 256.
    difference_class
        Class of pass two of each rounded distance, shape (443,).

    Returns
    -------
    Labels of pass one (the lower one on a tie) and of pass two, each (height, width) uint8.

    Raises
    ------
    ValueError
        If an array is of another type, shape or layout.
    """
    require_image(rgb)
    require_array(difference_class, "difference_class", np.uint8, (DIFFERENCES,))
    first, second = _nearest_centers(rgb.reshape(-1, 3), centers, difference_class)
    return first.reshape(rgb.shape[:2]), second.reshape(rgb.shape[:2])


def difference_image(rgb: NDArray[np.uint8], centers: NDArray[Any]) -> NDArray[np.uint16]:
    """The grey difference image (report chapter 2.3): distance of each pixel to its nearest centre, rounded, 0 to 442.

    `label_both_passes` makes it in its sweep and keeps the class of each of these numbers alone. Arguments and errors
    are the same; the result is (height, width).
    """
    require_image(rgb)
    return _nearest_centers(rgb.reshape(-1, 3), centers, _ROUNDED)[1].reshape(rgb.shape[:2])


def mean_of_labels(colors: NDArray[np.uint8], centers: NDArray[Any]) -> NDArray[np.float64]:
    """Mean of the colours (n, 3) nearest to each centre, (k, 3), or the centre itself.

    One Lloyd step of K-means in full colours.
    """
    label, _ = _nearest_centers(colors, centers, _ROUNDED)
    k = len(centers)
    count = np.bincount(label, minlength=k)[:, None]
    sums = np.stack([np.bincount(label, channel, k) for channel in colors.T], axis=1)
    return np.where(count > 0, sums / np.maximum(count, 1), np.asarray(centers, np.float64))


def difference_histogram(colors: NDArray[np.uint8], centers: NDArray[Any]) -> NDArray[np.int64]:
    """How many of the colours (n, 3) lie at each rounded distance from their nearest centre: shape (443,)."""
    return np.bincount(_nearest_centers(colors, centers, _ROUNDED)[1], minlength=DIFFERENCES)


def _nearest_centers(
    colors: NDArray[np.uint8], centers: NDArray[Any], of_distance: NDArray[Number]
) -> tuple[NDArray[np.uint8], NDArray[Number]]:
    """Nearest centre of each colour (n, 3), and the entry (443,) of its rounded distance to it."""
    require_array(colors, "colors", np.uint8, (None, 3))
    label, entry = np.empty(len(colors), np.uint8), np.empty(len(colors), of_distance.dtype)
    _fill_nearest(colors, packed_centers(centers), of_distance, label, entry)
    return label, entry


@compiled_exact
def _pack(
    colors: NDArray[np.uint8],
    packed: NDArray[np.float32],
    planes: NDArray[np.float32],
    best: NDArray[np.float32],
) -> None:
    """16 d^2 + label of each colour (n, 3) in one group, four centres a sweep: the sums stay in vector registers."""
    n = colors.shape[0]
    for x in range(n):
        planes[0, x] = np.float32(colors[x, 0])
        planes[1, x] = np.float32(colors[x, 1])
        planes[2, x] = np.float32(colors[x, 2])
        best[x] = _FAR
    for j in range(0, packed.shape[0], 4):
        a0, a1, a2, a3 = packed[j, 0], packed[j, 1], packed[j, 2], packed[j, 3]
        b0, b1, b2, b3 = packed[j + 1, 0], packed[j + 1, 1], packed[j + 1, 2], packed[j + 1, 3]
        c0, c1, c2, c3 = packed[j + 2, 0], packed[j + 2, 1], packed[j + 2, 2], packed[j + 2, 3]
        d0, d1, d2, d3 = packed[j + 3, 0], packed[j + 3, 1], packed[j + 3, 2], packed[j + 3, 3]
        for x in range(n):
            red, green, blue = planes[0, x], planes[1, x], planes[2, x]
            s = a0 + a1 * red + a2 * green + a3 * blue
            t = b0 + b1 * red + b2 * green + b3 * blue
            u = c0 + c1 * red + c2 * green + c3 * blue
            v = d0 + d1 * red + d2 * green + d3 * blue
            s = s if s < t else t
            u = u if u < v else v
            s = s if s < u else u
            old = best[x]
            best[x] = s if s < old else old
    for x in range(n):
        red, green, blue = planes[0, x], planes[1, x], planes[2, x]
        best[x] += np.float32(16) * (red * red + green * green + blue * blue)


@compiled_exact
def _nearest(
    colors: NDArray[np.uint8],
    packed: NDArray[np.float32],
    planes: NDArray[np.float32],
    best: NDArray[np.float32],
    codes: NDArray[np.int32],
) -> None:
    """256 d^2 + label of each colour (n, 3) in all groups: the lower label on a tie."""
    codes[:] = np.int32(2**31 - 1)
    for start in range(0, packed.shape[0], _GROUP):
        _pack(colors, packed[start : start + _GROUP], planes, best)
        first = np.int32(start)
        for x in range(colors.shape[0]):
            code = np.int32(best[x])
            code = ((code >> 4) << 8) + (code & 15) + first
            codes[x] = min(codes[x], code)


@compiled_exact
def _fill_nearest(
    colors: NDArray[np.uint8],
    packed: NDArray[np.float32],
    of_distance: NDArray[Number],
    label: NDArray[np.uint8],
    entry: NDArray[Number],
) -> None:
    planes, best = np.empty((3, _CHUNK), np.float32), np.empty(_CHUNK, np.float32)
    codes = np.empty(_CHUNK, np.int32)
    for start in range(0, colors.shape[0], _CHUNK):
        part = colors[start : start + _CHUNK]
        _nearest(part, packed, planes, best, codes)
        for x in range(part.shape[0]):
            label[start + x] = codes[x] & 255
            rounded = np.int32(np.sqrt(np.float32(codes[x] >> 8)) + np.float32(0.5))
            entry[start + x] = of_distance[rounded]
