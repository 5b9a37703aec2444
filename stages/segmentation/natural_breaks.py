"""K-means in one dimension, solved exactly: the classes of pass two (report chapter 2.3)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import compiled


def optimal_breaks(histogram: NDArray[Any], classes: int) -> NDArray[np.int64]:
    """First value of each class in the K-means optimum of whole numbers 0, 1, ... given how often each occurs.

    The best classes are intervals. Dynamic programming finds them without a start or a seed. The cost of the first i
    values in j classes is D[j, i] = min over t of D[j-1, t] + cost(t, i). Here cost is the sum of squared distances to
    the mean, from prefix sums. The best t never falls as i grows, which divide and conquer uses: O(classes n log n).
    (Lloyd steps from quantiles end at two to three times this optimum.)

    Parameters
    ----------
    histogram
        How often each value occurs, shape (n,), none negative.
    classes
        k, 1 to n. Some classes are empty where fewer values occur.

    Returns
    -------
    Shape (classes,), rising (equal where a class is empty), the first is 0.

    Raises
    ------
    ValueError
        If the histogram is empty, not one-dimensional or negative somewhere, or k is not from 1 to n.
    """
    counts = np.ascontiguousarray(histogram, np.float64)
    if counts.ndim != 1 or not 1 <= classes <= counts.size:
        raise ValueError(f"classes: {classes} is outside 1 to the number of values, {counts.shape}")
    if not np.all(counts >= 0):
        raise ValueError("histogram: a count is negative or nan")
    cost = np.empty((classes + 1, counts.size + 1))
    start = np.zeros((classes + 1, counts.size + 1), np.int64)
    _fill_costs(counts, cost, start)
    breaks = np.empty(classes, np.int64)
    end = counts.size
    for j in range(classes, 0, -1):
        end = start[j, end]
        breaks[j - 1] = end
    return breaks


def classes_of_values(breaks: NDArray[np.int64], values: int) -> NDArray[np.uint8]:
    """Class of each of the values 0 to values - 1, from the first value of each class: shape (values,)."""
    return np.searchsorted(breaks[1:], np.arange(values), side="right").astype(np.uint8)


@compiled
def _fill_costs(
    counts: NDArray[np.float64], cost: NDArray[np.float64], start: NDArray[np.int64]
) -> None:
    """`cost[j, i]` of the first i values in j classes, and the first value `start[j, i]` of the last class."""
    n = counts.size
    weight, first, second = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    for i in range(n):
        weight[i + 1] = weight[i] + counts[i]
        first[i + 1] = first[i] + counts[i] * i
        second[i + 1] = second[i] + counts[i] * i * i
    cost[0, :] = 1e300
    cost[0, 0] = 0.0
    # Spans still to do: values low to high, whose best start lies from `least` to `most`.
    spans = np.empty((4 * n + 8, 4), np.int64)
    for j in range(1, cost.shape[0]):
        spans[0, 0], spans[0, 1], spans[0, 2], spans[0, 3] = 0, n, 0, n
        waiting = 1
        while waiting > 0:
            waiting -= 1
            span = spans[waiting]
            low, high, least, most = span[0], span[1], span[2], span[3]
            middle = (low + high) // 2
            best = 1e301
            at = least
            for t in range(least, min(middle, most) + 1):
                w = weight[middle] - weight[t]
                own = 0.0
                if w > 0:
                    s = first[middle] - first[t]
                    own = max(0.0, second[middle] - second[t] - s * s / w)
                if cost[j - 1, t] + own < best:
                    best = cost[j - 1, t] + own
                    at = t
            cost[j, middle] = best
            start[j, middle] = at
            if low < middle:
                span = spans[waiting]
                span[0], span[1], span[2], span[3] = low, middle - 1, least, at
                waiting += 1
            if middle < high:
                span = spans[waiting]
                span[0], span[1], span[2], span[3] = middle + 1, high, at, most
                waiting += 1
