"""Fits to few samples: Gaussian classes and the calibration of scores; and their quality on held-out samples."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from wayside.pipeline.learning.curves import RocCurve
from wayside.pipeline.learning.thresholds import Flags, Values, gate_points
from wayside.pipeline.statistics import TAILS, resamplings
from wayside.schemas.detections import Rows
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.classifiers import class_distances, log_normals, log_ratios, most_powerful

Floor = Callable[[Values], Values]
"""Smallest scatter (d,) of a class of mean (d,): less is an accident of few signs."""

COLOR_FLOOR = (6.0, 6.0, 6.0)
SHAPE_FLOOR = 0.01
PLACE_FLOOR = (2.0, 0.8)

SIDES = ("right", "left", "overhead")
"""Classes of a location model: right and left of the path, and above the road."""

SEED = 1
BEYOND = 1e6
"""Distance to a class that does not exist, and minus its log-likelihood ratio."""
COMPONENTS, STEPS = 8, 60
"""Components of a background at most, and steps of its fit."""
EXAMPLES = (200, 40_000)
"""Samples that a component of a background needs, and that a background takes at most."""
VIEWS = 5040
"""Samples that a sign counts as: divided by its views it stays a whole number, mostly."""
SLOPE_SIGMA = 0.5
"""Scatter of the slope before any label is seen: of the shipped classifier, drive by drive, it is less."""
SHIFT_SIGMA = 2.0
"""Scatter of the shift, log odds: a factor of seven in the share of signs among what is asked about."""


@dataclass(frozen=True, slots=True)
class Samples(Rows):
    """The samples of a classifier, n rows.

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


Fit = Callable[[Samples], GaussianModel]
"""A model by samples."""


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
            views,
        )
        for name, mean, own, views, signs in parts
    )


