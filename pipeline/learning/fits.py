"""What is fitted to few samples: Gaussian classes, the calibration of scores; and how it does on what is held out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import multivariate_normal

from wayside.pipeline.learning.asked import Rows
from wayside.pipeline.learning.curves import RocCurve
from wayside.pipeline.learning.thresholds import Gate, best_point
from wayside.pipeline.statistics import TAILS, resamplings
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.classifiers import class_distances

Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Floor = Callable[[Values], Values]
"""Smallest scatter (d,) of a class of mean (d,): less is an accident of few signs."""

COLOR_FLOOR = (6.0, 6.0, 6.0)
SHAPE_FLOOR = 0.01
PLACE_FLOOR = (2.0, 0.8)

SIDES = ("right", "left", "overhead")
"""Classes of a location model: right and left of the path, and above the road."""

SEED = 1
BEYOND = 1e6
"""Distance to a class that there is not."""
VIEWS = 5040
"""Samples that a sign counts as: divided by its views it stays a whole number, mostly."""
SLOPE_SIGMA = 0.5
"""Scatter of the slope before any label is seen: of the shipped classifier, drive by drive, it is less."""
SHIFT_SIGMA = 2.0
"""Scatter of the shift, log odds: a factor of seven in the share of signs among what is asked about."""


@dataclass(frozen=True, slots=True)
class Samples(Rows):
    """What a classifier is asked about, n rows.

    `values` (n, d). `kind` (n,): class of the labelled sign, or "". `sign` (n,): number of the physical sign, or -1.
    `stretch` (n,): part of the road it is from. `fold` (n,): which of the parts held out together.
    """

    values: Values
    kind: NDArray[np.str_]
    sign: NDArray[np.int64]
    stretch: NDArray[np.int64]
    fold: NDArray[np.int64]

    def signs(self, name: str) -> int:
        """How many signs of a class there are."""
        return len(np.unique(self.sign[self.kind == name]))

    def weights(self) -> Values:
        """Weights (n,): the views of a sign have 1 together, whatever is no sign has 1."""
        weight = np.ones(len(self))
        own = self.kind != ""
        if own.any():
            _, which, count = np.unique(self.sign[own], return_inverse=True, return_counts=True)
            weight[own] = 1 / count[which]
        return weight


Fit = Callable[[Samples], tuple[GaussianClass, ...]]
"""Classes by samples."""


def fit_classes(
    samples: Samples, names: Sequence[str], floor: Floor, prior_signs: float
) -> tuple[GaussianClass, ...]:
    """Classes of those `names` that have samples, every sign of the same weight; thresholds are still to be chosen.

    The covariance is a weighted mean of the covariance of the class and of the pooled one of all classes about their
    means. The pooled one counts as `prior_signs` signs (the mean of an inverse Wishart prior; Friedman 1989 shrinks the
    same way). Its axes are no narrower than the floor. Rows without a class take no part.
    """
    weight, parts = samples.weights(), []
    for name in names:
        own = np.flatnonzero(samples.kind == name)
        if len(own):
            mean, covariance = _moments(samples.values[own], weight[own] / weight[own].sum())
            parts.append((name, mean, covariance, len(own), samples.signs(name)))
    if not parts:
        return ()
    pooled = sum(signs * own for *_, own, _, signs in parts) / sum(part[4] for part in parts)
    return tuple(
        GaussianClass(
            name,
            mean,
            _widened((signs * own + prior_signs * pooled) / (signs + prior_signs), floor(mean)),
            0.0,
            "",
            views,
        )
        for name, mean, own, views, signs in parts
    )


def sides(places: Values, overhead_m: float) -> NDArray[np.str_]:
    """Which of `SIDES` each place (n, 2), right and up in metres, is on; (n,)."""
    right, up = places.T
    return np.where(up > overhead_m, "overhead", np.where(right >= 0, "right", "left"))


def moments(values: Values, weight: Values, floor: Values) -> tuple[Values, Values]:
    """Weighted mean (d,) and covariance (d, d) of values (n, d); no axis is narrower than its `floor` (d,)."""
    mean, covariance = _moments(values, weight)
    return mean, _widened(covariance, floor)


def _moments(values: Values, weight: Values) -> tuple[Values, Values]:
    mean = weight @ values
    gap = values - mean
    return mean, (gap * weight[:, None]).T @ gap


def _widened(covariance: Values, floor: Values) -> Values:
    lacking = np.maximum(floor**2 - np.diag(covariance), 0.0)
    return np.asarray(covariance + np.diag(lacking) + np.diag((0.1 * floor) ** 2))


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
    gain: Values


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


def distances_to(classes: Sequence[GaussianClass], names: Sequence[str], values: Values) -> Values:
    """Mahalanobis distances (n, names) of values (n, d) (report eq. 3.1); `BEYOND` to a class that there is not."""
    distance = np.full((len(values), len(names)), BEYOND)
    columns = [names.index(c.name) for c in classes]
    found = class_distances(values, GaussianModel("", tuple(classes), ""))
    distance[:, columns] = np.minimum(found, BEYOND)
    return distance


def held_out_distances(samples: Samples, names: Sequence[str], fit: Fit) -> Values:
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
    samples: Samples, names: Sequence[str], distance: Values, alpha: float | None
) -> Held:
    """Rates of the classes `names` by held-out distances (n, names). Each fold uses the thresholds of the others.

    Intervals are percentiles over resamplings of the stretches, with all that is in them.
    """
    others = np.asarray(samples.kind == "")
    count, limit = counts_of(samples), np.full_like(distance, -1.0)
    gate = Gate(distance, ~others, count, samples.stretch)
    for held in _folds(samples):
        rest = ~held
        if (others & rest).any() and (~others & rest).any():
            limit[held] = best_point(gate.select(rest).points(), alpha).thresholds
    holds = distance <= limit
    nearest = np.where(holds, distance, np.inf).argmin(axis=1)
    given = np.where(holds.any(axis=1), np.array(names)[nearest], "")
    resampled = Resampled(samples)
    classes = []
    for j, name in enumerate(names):
        own = np.asarray(samples.kind == name)
        asked = own | others
        curve = RocCurve(distance[asked, j], own[asked], count[asked], samples.stretch[asked], True)
        known = curve if curve.two_sided and (distance[own, j] < BEYOND).any() else None
        named = _share(resampled.rate(np.asarray(given == name), own))
        classes.append(ClassScore(name, int(own.sum()), samples.signs(name), known, named))
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
        stretches, self._stretch = np.unique(samples.stretch, return_inverse=True)
        drawn = resamplings(len(stretches), seed=SEED)
        self._draws = np.vstack([np.ones_like(drawn[:1]), drawn])  # first each stretch once

    def rates(self, given: NDArray[np.str_]) -> Rates:
        """The rates of a model that gives each sample a class, "" where it refuses."""
        signs, others = self._samples.kind != "", self._samples.kind == ""
        named = self.rate(given == self._samples.kind, signs)
        false = self.rate(given != "", others)
        accepted = _share(self.rate(given != "", signs))
        return Rates(accepted, _share(named), _share(false), (named - false)[1:])

    def rate(self, flags: Flags, among: Flags) -> Values:
        """The share of weight with a flag, in all samples and then in each resampling; nan where there is no weight."""
        k = self._draws.shape[1]
        top, bottom = (
            self._draws @ np.bincount(self._stretch[rows], self._weight[rows], k)
            for rows in (among & flags, among)
        )
        with np.errstate(invalid="ignore"):
            return np.asarray(top / bottom)


def exceeds(one: Values, other: Values | float = 0.0) -> bool:
    """Whether one resampled gain is larger than another by more than a standard error of their difference."""
    difference = (one - other)[np.isfinite(one - other)]
    return bool(len(difference) and difference.mean() > difference.std())


def _folds(samples: Samples) -> Iterator[Flags]:
    """Which samples (n,) are held out, fold by fold."""
    for fold in np.unique(samples.fold):
        yield np.asarray(samples.fold == fold)


def _share(values: Values) -> Share:
    """The first value, with percentiles of the others; resamplings without such samples are left out."""
    known = values[1:][np.isfinite(values[1:])]
    low, high = np.quantile(known, TAILS).tolist() if len(known) else (0.0, 1.0)
    return Share(float(values[0]), low, high)


def calibrated(score: Values, on: NDArray[np.bool_]) -> tuple[float, float]:
    """Slope and shift of log odds (n,) of the largest posterior probability: logistic likelihood, normal priors.

    Before any label is seen the slope is 1 and the shift 0.
    """
    precision = np.array([SLOPE_SIGMA, SHIFT_SIGMA]) ** -2.0
    slope, shift = logistic(score[:, None], on.astype(np.float64), np.array([1.0, 0]), precision)
    return float(slope), float(shift)


def logistic(scores: Values, target: Values, expected: Values, precision: Values) -> Values:
    """Slopes and shift (k + 1,) of scores (n, k) for probabilities (n,), near what is expected by its precision."""
    columns = np.concatenate([scores, np.ones((len(scores), 1))], axis=1)

    def cost(found: Values) -> tuple[float, Values]:
        odds, gap = columns @ found, found - expected
        loss = np.logaddexp(0, odds).sum() - target @ odds + precision @ gap**2 / 2
        return float(loss), columns.T @ (expit(odds) - target) + precision * gap

    found = minimize(cost, expected, jac=True, method="BFGS", options={"gtol": 1e-7})
    return np.asarray(found.x, np.float64)


def log_loss(score: Values, on: NDArray[np.bool_]) -> float:
    """Mean negative log probability of what landmarks are, by their log odds (n,)."""
    return float(np.logaddexp(0, np.where(on, -score, score)).mean())


def brier_score(score: Values, on: NDArray[np.bool_]) -> float:
    """Mean squared error of the probabilities of log odds (n,)."""
    return float(((expit(score) - on) ** 2).mean())


def platt(scores: NDArray[np.floating[Any]], positive: NDArray[np.bool_]) -> tuple[Values, float]:
    """Slopes (k,) and shift that make one log odds of k scores (n, k), by Platt's softened targets."""
    count, rest = positive.sum(), (~positive).sum()
    target = np.where(positive, (count + 1) / (count + 2), 1 / (rest + 2))
    start = np.append(np.full(scores.shape[1], 1 / scores.shape[1]), 0.0)
    found = logistic(np.asarray(scores, np.float64), target, start, np.zeros(len(start)))
    return found[:-1], float(found[-1])
