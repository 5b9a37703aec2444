"""Held-out distances of samples, the thresholds that a rule finds on them, and how well these do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fitting.gaussians import FittedClass, Samples, distances_to, log_density
from wayside.pipeline.statistics import CONFIDENCE, Interval

SEED = 1
Fit = Callable[[Samples], tuple[FittedClass, ...]]
"""Classes by samples."""


@dataclass(frozen=True, slots=True)
class Curve:
    """True and false positive rate (k,) by threshold (k,), rising (report eq. 10.1 and 10.2)."""

    threshold: NDArray[np.float64]
    true_rate: NDArray[np.float64]
    false_rate: NDArray[np.float64]

    def area(self) -> float:
        """Area under the curve from (0, 0) to (1, 1)."""
        x = np.concatenate([[0.0], self.false_rate, [1.0]])
        y = np.concatenate([[0.0], self.true_rate, [1.0]])
        return float(np.trapezoid(y, x))


@dataclass(frozen=True, slots=True)
class Rule:
    """How a threshold is chosen: `alpha` None: the knee of the curve, else for that false alarm rate."""

    alpha: float | None = None

    @property
    def words(self) -> str:
        """Name of the rule, for the model file."""
        if self.alpha is None:
            return "knee of the ROC: largest true minus false positive rate (report chapter 10)"
        return f"Neyman-Pearson: most power at a false alarm rate of at most {self.alpha:g} (report chapter 9)"

    def threshold(self, curve: Curve) -> float:
        """The threshold on a curve, half-way to the next distance there; of several as good the smallest.

        -1, which nothing passes, where even the smallest distance has more false alarms than `alpha`.
        """
        allowed = self.alpha is None or curve.false_rate <= self.alpha
        cost = curve.false_rate if self.alpha is None else 0.0
        gain = np.where(allowed, curve.true_rate - cost, -np.inf)
        best = int(np.argmax(gain))
        if not np.isfinite(gain[best]):
            return -1.0
        following = curve.threshold[min(best + 1, len(curve.threshold) - 1)]
        return float((curve.threshold[best] + following) / 2)


class SortedDistances:
    """Distances of signs and of others to one class, in order: a curve for any weights of theirs.

    distance (n,): inf is never accepted; own (n,) bool: which are of the class; others (n,) bool: which are no signs.
    """

    def __init__(
        self, distance: NDArray[np.float64], own: NDArray[np.bool_], others: NDArray[np.bool_]
    ) -> None:
        rows = np.flatnonzero(own | others)
        self._order = rows[np.argsort(distance[rows], kind="stable")]
        self._own = own[self._order]
        ordered = distance[self._order]
        last = np.append(ordered[1:] != ordered[:-1], True) if len(ordered) else np.zeros(0, bool)
        self._last = np.flatnonzero(last & np.isfinite(ordered))
        self._threshold = ordered[self._last]

    def curve(self, weight: NDArray[np.float64]) -> Curve:
        """Rates at each distance, every sample by its weight (n,)."""
        if not len(self._last):
            return Curve(np.zeros(1), np.zeros(1), np.zeros(1))
        ordered = weight[self._order]
        true, false = (
            np.cumsum(part) / max(float(part.sum()), 1e-12)
            for part in (np.where(self._own, ordered, 0.0), np.where(self._own, 0.0, ordered))
        )
        return Curve(self._threshold, true[self._last], false[self._last])


def held_out_distances(samples: Samples, names: Sequence[str], fit: Fit) -> NDArray[np.float64]:
    """Distances (n, names) of each sample to the classes fitted without its fold; inf where that leaves none."""
    distance = np.full((len(samples), len(names)), np.inf)
    for fold in np.unique(samples.fold):
        own = samples.fold == fold
        distance[own] = distances_to(fit(samples.select(~own)), names, samples.values[own])
    return distance


def held_out_log_density(samples: Samples, fit: Fit) -> float:
    """Sum of the log densities of signs in their classes, fitted without their fold; a sign counts once."""
    weight, known, total = samples.weights(), samples.kind != "", 0.0
    for fold in np.unique(samples.fold):
        held = (samples.fold == fold) & known
        for one in fit(samples.select(samples.fold != fold)):
            own = held & (samples.kind == one.name)
            total += float(weight[own] @ log_density(one, samples.values[own]))
    return total


@dataclass(frozen=True, slots=True)
class ClassScore:
    """A class on what was held out.

    threshold: by the rule on all held-out distances, with its interval; curve: of the class, by distance; area and its
    interval; true_rate: share of its signs that are accepted under its name, at thresholds chosen without their fold;
    false_rate: share of what is no sign that its threshold accepts; own: views and signs.
    """

    name: str
    views: int
    signs: int
    threshold: float
    threshold_interval: Interval
    curve: Curve
    area: float
    area_interval: Interval
    true_rate: float
    true_interval: Interval
    false_rate: float
    false_interval: Interval


@dataclass(frozen=True, slots=True)
class Held:
    """All classes of a model on what was held out.

    classes; accepted: share of signs that some threshold accepts; named: share of them accepted under their own name;
    false_rate: share of the rest that some threshold accepts; others: how many those are; gain (resamplings,):
    `named` minus `false_rate`, in resamplings of the stretches; confusion: `true -> given` and views.
    """

    classes: tuple[ClassScore, ...]
    accepted: float
    named: float
    false_rate: float
    others: int
    gain: NDArray[np.float64]
    confusion: dict[str, int]


def score_held_out(
    samples: Samples,
    names: Sequence[str],
    distance: NDArray[np.float64],
    rule: Rule,
    resamplings: int,
) -> Held:
    """Thresholds and rates of the classes `names` from held-out distances (n, names).

    Intervals are percentiles over resamplings of the stretches, with all that is in them.
    """
    weight, others = samples.weights(), samples.kind == ""
    ordered = [
        SortedDistances(distance[:, j], samples.kind == name, others)
        for j, name in enumerate(names)
    ]
    limit = np.empty_like(distance)
    for fold in np.unique(samples.fold):
        rest = weight * (samples.fold != fold)
        limit[samples.fold == fold] = [rule.threshold(one.curve(rest)) for one in ordered]
    holds = distance <= limit
    any_holds = holds.any(axis=1)
    nearest = np.where(holds, distance, np.inf).argmin(axis=1)
    given = np.where(any_holds, np.array(names)[nearest], "")
    right = given == samples.kind
    draws = _draws(samples, resamplings)

    def rate(flags: NDArray[np.bool_], among: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The share of weight with a flag, in all samples and then in each resampling."""
        top, bottom = np.zeros(draws.shape[1]), np.zeros(draws.shape[1])
        np.add.at(top, samples.stretch[among & flags], weight[among & flags])
        np.add.at(bottom, samples.stretch[among], weight[among])
        with np.errstate(invalid="ignore"):
            return np.asarray((draws @ top) / (draws @ bottom))

    classes = []
    for j, name in enumerate(names):
        own = samples.kind == name
        limits, areas = [], []
        for draw in draws:
            drawn = ordered[j].curve(weight * draw[samples.stretch])
            limits.append(rule.threshold(drawn))
            areas.append(drawn.area())
        true, false = rate(right, own), rate(holds[:, j], others)
        score = ClassScore(
            name,
            int(own.sum()),
            samples.signs(name),
            limits[0],
            _interval(limits[1:]),
            ordered[j].curve(weight),
            areas[0],
            _interval(areas[1:]),
            float(true[0]),
            _interval(true[1:]),
            float(false[0]),
            _interval(false[1:]),
        )
        classes.append(score)
    named, false = rate(right, ~others), rate(any_holds, others)
    pairs = zip(samples.kind[~others], given[~others], strict=True)
    counted = Counter(f"{known} -> {name or 'refused'}" for known, name in pairs)
    return Held(
        tuple(classes),
        float(rate(any_holds, ~others)[0]),
        float(named[0]),
        float(false[0]),
        int(others.sum()),
        (named - false)[1:],
        dict(sorted(counted.items())),
    )


def _draws(samples: Samples, resamplings: int) -> NDArray[np.float64]:
    """How often each stretch (columns) is in a resampling (rows); the first row holds each once."""
    count = int(samples.stretch.max(initial=0)) + 1
    there = np.unique(samples.stretch)
    random = np.random.default_rng(SEED)
    draws = np.zeros((resamplings + 1, count))
    draws[0, there] = 1
    for row in draws[1:]:
        np.add.at(row, random.choice(there, len(there)), 1)
    return draws


def _interval(values: Sequence[float] | NDArray[np.float64]) -> Interval:
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.nanpercentile(np.asarray(values), [tail, 100 - tail])
    return Interval(float(low), float(high))
