"""Whether what surrounds a panel moves with it from view to view: a sign stands apart, a board hangs on a wall.

What lies behind a standing panel is shifted against it by parallax as the vehicle comes nearer. What is part of a wall,
a lorry or a larger board keeps its surroundings: they look the same round the panel in every view.
"""

from collections.abc import Iterable
from functools import partial
from itertools import combinations, islice
from math import nan, sqrt
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, compiled_within

SIDE, SAMPLES = 24, 60
"""Samples of the panel in the middle of a patch, and of the patch, each way."""
PANEL = np.array([[18, 42, 18, 42]])
"""Rows and columns [top, bottom, left, right] of the panel in a patch."""
AROUND = np.array([[18, 42, 2, 15], [18, 42, 45, 58], [2, 15, 8, 52]])
"""The same of what is beside it and above it, but for its blurred edge. Below is a post, which moves with it."""
SEARCH = 2
"""Samples, each way, by which the boxes of two views may differ: the panels themselves are aligned."""
SMALLEST_PX = 9.0
"""Size of a panel below which its surroundings are a few pixels."""
NEARER = 1.35
"""Views are compared where the panel is so many times larger in one of them: else there is little parallax."""
MOST_PAIRS = 24
"""Pairs of views that are compared at most."""
NOISE = 4.0
"""Grey levels: what varies less shows nothing."""

Grey = NDArray[np.float32]
Areas = NDArray[np.int64]


class Patch(NamedTuple):
    """A panel and its surroundings: its size, px, and grey levels (`SAMPLES`, `SAMPLES`)."""

    size_px: float
    grey: Grey


def surroundings_correlation(views: Iterable[tuple[NDArray[np.uint8], Array]]) -> float:
    """Median correlation (-1 to 1) of the surroundings of a panel over pairs of its views, largest first.

    `views`: images (height, width, 3), each with the box of the panel `[left, top, right, bottom]`, px.
    The result is nan where there is no pair to compare.
    """
    patches = [patch for patch in (patch_of(*view) for view in views) if patch is not None]
    patches.sort(key=lambda patch: -patch.size_px)
    pairs = ((a, b) for a, b in combinations(patches, 2) if a.size_px >= NEARER * b.size_px)
    found = [_correlation(near, far) for near, far in islice(pairs, MOST_PAIRS)]
    return float(np.median(found)) if found else nan


def patch_of(rgb: NDArray[np.uint8], box: Array) -> Patch | None:
    """The box with what surrounds it, resampled; None where the image cuts that off, or the panel is small."""
    x0, y0, x1, y1 = box.tolist()
    size_px, more = sqrt((x1 - x0) * (y1 - y0)), (SAMPLES / SIDE - 1) / 2
    left, right = round(x0 - more * (x1 - x0)), round(x1 + more * (x1 - x0))
    top, bottom = round(y0 - more * (y1 - y0)), round(y1 + more * (y1 - y0))
    inside = 0 <= left < right <= rgb.shape[1] and 0 <= top < bottom <= rgb.shape[0]
    if size_px < SMALLEST_PX or not inside:
        return None
    grey = cv2.cvtColor(rgb[top:bottom, left:right], cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, (SAMPLES, SAMPLES), interpolation=cv2.INTER_AREA)
    return Patch(size_px, small.astype(np.float32))


def _correlation(near: Patch, far: Patch) -> float:
    """Correlation of what surrounds the panels of two views, the near one made as blurred as the far."""
    blurred = cv2.GaussianBlur(near.grey, (0, 0), 0.7 * SIDE / far.size_px)
    return _aligned_correlation(np.asarray(blurred, np.float32), far.grey, PANEL, AROUND)


@compiled
def _aligned_correlation(near: Grey, far: Grey, panel: Areas, around: Areas) -> float:
    # Correlation around where the panels correlate best. The patches are (SAMPLES, SAMPLES).
    best, below, beside = -2.0, 0, 0
    for down in range(-SEARCH, SEARCH + 1):
        for right in range(-SEARCH, SEARCH + 1):
            found = _alike(near, far, panel, down, right)
            if found > best:
                best, below, beside = found, down, right
    return _alike(near, far, around, below, beside)


@partial(compiled_within, reorder=True)
def _alike(near: Grey, far: Grey, areas: Areas, down: int, right: int) -> float:
    # Correlation of areas of a patch with those so many samples further down and right in another one.
    x = y = xx = yy = xy = 0.0
    count = 0
    for n in range(areas.shape[0]):
        top, bottom, left, end = areas[n]
        count += (bottom - top) * (end - left)
        for i in range(top, bottom):
            one, other = near[i, left:end], far[i + down, left + right : end + right]
            for j in range(end - left):
                a, b = np.float64(one[j]), np.float64(other[j])
                x, y, xx, yy, xy = x + a, y + b, xx + a * a, yy + b * b, xy + a * b
    power = (xx - x * x / count + count * NOISE**2) * (yy - y * y / count + count * NOISE**2)
    return float((xy - x * y / count) / np.sqrt(power))
