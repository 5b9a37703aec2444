"""Lines painted along the road, in a strip of it seen from above."""

import cv2
import numpy as np

from wayside.stages.kernels import Array, Floats, Numbers

COLUMN_M = 0.02
"""Distance of the columns of a strip, across the road."""
LINE_M = 0.10
"""Width of a line: lines of 10 to 20 cm are found."""
FLANK_M = 0.12
"""Road on both sides that a line is compared with; the gap of a double line is as wide."""
CONTRAST = 0.10
"""Least brightness of paint over the road next to it, as a fraction of the road's."""
APART_M = 0.5
"""A line nearer to a better one is a part of it: a double line is one."""
LEAST_PAINTED = 0.2
"""Part of a strip's length that is painted, at least: a strip shows half a dash or more."""
_SHORTEST = np.ones((1, 5), np.uint8)
"""Paint over fewer rows in a row is a spot: gravel, leaves, light through a fence."""


def painted_lines(strip: Floats) -> Array:
    """Column, and painted part of the length, of each line (k, 2) in a strip (columns, rows); nan: not seen.

    Columns are `COLUMN_M` apart, rows lie along the road. A line is brighter than the road on both its sides.
    """
    seen = np.isfinite(strip)
    sums, counts = (
        np.pad(np.cumsum(part, axis=0, dtype=np.float64), ((1, 0), (0, 0)))
        for part in (np.where(seen, strip, 0.0), seen)
    )
    half, flank = round(LINE_M / COLUMN_M / 2), round(FLANK_M / COLUMN_M)
    columns = np.arange(half + flank, len(strip) - half - flank)

    def mean(first: int, last: int) -> Array:
        low, high = columns + first, columns + last + 1
        width = last - first + 1
        whole = counts[high] - counts[low] == width
        return np.asarray(np.where(whole, (sums[high] - sums[low]) / width, np.nan))

    beside = np.maximum(mean(-half - flank, -half - 1), mean(half + 1, half + flank))
    contrast = mean(-half, half) / np.maximum(beside, 1.0) - 1
    known = np.isfinite(contrast)
    paint = np.where(known, np.maximum(contrast, 0.0), 0.0)
    long = cv2.morphologyEx((paint > CONTRAST).view(np.uint8), cv2.MORPH_OPEN, _SHORTEST)
    rows = np.maximum(known.sum(axis=1), strip.shape[1] / 2)
    return _strongest(columns, long.sum(axis=1) / rows, (paint * long).sum(axis=1) / rows)


def _strongest(columns: Numbers, painted: Array, strength: Array) -> Array:
    """Centres and painted parts of the strongest columns, none near a stronger one, from left to right."""
    reach, left = round(APART_M / COLUMN_M), np.where(painted >= LEAST_PAINTED, strength, 0.0)
    found = []
    while left.max(initial=0.0) > 0:
        best = int(left.argmax())
        near = slice(max(best - reach // 2, 0), best + reach // 2 + 1)
        centre = float(np.average(columns[near], weights=strength[near] ** 2))
        found.append((centre, float(painted[near].max())))
        left[max(best - reach, 0) : best + reach + 1] = 0.0
    return np.array(sorted(found)).reshape(-1, 2)
