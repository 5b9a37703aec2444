"""Thresholds by a rule, and operating points: what a gate does at other thresholds (report chapters 9 and 10).

Each class that the labels distinguish (colours, shapes) is a test of its own: its signs against everything else, as in
chapter 10. An operating point gives all of them one false positive rate. Knees that are chosen class by class accept
together far more than any of them: where there are many, one knee is chosen for the gate.

Components of one class (signs right of the road, left of it, above it) are one test. A sample belongs to the component
that it is nearest to. The slope of the upper convex hull of a component's curve is the likelihood ratio of the samples
there. By the lemma of Neyman and Pearson, the ratio must be the same everywhere. Taking the steps of all curves in the
order of the slope of their hull gives, for every false positive rate, the radii with the largest true positive rate.

A score that rises with the likelihood ratio has, by the same lemma, the most power of all tests of a false-alarm rate.
Its threshold leaves this share of everything that is not a sign above it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.stats import norm

from wayside.pipeline.learning.asked import NO_CLASS, ClassifierSamples, Rows
from wayside.pipeline.learning.curves import KNEE, KNEE_RULE, RocCurve, resampled_groups
from wayside.pipeline.learning.labelled import ON
from wayside.pipeline.statistics import TAILS, resamplings
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianModel, MixtureModel, OperatingPoint
from wayside.stages.classifiers import class_distances, most_powerful

MOST_POINTS = 40
"""Operating points that a model file holds."""

DRAWS = 100
"""Resamplings of the thresholds of all classes together."""

JOINT_RULE = f"knee of the ROC of all components together: {KNEE}"
GATE_RULE = f"knee of the ROC of the gate, its classes of one false positive rate: {KNEE}"

RATES = (
    *(0.001, 0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.04),
    *(0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5),
)
"""False-alarm rates of the operating points of a score, as far as there are samples for them."""

Points = tuple[OperatingPoint, ...]
Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]
Tail = Callable[[Values, Values, Values], Values]
"""Thresholds (r,) that leave at most the shares (r,) above them, of values (n,) that weigh (n,)."""


def best_point(points: Sequence[OperatingPoint], alpha: float | None = None) -> OperatingPoint:
    """The knee, of the largest true minus false positive rate, or the most power of at most a false-alarm rate."""
    if alpha is not None:
        return most_powerful(points, alpha)
    return max(points, key=lambda one: one.power - one.false_alarm)


@dataclass(frozen=True, slots=True)
class Gate(Rows):
    """What a gate of several classes is asked about, n samples, signs and others.

    `distance` (n, classes): rows with nan are never accepted. `on` (n,): whether a sample is a sign. `count` (n,): how
    many samples it stands for. `group` (n,): number of its drive, or stretch of road. `own` (n, classes): whether it is
    a sign of the class; None where labels do not tell the classes apart.
    """

    distance: Values
    on: Flags
    count: Counts
    group: Counts
    own: Flags | None = None

    def rates(self, thresholds: Values) -> tuple[float, float]:
        """False and true positive rate (eq. 10.2, 10.1) where what is within any threshold (classes,) is accepted."""
        accepted, total = (self.distance <= thresholds).any(axis=1), self.count.sum()
        signs = self.count[self.on].sum()
        true, every = self.count[accepted & self.on].sum(), self.count[accepted].sum()
        return float((every - true) / (total - signs)), float(true / signs)

    def points(self) -> Points:
        """At most `MOST_POINTS` operating points, by rising rates: from nothing to every sign."""
        thresholds = self._radii() if self.own is None else self._levels(self.own)
        some = np.linspace(0, len(thresholds) - 1, min(len(thresholds), 4 * MOST_POINTS))
        thresholds = thresholds[some.astype(int)]
        rates = np.array([self.rates(row) for row in thresholds])
        order = np.lexsort((rates[:, 1], rates[:, 0]))
        order = order[_spread(rates[order])]
        return tuple(
            OperatingPoint(float(rates[i, 0]), float(rates[i, 1]), tuple(thresholds[i].tolist()))
            for i in order
        )

    def _radii(self) -> Values:
        """Thresholds (m, classes) of components of one class, by the slopes of their hulls."""
        distance, on = self.distance, self.on
        known = np.asarray(np.isfinite(distance).all(axis=1))
        share = self.count / np.where(on, self.count[on].sum(), self.count[~on].sum())
        nearest = np.asarray(np.where(known[:, None], distance, np.inf).argmin(axis=1))
        steps: list[tuple[float, int, float]] = []
        for j in range(distance.shape[1]):
            own = np.asarray(known & (nearest == j))
            steps += [(slope, j, at) for slope, at in _hull(distance[own, j], on[own], share[own])]
        steps.sort(key=lambda one: -one[0])
        thresholds = np.zeros((len(steps) + 1, distance.shape[1]))
        for row, (_, j, reach) in enumerate(steps, 1):
            thresholds[row] = thresholds[row - 1]
            # of steps of one slope, rounding may sort the farther before the nearer
            thresholds[row, j] = max(thresholds[row - 1, j], reach)
        return thresholds

    def _levels(self, own: Flags) -> Values:
        """Thresholds (m, classes) at which all classes have one false positive rate.

        A class without a sign gets the distance within which that share of the others is.
        """
        levels = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 4 * MOST_POINTS)])
        thresholds = np.zeros((len(levels), own.shape[1]))
        others, weight = self.distance[~self.on], self.count[~self.on]
        for j in range(own.shape[1]):
            order = np.argsort(others[:, j])
            reach, accepted = others[order, j], np.cumsum(weight[order]) / weight.sum()
            signs = np.sort(self.distance[own[:, j], j])
            signs = signs[np.isfinite(signs)]
            rows = np.searchsorted(accepted, levels, side="right")
            if len(signs) == 0:
                thresholds[:, j] = np.append(0.0, reach)[rows]
                continue
            # the farthest sign before more others than the level come in
            nearer = np.searchsorted(signs, np.append(reach, np.inf)[rows], side="left")
            thresholds[:, j] = np.where(nearer > 0, signs[nearer - 1], 0.0)
        return np.unique(thresholds, axis=0)


def with_learned_thresholds(
    model: GaussianModel, samples: ClassifierSamples, *, one_knee: bool = False
) -> GaussianModel:
    """The model with the thresholds of its knees, their 95 % intervals, and its operating points.

    A class without a sign keeps its threshold, and its rule. With `one_knee`, classes that labels tell apart get the
    operating point of the gate with the largest true minus false positive rate. One without a sign gets the false
    positive rate of the others. Intervals resample drives, or the stretches of a single one. Raises InputError where
    there is no sign among the samples, or nothing else.
    """
    own = samples.known()
    on, group = own.label == ON, resampled_groups(own.drive, own.frame)[0]
    distance = class_distances(own.values, model)
    if not on.any() or on.all():
        raise _one_sided(samples, on)
    of_class = on[:, None] & (own.kind[:, None] == np.array([one.name for one in model.classes]))
    labelled = bool((own.kind != NO_CLASS).any())
    gate = Gate(distance, on, own.count, group, of_class if labelled else None)
    if not labelled or one_knee:
        several = GATE_RULE if labelled else JOINT_RULE
        return with_joint_thresholds(model, gate, several if len(model.classes) > 1 else KNEE_RULE)
    classes = []
    for j, one in enumerate(model.classes):
        rows = ~on | of_class[:, j]
        curve = RocCurve(distance[rows, j], on[rows], own.count[rows], group[rows], True)
        if curve.two_sided:
            one = replace(
                one,
                threshold=max(0.0, float(curve.threshold[curve.knee])),
                threshold_rule=KNEE_RULE,
                threshold_interval=curve.bands.knee,
            )
        classes.append(one)
    return replace(model, classes=tuple(classes), curve=gate.points())


def with_joint_thresholds(
    model: GaussianModel, gate: Gate, rule: str, alpha: float | None = None, draws: int = DRAWS
) -> GaussianModel:
    """The model with thresholds of all classes together, their 95 % intervals, their rule and all operating points.

    The knee, or the point of at most `alpha` false alarms. The intervals are percentiles over `draws` resamplings of
    the groups, and absent where there is only one.
    """
    points = gate.points()
    chosen = np.array(best_point(points, alpha).thresholds)
    groups, member = np.unique(gate.group, return_inverse=True)
    drawn = []
    for drawn_groups in resamplings(len(groups), draws) if len(groups) > 1 else ():
        weight = drawn_groups[member]
        part = replace(gate, count=gate.count * weight).select(weight > 0)
        if part.on.any() and not part.on.all():
            drawn.append(best_point(part.points(), alpha).thresholds)
    intervals: list[tuple[float, float] | None] = [None] * len(model.classes)
    if drawn:
        low, high = np.quantile(drawn, TAILS, axis=0)
        ends = np.minimum(low, chosen).tolist(), np.maximum(high, chosen).tolist()
        intervals = list(zip(*ends, strict=True))
    classes = tuple(
        replace(one, threshold=threshold, threshold_rule=rule, threshold_interval=interval)
        for one, threshold, interval in zip(model.classes, chosen.tolist(), intervals, strict=True)
    )
    return replace(model, classes=classes, curve=points)


def with_score_threshold(model: MixtureModel, samples: ClassifierSamples) -> MixtureModel:
    """The density with the threshold at the knee of its ROC, the interval of that, and its operating points.

    `samples`: of labelled drives that it was not learned from; what has no mean log density (-inf) is never accepted.
    Raises InputError where there is no sign among them, or nothing else.
    """
    own = samples.known()
    value, on = own.values[:, 0], own.label == ON
    group = resampled_groups(own.drive, own.frame)[0]
    curve = RocCurve(value, on, own.count, group, accept_below=False)
    if not curve.two_sided:
        raise _one_sided(samples, on)
    known, rates = np.isfinite(value), rates_of(curve.negatives)
    return replace(
        model,
        threshold=float(curve.threshold[curve.knee]),
        threshold_rule=(
            f"{KNEE_RULE}; {curve.tpr[curve.knee]:.3f} of {curve.positives} tracks of signs and "
            f"{curve.fpr[curve.knee]:.3f} of {curve.negatives} others"
        ),
        threshold_interval=curve.bands.knee,
        curve=score_points(value[known], on[known], group[known], counted_tail, rates),
    )


def _one_sided(samples: ClassifierSamples, on: Flags) -> InputError:
    return InputError(
        f"thresholds of {samples.classifier}: signs and other things are needed, and there are {int(on.sum())} signs "
        f"among {len(on)} samples. Label more images."
    )


def _hull(distance: Values, on: Flags, share: Values) -> list[tuple[float, float]]:
    """Steps of a component's curve from sign to sign: the slope of the upper convex hull there, and the distance.

    The hull of a ROC curve is the isotonic regression of signs on distance (Fawcett and Niculescu-Mizil 2007).
    """
    if not on.any():
        return []
    order = np.argsort(distance, kind="stable")
    reach, kind, part = distance[order], on[order], share[order]
    last = np.append(reach[1:] > reach[:-1], True)  # equal distances are accepted together
    others = np.append(0.0, np.cumsum(np.where(kind, 0.0, part))[last])
    signs = np.append(0.0, np.cumsum(np.where(kind, part, 0.0))[last])
    at = np.flatnonzero(np.diff(signs) > 0) + 1
    rise, run = (np.diff(one[np.append(0, at)]) for one in (signs, others))
    both = rise + run
    blocks = isotonic_regression(rise / both, weights=both, increasing=False).blocks
    rise, run = (np.add.reduceat(one, blocks[:-1]) for one in (rise, run))
    slope = np.repeat(rise / np.maximum(run, 1e-12), np.diff(blocks))
    return list(zip(slope.tolist(), reach[last][at - 1].tolist(), strict=True))


def _spread(rates: Values) -> NDArray[np.int64]:
    """Rows of at most `MOST_POINTS` points: both ends, the knee, and others evenly along the curve."""
    steps = np.hypot(*np.diff(np.sqrt(rates), axis=0).T)  # small rates are spread out
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0, along[-1], MOST_POINTS - 1)
    rows = np.searchsorted(along, wanted).clip(0, len(rates) - 1)
    return np.unique(np.append(rows, np.argmax(rates[:, 1] - rates[:, 0])))


def normal_tail(values: Values, weight: Values, rates: Values) -> Values:
    """By a normal density fitted to the values, as in the report: the largest are too few to count."""
    mean = np.average(values, weights=weight)
    variance = np.average((values - mean) ** 2, weights=weight)
    with np.errstate(invalid="ignore"):  # nan where all values are one
        return np.asarray(norm.ppf(1 - rates, mean, np.sqrt(variance)))


def counted_tail(values: Values, weight: Values, rates: Values) -> Values:
    """By counting, half-way between the last value above and the first that is one too many."""
    order = np.argsort(-values, kind="stable")
    falling, share = values[order], np.cumsum(weight[order]) / weight.sum()
    excess = falling[np.searchsorted(share, rates, side="right").clip(max=len(falling) - 1)]
    above = np.searchsorted(-falling, -excess, side="left")  # how many are larger
    halfway = (excess + falling[above - 1]) / 2
    return np.asarray(np.where(above > 0, halfway, np.nextafter(excess, np.inf)), np.float64)


def rates_of(others: int) -> list[float]:
    """The `RATES` that so many samples of what is no sign can tell: one of them at least is above the threshold."""
    return [rate for rate in RATES if rate * others >= 1]


def score_points(
    score: Values, on: Flags, group: NDArray[np.int64], tail: Tail, rates: Iterable[float]
) -> Points:
    """Operating points of a gate that accepts scores (n,) from a threshold on, by rising false-alarm rate.

    `score`: held out, if the gate was learned. `on` (n,): whether it is a sign; there are both. `group` (n,): drive or
    stretch of road; intervals are percentiles over resamplings of these, and absent where there is only one. `tail`:
    how a threshold follows from the scores of what is no sign. `rates`: shares of what is no sign that are accepted.
    """
    others = score[~on]
    wanted = np.array(sorted(rates))
    threshold = tail(others, np.ones(len(others)), wanted)
    power = (score[on][:, None] >= threshold).mean(axis=0)
    groups, member = np.unique(group[~on], return_inverse=True)
    intervals: list[tuple[tuple[float, float], ...]] = [()] * len(wanted)
    if len(groups) > 1:
        weights = resamplings(len(groups)).astype(np.float64)
        drawn = np.array([tail(others, weight[member], wanted) for weight in weights])
        drawn = drawn[np.isfinite(drawn).all(axis=1)]  # no density is fitted to one value
        if len(drawn):
            low, high = np.quantile(drawn, TAILS, axis=0)
            intervals = [(ends,) for ends in zip(low.tolist(), high.tolist(), strict=True)]
    rows = zip(wanted.tolist(), power.tolist(), threshold.tolist(), intervals, strict=True)
    return tuple(OperatingPoint(rate, found, (at,), ends) for rate, found, at, ends in rows)
