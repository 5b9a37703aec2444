"""Held-out distances of samples, and how well classes do there with thresholds that were chosen without them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fitting.gaussians import FittedClass, Samples, distances_to, log_density
from wayside.pipeline.fitting.thresholds import gate_thresholds
from wayside.pipeline.roc.curves import RocCurve, Scores, roc_curve
from wayside.pipeline.statistics import CONFIDENCE, Interval

SEED = 1
BEYOND = 1e6
"""Distance to a class that there is not."""
VIEWS = 5040
"""Samples that a sign counts as: divided by its views it stays a whole number, mostly."""

Fit = Callable[[Samples], tuple[FittedClass, ...]]
"""Classes by samples."""


@dataclass(frozen=True, slots=True)
class ClassScore:
    """A class on what was held out.

    views, signs: of it; curve: by its distance alone, against what is no sign; None where every sign was in one fold.
    named: share of its signs accepted under its name, with its interval.
    """

    name: str
    views: int
    signs: int
    curve: RocCurve | None
    named: float
    named_interval: Interval


@dataclass(frozen=True, slots=True)
class Held:
    """All classes of a model on what was held out, with thresholds chosen without it.

    accepted, named: shares of signs that are accepted, and under their own name; false_rate: share of the rest that is
    accepted, each with its interval; others: how many those are; gain (resamplings,): `named` minus `false_rate` where
    stretches are resampled; confusion: views by `true -> given`.
    """

    classes: tuple[ClassScore, ...]
    accepted: float
    accepted_interval: Interval
    named: float
    named_interval: Interval
    false_rate: float
    false_interval: Interval
    others: int
    gain: NDArray[np.float64]
    confusion: dict[str, int]


def held_out_distances(samples: Samples, names: Sequence[str], fit: Fit) -> NDArray[np.float64]:
    """Distances (n, names) of each sample to the classes fitted without its fold; `BEYOND` where that leaves none."""
    distance = np.full((len(samples), len(names)), BEYOND)
    for fold in np.unique(samples.fold):
        own = samples.fold == fold
        classes = fit(samples.select(~own))
        distance[own] = np.minimum(distances_to(classes, names, samples.values[own]), BEYOND)
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


def counts_of(samples: Samples) -> NDArray[np.int64]:
    """The weights of samples as counts (n,): `VIEWS` a sign."""
    return np.asarray(np.rint(VIEWS * samples.weights()), np.int64)


def score_held_out(
    samples: Samples,
    names: Sequence[str],
    distance: NDArray[np.float64],
    alpha: float | None,
    resamplings: int,
) -> Held:
    """Rates of the classes `names` by held-out distances (n, names); the thresholds of a fold are those of the others.

    Intervals are percentiles over resamplings of the stretches, with all that is in them.
    """
    others = np.asarray(samples.kind == "")
    count, limit = counts_of(samples), np.full_like(distance, -1.0)
    for fold in np.unique(samples.fold):
        rest = samples.fold != fold
        if (others & rest).any() and (~others & rest).any():
            chosen, _ = gate_thresholds(distance[rest], ~others[rest], count[rest], alpha)
            limit[~rest] = chosen
    holds = distance <= limit
    any_holds = np.asarray(holds.any(axis=1))
    nearest = np.where(holds, distance, np.inf).argmin(axis=1)
    given = np.where(any_holds, np.array(names)[nearest], "")
    right = np.asarray(given == samples.kind)
    rate = Resampled(samples, resamplings).rate
    classes = []
    for j, name in enumerate(names):
        own = np.asarray(samples.kind == name)
        asked = own | others
        scores = Scores(
            distance[asked, j], own[asked], count[asked], samples.stretch[asked], accept_below=True
        )
        named = rate(right, own)
        classes.append(
            ClassScore(
                name,
                int(own.sum()),
                samples.signs(name),
                roc_curve(scores) if (distance[own, j] < BEYOND).any() else None,
                float(named[0]),
                _interval(named),
            )
        )
    accepted, named, false = (
        rate(any_holds, ~others),
        rate(right, ~others),
        rate(any_holds, others),
    )
    pairs = zip(samples.kind[~others], given[~others], strict=True)
    confusion = Counter(f"{known} -> {name or 'refused'}" for known, name in pairs)
    return Held(
        tuple(classes),
        float(accepted[0]),
        _interval(accepted),
        float(named[0]),
        _interval(named),
        float(false[0]),
        _interval(false),
        int(others.sum()),
        (named - false)[1:],
        dict(sorted(confusion.items())),
    )


class Resampled:
    """Shares in samples and in resamplings of their stretches, the same ones whatever is asked."""

    def __init__(self, samples: Samples, resamplings: int) -> None:
        self._stretch, self._weight = samples.stretch, samples.weights()
        self._draws = _draws(samples, resamplings)

    def rate(self, flags: NDArray[np.bool_], among: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The share of weight with a flag, in all samples and then in each resampling; nan where there is no weight."""
        top, bottom = np.zeros((2, self._draws.shape[1]))
        np.add.at(top, self._stretch[among & flags], self._weight[among & flags])
        np.add.at(bottom, self._stretch[among], self._weight[among])
        with np.errstate(invalid="ignore"):
            return np.asarray((self._draws @ top) / (self._draws @ bottom))


def exceeds(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether one resampled gain is larger than the other by more than a standard error of their difference."""
    difference = (one - other)[np.isfinite(one - other)]
    return bool(len(difference) and difference.mean() > difference.std())


def _draws(samples: Samples, resamplings: int) -> NDArray[np.float64]:
    """How often each stretch (columns) is in a resampling (rows); the first row holds each once."""
    there = np.unique(samples.stretch)
    random = np.random.default_rng(SEED)
    draws = np.zeros((resamplings + 1, int(there.max(initial=0)) + 1))
    draws[0, there] = 1
    for row in draws[1:]:
        np.add.at(row, random.choice(there, len(there)), 1)
    return draws


def _interval(values: NDArray[np.float64]) -> Interval:
    """Percentiles of all values but the first, those of resamplings without such samples left out."""
    known = values[1:][np.isfinite(values[1:])]
    if not len(known):
        return Interval(0.0, 1.0)
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.percentile(known, [tail, 100 - tail])
    return Interval(float(low), float(high))
