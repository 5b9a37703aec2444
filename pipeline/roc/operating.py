"""Operating points of a gate of several classes: which thresholds give the most true positives for a false positive rate.

A sample belongs to the class that it is nearest to, so each class has a curve of its own, and what the gate accepts is
the sum over the classes. The slope of the upper convex hull of a curve is the likelihood ratio of the samples there; the
lemma of Neyman and Pearson asks for one ratio in all classes. Taking the hulls' segments in the order of their slope
therefore gives, for every false positive rate, the thresholds with the largest true positive rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.roc.curves import DRAWS, KNEE_RULE
from wayside.pipeline.statistics import CONFIDENCE
from wayside.schemas.models import GaussianModel, OperatingPoint

MOST_POINTS = 40
"""Operating points that a model file holds."""


def operating_points(
    distance: NDArray[np.float64], on: NDArray[np.bool_], count: NDArray[np.int64]
) -> tuple[OperatingPoint, ...]:
    """The operating points of a gate, from one that accepts nothing to one that accepts every sign.

    Parameters
    ----------
    distance
        From each class, (n, classes); rows with nan are never accepted.
    on, count
        Whether a sample is a sign, (n,); how many samples it stands for, (n,).

    Returns
    -------
    Rates are those of the gate as it decides, which accepts what any class accepts.

    Raises
    ------
    ValueError
        There is no sign, or nothing else.
    """
    known = np.isfinite(distance).all(axis=1)
    positives, negatives = float(count[on].sum()), float(count[~on].sum())
    if not positives or not negatives:
        raise ValueError("operating points: wanted signs and others, found one of them only")
    nearest = np.where(known[:, None], distance, np.inf).argmin(axis=1)
    segments: list[tuple[float, int, float]] = []
    for j in range(distance.shape[1]):
        own = known & (nearest == j)
        segments += [
            (slope, j, reach)
            for slope, reach in _hull(
                distance[own, j], on[own], count[own] / np.where(on[own], positives, negatives)
            )
        ]
    segments.sort(key=lambda one: -one[0])
    thresholds = np.zeros((len(segments) + 1, distance.shape[1]))
    for row, (_, j, reach) in enumerate(segments, 1):
        thresholds[row] = thresholds[row - 1]
        thresholds[row, j] = reach
    rates = np.array([gate_rates(distance, on, count, row) for row in thresholds])
    return tuple(
        OperatingPoint(*(float(v) for v in rates[i]), tuple(thresholds[i].tolist()))
        for i in _spread(rates)
    )


def gate_rates(
    distance: NDArray[np.float64],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
    thresholds: NDArray[np.float64],
) -> tuple[float, float]:
    """False and true positive rate (eq. 10.2, 10.1) of a gate that accepts what is within any threshold (classes,)."""
    accepted = (distance <= thresholds).any(axis=1)
    return (
        float(count[accepted & ~on].sum() / count[~on].sum()),
        float(count[accepted & on].sum() / count[on].sum()),
    )


def knee_point(points: Sequence[OperatingPoint]) -> OperatingPoint:
    """The point of the largest true minus false positive rate."""
    return max(points, key=lambda one: one.power - one.false_alarm)


def point_at_alpha(points: Sequence[OperatingPoint], alpha: float) -> OperatingPoint:
    """The point of the largest power among those of a false alarm rate of at most `alpha`."""
    allowed = [one for one in points if one.false_alarm <= alpha]
    return max(allowed, key=lambda one: one.power)


def alpha_rule(alpha: float) -> str:
    """The words of a model file for thresholds of a stated false-alarm rate."""
    return f"alpha {alpha:g}: most true positives of at most this false positive rate (report chapter 9)"


def with_learned_thresholds(
    model: GaussianModel,
    distance: NDArray[np.float64],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
    group: NDArray[np.int64],
    alpha: float | None = None,
    seed: int = 1,
) -> GaussianModel:
    """The model with the thresholds of its knee (or of `alpha`), their 95 % intervals and all operating points.

    Parameters
    ----------
    model
        Its classes; their thresholds are replaced.
    distance, on, count
        As in `operating_points`.
    group
        Of each sample (n,): the intervals resample whole groups.
    alpha
        False-alarm rate of the gate; None: the knee.
    seed
        Of the resampling.
    """
    points = operating_points(distance, on, count)
    chosen = knee_point(points) if alpha is None else point_at_alpha(points, alpha)
    draws = _resampled(distance, on, count, group, alpha, seed)
    tails = [100 * (1 - CONFIDENCE) / 2, 100 * (1 + CONFIDENCE) / 2]
    classes = []
    for j, one in enumerate(model.classes):
        interval = None
        if len(draws):
            low, high = np.percentile(draws[:, j], tails)
            interval = (float(low), float(high))
        classes.append(
            replace(
                one,
                threshold=chosen.thresholds[j],
                threshold_rule=KNEE_RULE if alpha is None else alpha_rule(alpha),
                threshold_interval=interval,
            )
        )
    return replace(model, classes=tuple(classes), curve=points)


def _resampled(
    distance: NDArray[np.float64],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
    group: NDArray[np.int64],
    alpha: float | None,
    seed: int,
) -> NDArray[np.float64]:
    """Thresholds (draws, classes) chosen by the same rule on resampled groups; none of a single group."""
    groups, member = np.unique(group, return_inverse=True)
    chosen = []
    if len(groups) > 1:
        draw = np.random.default_rng(seed)
        for _ in range(DRAWS // 8):
            weight = draw.multinomial(len(groups), np.full(len(groups), 1 / len(groups)))[member]
            kept = weight > 0
            if not (on & kept).any() or not (~on & kept).any():
                continue
            points = operating_points(distance[kept], on[kept], (count * weight)[kept])
            point = knee_point(points) if alpha is None else point_at_alpha(points, alpha)
            chosen.append(point.thresholds)
    return np.array(chosen, np.float64).reshape(-1, distance.shape[1])


def _hull(
    distance: NDArray[np.float64], on: NDArray[np.bool_], share: NDArray[np.float64]
) -> list[tuple[float, float]]:
    """Slope and largest distance of each segment of the upper convex hull of a class's curve, up to its last sign."""
    if not on.any():
        return []
    order = np.argsort(distance, kind="stable")
    reach, kind, part = distance[order], on[order], share[order]
    last = np.append(reach[1:] > reach[:-1], True)  # equal distances are accepted together
    x = np.append(0.0, np.cumsum(np.where(kind, 0.0, part))[last])
    y = np.append(0.0, np.cumsum(np.where(kind, part, 0.0))[last])
    at = np.append(0.0, reach[last])
    hull: list[int] = []
    for i in np.flatnonzero(np.append(True, np.diff(y) > 0)):
        while len(hull) > 1 and _left_of(x, y, hull[-2], hull[-1], int(i)):
            hull.pop()
        hull.append(int(i))
    return [
        ((y[b] - y[a]) / max(x[b] - x[a], 1e-12), float(at[b]))
        for a, b in zip(hull[:-1], hull[1:], strict=True)
    ]


def _left_of(x: NDArray[np.float64], y: NDArray[np.float64], a: int, b: int, c: int) -> bool:
    """Whether point b lies on or below the line from a to c."""
    return bool((y[b] - y[a]) * (x[c] - x[a]) <= (y[c] - y[a]) * (x[b] - x[a]))


def _spread(rates: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of at most `MOST_POINTS` points: both ends, the knee, and others evenly along the curve."""
    steps = np.hypot(*np.diff(np.sqrt(rates), axis=0).T)  # small rates are spread out
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0, along[-1], MOST_POINTS - 1)
    rows = np.searchsorted(along, wanted).clip(0, len(rates) - 1)
    return np.unique(np.append(rows, np.argmax(rates[:, 1] - rates[:, 0])))
