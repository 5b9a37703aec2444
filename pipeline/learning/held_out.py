"""Distances of samples to classes fitted without them, and how well classes do by thresholds chosen without them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from wayside.pipeline.learning.curves import RocCurve, Scores, roc_curve
from wayside.pipeline.learning.gaussians import Samples
from wayside.pipeline.learning.thresholds import best_point, component_points
from wayside.pipeline.statistics import TAILS
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.classifiers import class_distances

SEED, RESAMPLINGS = 1, 400
"""Of the resampling of stretches: an end of a 95 % interval then rests on ten."""
BEYOND = 1e6
"""Distance to a class that there is not."""
VIEWS = 5040
"""Samples that a sign counts as: divided by its views it stays a whole number, mostly."""

Fit = Callable[[Samples], tuple[GaussianClass, ...]]
"""Classes by samples."""
Flags = NDArray[np.bool_]


class Share(NamedTuple):
    """A share, and both ends of its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Rates:
    """How a model decides on samples.

    `accepted`, `named`: shares of signs that are accepted, and under their own name. `false_rate`: share of the rest
    that is accepted. `gain` (resamplings,): `named` minus `false_rate` where stretches are resampled.
    """

    accepted: Share
    named: Share
    false_rate: Share
    gain: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ClassScore:
    """A class on what was held out.

    `views`, `signs`: of it. `curve`: by its distance alone, against what is no sign; None where every sign was in one
    fold. `named`: share of its signs accepted under its name.
    """

    name: str
    views: int
    signs: int
    curve: RocCurve | None
    named: Share


@dataclass(frozen=True, slots=True)
class Held(Rates):
    """All classes of a model on what was held out, with thresholds chosen without it.

    others: samples of what is no sign; confusion: views by `true -> given`.
    """

    classes: tuple[ClassScore, ...]
    others: int
    confusion: dict[str, int]


def distances_to(
    classes: Sequence[GaussianClass], names: Sequence[str], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mahalanobis distances (n, names) of values (n, d) (report eq. 3.1); `BEYOND` to a class that there is not."""
    distance = np.full((len(values), len(names)), BEYOND)
    columns = [names.index(c.name) for c in classes]
    found = class_distances(values, GaussianModel("", tuple(classes), ""))
    distance[:, columns] = np.minimum(found, BEYOND)
    return distance


def held_out_distances(samples: Samples, names: Sequence[str], fit: Fit) -> NDArray[np.float64]:
    """Distances (n, names) of each sample to the classes fitted without its fold."""
    distance = np.empty((len(samples), len(names)))
    for own in _folds(samples):
        distance[own] = distances_to(fit(samples.select(~own)), names, samples.values[own])
    return distance


def held_out_log_density(samples: Samples, fit: Fit) -> float:
    """Sum of the log densities of signs in their classes, fitted without their fold; a sign counts once."""
    weight, total = samples.weights(), 0.0
    for held in _folds(samples):
        for one in fit(samples.select(~held)):
            own = held & (samples.kind == one.name)
            if own.any():
                density = multivariate_normal(one.mean, one.covariance, allow_singular=True)
                total += float(weight[own] @ np.atleast_1d(density.logpdf(samples.values[own])))
    return total


def counts_of(samples: Samples) -> NDArray[np.int64]:
    """The weights of samples as counts (n,): `VIEWS` a sign."""
    return np.asarray(np.rint(VIEWS * samples.weights()), np.int64)


def score_held_out(
    samples: Samples, names: Sequence[str], distance: NDArray[np.float64], alpha: float | None
) -> Held:
    """Rates of the classes `names` by held-out distances (n, names). Each fold uses the thresholds of the others.

    Intervals are percentiles over resamplings of the stretches, with all that is in them.
    """
    others = np.asarray(samples.kind == "")
    count, limit = counts_of(samples), np.full_like(distance, -1.0)
    for held in _folds(samples):
        rest = ~held
        if (others & rest).any() and (~others & rest).any():
            points = component_points(distance[rest], ~others[rest], count[rest])
            limit[held] = best_point(points, alpha).thresholds
    holds = distance <= limit
    nearest = np.where(holds, distance, np.inf).argmin(axis=1)
    given = np.where(holds.any(axis=1), np.array(names)[nearest], "")
    resampled = Resampled(samples)
    classes = []
    for j, name in enumerate(names):
        own = np.asarray(samples.kind == name)
        asked = own | others
        scores = Scores(distance[asked, j], own[asked], count[asked], samples.stretch[asked], True)
        curve = roc_curve(scores) if (distance[own, j] < BEYOND).any() else None
        named = _share(resampled.rate(np.asarray(given == name), own))
        classes.append(ClassScore(name, int(own.sum()), samples.signs(name), curve, named))
    pairs = zip(samples.kind[~others], given[~others], strict=True)
    confusion = Counter(f"{known} -> {name or 'refused'}" for known, name in pairs)
    rates = resampled.rates(given)
    return Held(
        rates.accepted,
        rates.named,
        rates.false_rate,
        rates.gain,
        tuple(classes),
        int(others.sum()),
        dict(sorted(confusion.items())),
    )


class Resampled:
    """Shares in samples and in resamplings of their stretches, the same ones whatever is asked."""

    def __init__(self, samples: Samples) -> None:
        self._samples, self._weight = samples, samples.weights()
        there = np.unique(samples.stretch)
        random = np.random.default_rng(SEED)
        # how often each stretch (columns) is in a resampling (rows); the first row holds each once
        self._draws = np.zeros((RESAMPLINGS + 1, int(there.max(initial=0)) + 1))
        self._draws[0, there] = 1
        for row in self._draws[1:]:
            np.add.at(row, random.choice(there, len(there)), 1)

    def rates(self, given: NDArray[np.str_]) -> Rates:
        """The rates of a model that gives each sample a class, "" where it refuses."""
        signs, others = self._samples.kind != "", self._samples.kind == ""
        named = self.rate(given == self._samples.kind, signs)
        false = self.rate(given != "", others)
        accepted = _share(self.rate(given != "", signs))
        return Rates(accepted, _share(named), _share(false), (named - false)[1:])

    def rate(self, flags: Flags, among: Flags) -> NDArray[np.float64]:
        """The share of weight with a flag, in all samples and then in each resampling; nan where there is no weight."""
        top, bottom = np.zeros((2, self._draws.shape[1]))
        np.add.at(top, self._samples.stretch[among & flags], self._weight[among & flags])
        np.add.at(bottom, self._samples.stretch[among], self._weight[among])
        with np.errstate(invalid="ignore"):
            return np.asarray((self._draws @ top) / (self._draws @ bottom))


def exceeds(one: NDArray[np.float64], other: NDArray[np.float64] | float = 0.0) -> bool:
    """Whether one resampled gain is larger than another by more than a standard error of their difference."""
    difference = (one - other)[np.isfinite(one - other)]
    return bool(len(difference) and difference.mean() > difference.std())


def _folds(samples: Samples) -> Iterator[Flags]:
    """Which samples (n,) are held out, fold by fold."""
    for fold in np.unique(samples.fold):
        yield np.asarray(samples.fold == fold)


def _share(values: NDArray[np.float64]) -> Share:
    """The first value, with percentiles of the others; resamplings without such samples are left out."""
    known = values[1:][np.isfinite(values[1:])]
    low, high = np.quantile(known, TAILS).tolist() if len(known) else (0.0, 1.0)
    return Share(float(values[0]), low, high)