def fit_background(values: Values, floor: Floor) -> tuple[GaussianClass, ...]:
    """Density of what is no sign (n, d): Gaussians by expectation maximisation (Dempster, Laird and Rubin 1977).

    They start around samples drawn far from each other (k-means++), and their axes stay no narrower than the floor.
    """
    each, most = EXAMPLES
    values = values[np.isfinite(values).all(axis=1)]
    values = values[np.linspace(0, len(values) - 1, min(len(values), most)).astype(int)]
    draw, scale = np.random.default_rng(SEED), values.std(axis=0) + 1e-9
    first, square = draw.integers(len(values)), np.full(len(values), np.inf)
    seeds = [int(first)]
    for _ in range(min(COMPONENTS, len(values) // each) - 1):
        gap = (values - values[seeds[-1]]) / scale
        square = np.minimum(square, (gap**2).sum(axis=1))
        seeds.append(int(draw.choice(len(values), p=square / square.sum())))
    gap = (values[:, None] - values[seeds]) / scale
    share = np.eye(len(seeds))[(gap**2).sum(axis=2).argmin(axis=1)]
    for _ in range(STEPS):
        weight = share.sum(axis=0)
        parts = []
        for own, total in zip(share.T, weight, strict=True):
            mean, covariance = _moments(values, own / total)
            parts.append(GaussianClass("", mean, _widened(covariance, floor(mean)), round(total)))
        density = log_normals(values, parts) + np.log(weight / weight.sum())
        share = np.exp(density - np.logaddexp.reduce(density, axis=1)[:, None])
        share = share[:, share.sum(axis=0) >= each / 10]
    return tuple(parts)


def sides(places: Values, overhead_m: float) -> NDArray[np.str_]:
    """Which of `SIDES` each place (n, 2), right and up in metres, is on; (n,)."""
    right, up = places.T
    return np.where(up > overhead_m, "overhead", np.where(right >= 0, "right", "left"))


def side_classes(places: Values, overhead_m: float, fewest: int) -> list[GaussianClass]:
    """Where signs stand, places (n, 2) right and up in metres, on those of `SIDES` that have so many signs or more."""
    side = sides(places, overhead_m)
    parts = ((name, places[side == name]) for name in SIDES)
    return [class_of(name, own, PLACE_FLOOR) for name, own in parts if len(own) >= fewest]


def class_of(name: str, values: Values, floor: Sequence[float]) -> GaussianClass:
    """The class of values (n, d), no narrower than the floor (d,)."""
    mean, covariance = _moments(values, np.full(len(values), 1 / len(values)))
    return GaussianClass(name, mean, _widened(covariance, np.array(floor)), len(values))


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
    """Results of a class on held-out samples.

    `views`, `signs`: of it. `curve`: by its likelihood ratio, against what is no sign; None where every sign was in one
    fold. `named`: share of its signs accepted under its name.
    """

    name: str
    views: int
    signs: int
    curve: RocCurve | None
    named: Share


@dataclass(frozen=True, slots=True)
class Held(Rates):
    """Results of all classes of a model on held-out samples, with a threshold chosen without them.

    `others`: samples of what is no sign; `confusion`: views by `true -> given`.
    """

    classes: tuple[ClassScore, ...]
    others: int
    confusion: dict[str, int]


def held_out(samples: Samples, names: Sequence[str], fit: Fit) -> tuple[Values, Values]:
    """Mahalanobis distances and log-likelihood ratios (n, names) of each sample by a model without its fold.

    To a class that the model lacks they are `BEYOND` and minus that.
    """
    distance = np.full((len(samples), len(names)), BEYOND)
    ratio = -distance
    for own in _folds(samples):
        model, values = fit(samples.select(~own)), samples.values[own]
        columns = np.array([names.index(one.name) for one in model.classes], np.int64)
        at = np.ix_(np.flatnonzero(own), columns)
        distance[at] = np.minimum(class_distances(values, model.classes), BEYOND)
        ratio[at] = np.maximum(log_ratios(values, model), -BEYOND)
    return distance, ratio


def held_out_log_density(
    samples: Samples, fit: Callable[[Samples], tuple[GaussianClass, ...]]
) -> float:
    """Sum of the log densities of signs in their classes, fitted without their fold; a sign counts once."""
    weight, total = samples.weights(), 0.0
    for held in _folds(samples):
        for one in fit(samples.select(~held)):
            own = held & (samples.kind == one.name)
            total += float(weight[own] @ log_normals(samples.values[own], [one])[:, 0])
    return total


def score_held_out(
    samples: Samples, names: Sequence[str], distance: Values, ratio: Values, alpha: float
) -> Held:
    """Rates of the classes `names`, from the result of `held_out`. Each fold uses the threshold of the others.

    Intervals are percentiles over resamplings of the stretches, with all that is in them.
    """
    others = np.asarray(samples.kind == "")
    count = np.asarray(np.rint(VIEWS * samples.weights()), np.int64)
    score, limit = ratio.max(axis=1), np.full(len(samples), np.inf)
    for held in _folds(samples):
        rest = ~held
        if (others & rest).any() and (~others & rest).any():
            points = gate_points(score[rest], ~others[rest], np.zeros(rest.sum(), int), alpha)
            limit[held] = most_powerful(points, alpha).threshold
    given = np.where(score >= limit, np.array(names)[distance.argmin(axis=1)], "")
    resampled = Resampled(samples)
    classes = []
    for j, name in enumerate(names):
        own = np.asarray(samples.kind == name)
        asked = own | others
        curve = RocCurve(ratio[asked, j], own[asked], count[asked], samples.stretch[asked], False)
        known = curve if curve.two_sided and (distance[own, j] < BEYOND).any() else None
        named = _share(resampled.rate(np.asarray(given == name), own))
        classes.append(ClassScore(name, int(own.sum()), samples.signs(name), known, named))
    pairs = zip(samples.kind[~others], given[~others], strict=True)
    confusion = Counter(f"{known} -> {name or 'refused'}" for known, name in pairs)
    rates = resampled.rates(given)
    shares = rates.accepted, rates.named, rates.false_rate, rates.gain
    counts = int(others.sum()), dict(sorted(confusion.items()))
    return Held(*shares, tuple(classes), *counts)


class Resampled:
    """Shares in samples and in resamplings of their stretches, always the same resamplings."""

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
    """Whether one resampled gain exceeds another by more than a standard error of their difference."""
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
    """Mean negative log probability of the true kind of landmarks, by their log odds (n,)."""
    return float(np.logaddexp(0, np.where(on, -score, score)).mean())


def brier_score(score: Values, on: NDArray[np.bool_]) -> float:
    """Mean squared error of the probabilities of log odds (n,)."""
    return float(((expit(score) - on) ** 2).mean())
