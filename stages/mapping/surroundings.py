"""Whether what surrounds a panel moves with it from view to view: a sign stands apart, a board hangs on a wall.

What lies behind a standing panel is shifted against it by parallax as the vehicle comes nearer. What is part of a wall,
a lorry or a larger board keeps its surroundings: they look the same round the panel in every view.
"""

from collections.abc import Iterable
from itertools import combinations, islice
from math import nan, sqrt
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array

SIDES, SAMPLES = 2.5, 60
"""Width and height of a patch: in those of the panel in its middle, and in samples."""
GAP = 1.25
"""Surroundings begin beyond so many sides of the panel: its edge, blurred, is none of them."""
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

_AT = ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5) * SIDES
"""Middles of the samples of a patch, each way, in sides of the panel from its middle."""
_FIRST, _LAST = np.flatnonzero(np.abs(_AT) < 0.5)[[0, -1]] + [0, 1]
_PANEL, _SEARCHED = (slice(_FIRST - more, _LAST + more) for more in (0, SEARCH))
"""Samples of the panel in a patch, each way, and those in which it is searched for."""
_OUTSIDE = (np.abs(_AT) > GAP / 2) & (np.abs(_AT) < _AT[-SEARCH])
_BESIDE = np.outer(np.abs(_AT) < 0.5, _OUTSIDE)
_ABOVE = np.outer(_OUTSIDE & (_AT < 0), np.abs(_AT) < 0.9)
_AROUND = np.flatnonzero(_BESIDE | _ABOVE)
"""Numbers of the samples beside and above the panel. Below is a post, which moves with it."""


class Patch(NamedTuple):
    """A panel and its surroundings: its size, px, and grey levels (`SAMPLES`, `SAMPLES`)."""

    size_px: float
    grey: NDArray[np.float32]


def surroundings_correlation(views: Iterable[tuple[NDArray[np.uint8], Array]]) -> float:
    """Median correlation (-1 to 1) of the surroundings of a panel over pairs of its views, largest first.

    `views`: images (height, width, 3), each with the box of the panel `[left, top, right, bottom]`, px.
    The result is nan where there is no pair to compare.
    """
    patches = [patch for patch in (patch_of(*view) for view in views) if patch is not None]
    patches.sort(key=lambda patch: -patch.size_px)
    pairs = ((a, b) for a, b in combinations(patches, 2) if a.size_px >= NEARER * b.size_px)
    aligned = [_aligned(near, far) for near, far in islice(pairs, MOST_PAIRS)]
    if not aligned:
        return nan
    grey = np.array(aligned, np.float64)
    grey -= grey.mean(axis=2, keepdims=True)
    one, other = grey.swapaxes(0, 1)
    power = (grey**2).sum(axis=2) + grey.shape[2] * NOISE**2
    return float(np.median((one * other).sum(axis=1) / np.sqrt(power.prod(axis=1))))


def patch_of(rgb: NDArray[np.uint8], box: Array) -> Patch | None:
    """An image resampled to `SIDES` times the box; None where the image cuts it off, or the panel is small."""
    x0, y0, x1, y1 = box.tolist()
    size_px, more = sqrt((x1 - x0) * (y1 - y0)), (SIDES - 1) / 2
    left, right = round(x0 - more * (x1 - x0)), round(x1 + more * (x1 - x0))
    top, bottom = round(y0 - more * (y1 - y0)), round(y1 + more * (y1 - y0))
    height, width = rgb.shape[:2]
    inside = 0 <= left < right <= width and 0 <= top < bottom <= height
    if size_px < SMALLEST_PX or not inside:
        return None
    grey = cv2.cvtColor(rgb[top:bottom, left:right], cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, (SAMPLES, SAMPLES), interpolation=cv2.INTER_AREA)
    return Patch(size_px, small.astype(np.float32))


def _aligned(near: Patch, far: Patch) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Samples beside and above the panels of two views, their panels aligned, the near one as blurred as the far."""
    blurred = cv2.GaussianBlur(near.grey, (0, 0), 0.7 * SAMPLES / SIDES / far.size_px)
    scores = cv2.matchTemplate(
        far.grey[_SEARCHED, _SEARCHED], blurred[_PANEL, _PANEL], cv2.TM_CCOEFF_NORMED
    )
    _, _, _, (right, down) = cv2.minMaxLoc(scores)
    moved = _AROUND + (down - SEARCH) * SAMPLES + right - SEARCH
    return np.asarray(blurred, np.float32).ravel()[_AROUND], far.grey.ravel()[moved]
