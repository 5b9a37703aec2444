"""Thresholds of a model of Gaussian classes by a rule, and its operating points: what it does at other thresholds.

Classes that the labels tell apart (colours, shapes) are each a test of their own: its signs against what is no sign, as
in chapter 10; an operating point gives all of them one false positive rate. Knees that are chosen class by class accept
together far more than any of them: where there are many, one knee is chosen for the gate.

Components of one class (signs right of the road, left of it, above it) are one test. A sample belongs to the component
that it is nearest to; the slope of the upper convex hull of a component's curve is the likelihood ratio of the samples
there, and the lemma of Neyman and Pearson asks for one ratio everywhere. Taking the steps of all curves in the order of
the slope of their hull gives, for every false positive rate, the radii with the largest true positive rate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.samples import ON
from wayside.pipeline.roc.classifier_samples import NO_CLASS, ClassifierSamples
from wayside.pipeline.roc.curves import KNEE_RULE, Scores, resampled_groups, roc_curve
from wayside.pipeline.roc.score_points import counted_tail, rates_of, score_points
from wayside.pipeline.statistics import CONFIDENCE
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianModel, MixtureModel, OperatingPoint

MOST_POINTS = 40
"""Operating points that a model file holds."""

DRAWS = 100
"""Resamplings of the thresholds of all classes together."""

JOINT_RULE = "knee of the ROC of all components together: " + KNEE_RULE.partition(": ")[2]

GATE_RULE = (
    "knee of the ROC of the gate, its classes of one false positive rate: "
    + KNEE_RULE.partition(": ")[2]
)

Points = tuple[OperatingPoint, ...]


def with_learned_thresholds(
    model: GaussianModel, samples: ClassifierSamples, seed: int = 1, *, one_knee: bool = False
) -> GaussianModel:
    """The model with the thresholds of its knees, their 95 % intervals, and its operating points.

    Parameters
    ----------
    model
        Its classes; their thresholds are replaced. A class without a sign keeps its own, and its rule; with one knee it
        gets the false positive rate of the others.
    samples
        What the classifier was asked about on labelled drives; the intervals resample the drives, or the stretches of a
        single one.
    seed
        Of the resampling.
    one_knee
        Of classes that the labels tell apart: the thresholds of the operating point with the largest true minus false
        positive rate of the gate as a whole, not the knee of each class.

    Raises
    ------
    InputError
        There is no sign among the samples, or nothing else.
    """
    own = samples.known()
    on, group = own.label == ON, resampled_groups(own.drive, own.frame)[0]
    distance = model.distances(own.values)
    if not on.any() or on.all():
        raise InputError(
            f"thresholds of {samples.classifier}: wanted signs and other things, found {int(on.sum())} signs among "
            f"{len(on)} samples; label more images"
        )
    of_class = on[:, None] & (own.kind[:, None] == np.array([one.name for one in model.classes]))
    labelled = bool((own.kind != NO_CLASS).any())
    if labelled and not one_knee:
        return _with_class_knees(model, own, distance, on, group, seed)

    def points_of(rows: NDArray[np.bool_], count: NDArray[np.int64]) -> Points:
        if labelled:
            return class_points(distance[rows], of_class[rows], on[rows], count[rows])
        return component_points(distance[rows], on[rows], count[rows])

    points = points_of(np.ones(len(on), np.bool_), own.count)
    chosen = _knee(points)
    draws = _resampled(points_of, on, own.count, group, seed)
    tails = [100 * (1 - CONFIDENCE) / 2, 100 * (1 + CONFIDENCE) / 2]
    ends = np.percentile(draws, tails, axis=0) if len(draws) else None
    classes = tuple(
        replace(
            one,
            threshold=chosen.thresholds[j],
            threshold_rule=(JOINT_RULE, GATE_RULE)[labelled]
            if len(model.classes) > 1
            else KNEE_RULE,
            threshold_interval=None if ends is None else (float(ends[0, j]), float(ends[1, j])),
        )
        for j, one in enumerate(model.classes)
    )
    return replace(model, classes=classes, curve=points)


def with_score_threshold(model: MixtureModel, samples: ClassifierSamples) -> MixtureModel:
    """The density with the threshold at the knee of its ROC, the interval of that, and its operating points.

    Parameters
    ----------
    model
        Density of what is typical.
    samples
        What the gate was asked about on labelled drives that it was not learned from, with the mean log density under
        this model as value; what has none (-inf) is never accepted.

    Raises
    ------
    InputError
        There is no sign among the samples, or nothing else.
    """
    own = samples.known()
    value, on = own.values[:, 0], own.label == ON
    group = resampled_groups(own.drive, own.frame)[0]
    curve = roc_curve(Scores(value, on, own.count, group, accept_below=False))
    if curve is None:
        raise InputError(
            f"thresholds of {samples.classifier}: wanted signs and other things, found {int(on.sum())} signs among "
            f"{len(on)} samples; label more images"
        )
    known = np.isfinite(value)
    return replace(
        model,
        threshold=float(curve.threshold[curve.knee]),
        threshold_rule=(
            f"{KNEE_RULE}; {curve.tpr[curve.knee]:.3f} of {curve.positives} tracks of signs and "
            f"{curve.fpr[curve.knee]:.3f} of {curve.negatives} others"
        ),
        threshold_interval=curve.knee_interval,
        curve=score_points(
            value[known], on[known], group[known], counted_tail, rates_of(curve.negatives)
        ),
    )


def component_points(
    distance: NDArray[np.float64], on: NDArray[np.bool_], count: NDArray[np.int64]
) -> tuple[OperatingPoint, ...]:
    """Operating points of the components of one class, from one that accepts nothing to one that accepts every sign.

    Parameters
    ----------
    distance
        From each component, (n, components); rows with nan are never accepted.
    on, count
        Whether a sample is a sign, (n,); how many samples it stands for, (n,). There are signs and others.
    """
    known = np.asarray(np.isfinite(distance).all(axis=1))
    positives, negatives = float(count[on].sum()), float(count[~on].sum())
    share = count / np.where(on, positives, negatives)
    nearest = np.asarray(np.where(known[:, None], distance, np.inf).argmin(axis=1))
    segments: list[tuple[float, int, float]] = []
    for j in range(distance.shape[1]):
        own = np.asarray(known & (nearest == j))
        hull = _hull(distance[own, j], on[own], share[own])
        segments += [(slope, j, reach) for slope, reach in hull]
    segments.sort(key=lambda one: -one[0])
    thresholds = np.zeros((len(segments) + 1, distance.shape[1]))
    for row, (_, j, reach) in enumerate(segments, 1):
        thresholds[row] = thresholds[row - 1]
        # of steps of one slope, rounding may sort the farther before the nearer
        thresholds[row, j] = max(thresholds[row - 1, j], reach)
    return _points(distance, on, count, thresholds)


def class_points(
    distance: NDArray[np.float64],
    own: NDArray[np.bool_],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
) -> tuple[OperatingPoint, ...]:
    """Operating points of classes that labels tell apart: at each, all have one false positive rate.

    A class without a sign gets the distance within which that share of the others is.

    Parameters
    ----------
    distance
        From each class, (n, classes); rows with nan are never accepted.
    own
        Whether a sample is a sign of the class, (n, classes).
    on, count
        As in `component_points`.
    """
    levels = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 4 * MOST_POINTS)])
    thresholds = np.zeros((len(levels), distance.shape[1]))
    weight = count[~on]
    for j in range(distance.shape[1]):
        order = np.argsort(distance[~on, j])
        reach, accepted = distance[~on, j][order], np.cumsum(weight[order]) / weight.sum()
        signs = np.sort(distance[own[:, j], j])
        signs = signs[np.isfinite(signs)]
        if len(signs) == 0:
            thresholds[:, j] = np.append(0.0, reach)[
                np.searchsorted(accepted, levels, side="right")
            ]
            continue
        # the farthest sign before more others than the level come in
        rows = np.searchsorted(accepted, levels, side="right")
        limits = np.append(reach, np.inf)[rows]
        nearer = np.searchsorted(signs, limits, side="left")
        thresholds[:, j] = np.where(nearer > 0, signs[nearer - 1], 0.0)
    return _points(distance, on, count, np.unique(thresholds, axis=0))


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


def _with_class_knees(
    model: GaussianModel,
    samples: ClassifierSamples,
    distance: NDArray[np.float64],
    on: NDArray[np.bool_],
    group: NDArray[np.int64],
    seed: int,
) -> GaussianModel:
    own = np.stack([on & (samples.kind == one.name) for one in model.classes], axis=1)
    classes = []
    for j, one in enumerate(model.classes):
        rows = ~on | own[:, j]
        values, mine = distance[rows, j], own[rows, j]
        scores = Scores(values, mine, samples.count[rows], group[rows], accept_below=True)
        curve = roc_curve(scores, seed)
        if curve is None:
            classes.append(one)
            continue
        classes.append(
            replace(
                one,
                threshold=max(0.0, float(curve.threshold[curve.knee])),
                threshold_rule=KNEE_RULE,
                threshold_interval=curve.knee_interval,
            )
        )
    points = class_points(distance, own, on, samples.count)
    return replace(model, classes=tuple(classes), curve=points)


def _knee(points: Sequence[OperatingPoint]) -> OperatingPoint:
    """The point of the largest true minus false positive rate."""
    return max(points, key=lambda one: one.power - one.false_alarm)


def _resampled(
    points_of: Callable[[NDArray[np.bool_], NDArray[np.int64]], Points],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
    group: NDArray[np.int64],
    seed: int,
) -> NDArray[np.float64]:
    """Thresholds (draws, classes) at the knee of resampled groups; none of a single group."""
    groups, member = np.unique(group, return_inverse=True)
    chosen = []
    if len(groups) > 1:
        draw = np.random.default_rng(seed)
        for _ in range(DRAWS):
            weight = draw.multinomial(len(groups), np.full(len(groups), 1 / len(groups)))[member]
            kept = weight > 0
            if (on & kept).any() and (~on & kept).any():
                chosen.append(_knee(points_of(kept, count * weight)).thresholds)
    return np.array(chosen, np.float64)


def _points(
    distance: NDArray[np.float64],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
    thresholds: NDArray[np.float64],
) -> tuple[OperatingPoint, ...]:
    """Some of these thresholds (m, classes) with the rates of the gate there, by rising rates."""
    thresholds = thresholds[
        np.linspace(0, len(thresholds) - 1, min(len(thresholds), 4 * MOST_POINTS)).astype(int)
    ]
    rates = np.array([gate_rates(distance, on, count, row) for row in thresholds])
    order = np.lexsort((rates[:, 1], rates[:, 0]))
    order = order[_spread(rates[order])]
    return tuple(
        OperatingPoint(float(rates[i, 0]), float(rates[i, 1]), tuple(thresholds[i].tolist()))
        for i in order
    )


def _hull(
    distance: NDArray[np.float64], on: NDArray[np.bool_], share: NDArray[np.float64]
) -> list[tuple[float, float]]:
    """Steps of a component's curve from sign to sign: the slope of the upper convex hull there, and the distance."""
    if not on.any():
        return []
    order = np.argsort(distance, kind="stable")
    reach, kind, part = distance[order], on[order], share[order]
    last = np.append(reach[1:] > reach[:-1], True)  # equal distances are accepted together
    x = np.append(0.0, np.cumsum(np.where(kind, 0.0, part))[last])
    y = np.append(0.0, np.cumsum(np.where(kind, part, 0.0))[last])
    at = np.append(0.0, reach[last])
    signs = np.flatnonzero(np.append(True, np.diff(y) > 0))
    hull: list[int] = []
    for i in signs.tolist():
        while len(hull) > 1 and _on_or_below(x, y, hull[-2], hull[-1], i):
            hull.pop()
        hull.append(i)
    return [
        ((y[b] - y[a]) / max(x[b] - x[a], 1e-12), float(at[i]))
        for a, b in pairwise(hull)
        for i in signs[(signs > a) & (signs <= b)]
    ]


def _on_or_below(x: NDArray[np.float64], y: NDArray[np.float64], a: int, b: int, c: int) -> bool:
    """Whether point b lies on or below the line from a to c."""
    return bool((y[b] - y[a]) * (x[c] - x[a]) <= (y[c] - y[a]) * (x[b] - x[a]))


def _spread(rates: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of at most `MOST_POINTS` points: both ends, the knee, and others evenly along the curve."""
    steps = np.hypot(*np.diff(np.sqrt(rates), axis=0).T)  # small rates are spread out
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0, along[-1], MOST_POINTS - 1)
    rows = np.searchsorted(along, wanted).clip(0, len(rates) - 1)
    return np.unique(np.append(rows, np.argmax(rates[:, 1] - rates[:, 0])))
