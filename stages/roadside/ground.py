"""The ground across the road: the heights at which the images agree best."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array

SLOPE_COST = 1.0
"""Correlation that a change of height by a metre from one strip to the next must gain (set on rendered drives)."""
STEEPEST = 1.0
"""Steepest ground across the road, metres a metre."""
OTHER_HEIGHT_M = 0.25
"""Heights that differ by more are other explanations of a patch."""
NEIGHBOUR_WEIGHTS = (1.0, 1.0, 0.5)
"""Weights of a station, of those next to it and of those after: the ground changes little along 20 m of road."""


class Ground(NamedTuple):
    """Heights of strips across the road (n,), metres, and what they rest on; nan where no images see the strip."""

    height: Array
    agreement: Array
    """Mean correlation at that height."""
    margin: Array
    """How far it is above that at the best other height; -1 where the height is no maximum."""
    curvature: Array
    """Of the correlation at that height, 1/m^2."""
    greatest: Array
    """Greatest mean correlation at any height."""


def ground_of(score: NDArray[Any], pairs: NDArray[Any], heights: Array) -> Ground:
    """The heights of strips side by side at which the images agree best together.

    `score` (n, h): sum of the correlations of `pairs` (n,) pairs of images at evenly spaced heights (h,). Found by
    dynamic programming: a strip that shows nothing follows its neighbours.
    """
    mean = score / np.maximum(pairs, 1e-9)[:, None]
    step = float(heights[1] - heights[0])
    change = np.abs(heights[:, None] - heights)
    cost = np.where(change <= STEEPEST + step / 2, SLOPE_COST * change, np.inf)
    best, origins = mean[0], []
    for row in mean[1:]:
        reached = best[:, None] - cost
        origins.append(reached.argmax(axis=0))
        best = reached.max(axis=0) + row
    chosen = [int(best.argmax())]
    for origin in reversed(origins):
        chosen.append(int(origin[chosen[-1]]))
    strips, last = np.arange(len(mean)), len(heights) - 2
    around = np.clip(chosen[::-1], 1, last)[:, None] + (0, -1, 1)
    # the neighbours may hold a strip one step off its own maximum
    at = np.clip(around[strips, mean[strips[:, None], around].argmax(axis=1)], 1, last)
    low, peak, high = (mean[strips, at + k] for k in (-1, 0, 1))
    bend = np.maximum(2 * peak - low - high, 1e-6)
    height = heights[at] + step * np.clip((high - low) / (2 * bend), -0.5, 0.5)
    others = np.where(change[at] > OTHER_HEIGHT_M, mean, -1.0).max(axis=1)
    # at an end of the range, and on a slope that leads elsewhere, the height is not where agreement is greatest
    margin = np.where((peak >= low) & (peak >= high), peak - others, -1.0)
    parts = height, peak, margin, bend / step**2, mean.max(axis=1)
    return Ground(*(np.where(pairs > 0, part, np.nan) for part in parts))


def pooled(values: Sequence[NDArray[Any]], at: int) -> Array:
    """Weighted sum of the values of a station and those around it."""
    reach = len(NEIGHBOUR_WEIGHTS) - 1
    near = range(max(at - reach, 0), min(at + reach + 1, len(values)))
    parts = [NEIGHBOUR_WEIGHTS[abs(k - at)] * values[k] for k in near]
    return np.asarray(np.sum(parts, axis=0), np.float64)
