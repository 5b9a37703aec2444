"""Models of Gaussian classes fitted to a user's samples: classes of enough signs, thresholds by a rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fitting.gaussians import FittedClass, Floor, Samples, fit_classes
from wayside.pipeline.fitting.thresholds import with_gate_thresholds
from wayside.pipeline.fitting.validation import (
    BEYOND,
    SEED,
    VIEWS,
    Fit,
    Held,
    Resampled,
    counts_of,
    exceeds,
    held_out_distances,
    held_out_log_density,
    score_held_out,
)
from wayside.pipeline.learning.gaussians import COLOR_FLOOR
from wayside.schemas.detections import COLORS
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings.fitting import FitSettings
from wayside.stages.classifiers import nearest_class
from wayside.stages.report import COLOR_SPACES, color_features

DRAWS = 420
"""Values drawn from a shipped class that is kept."""


@dataclass(frozen=True, slots=True)
class Rates:
    """Shares: of the signs that are accepted, and by name; of the rest that is accepted; `gain` as of `Held`."""

    accepted: float
    named: float
    false_rate: float
    gain: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FittedModel:
    """A model and what it rests on.

    held: of its own classes on what was held out; kept: shipped classes in it; lacking: signs of each class that had
    too few, by name; prior_signs: what the pooled covariance counted as; compared: other spaces, and how these did;
    shipped: how the shipped model decides on the same samples as `held`; fitted: this one, kept classes included, on
    all samples (not held out).
    """

    model: GaussianModel
    held: Held
    kept: tuple[str, ...]
    lacking: dict[str, int]
    prior_signs: float
    compared: dict[str, Held]
    shipped: Rates
    fitted: Rates

    @property
    def better(self) -> bool:
        """Whether held-out signs and the rest are told apart, and better than by the shipped model.

        By more than one standard error of the difference.
        """
        told_apart = exceeds(self.held.gain, np.zeros_like(self.held.gain))
        return told_apart and exceeds(self.held.gain, self.shipped.gain)


@dataclass(frozen=True, slots=True)
class Task:
    """What is common to the models of a fit.

    settings; alpha: false-alarm rate wanted of a gate, None: the knee; only_labelled: leave out classes of too few
    signs instead of keeping their shipped form; provenance: what a model file says of its origin.
    """

    settings: FitSettings
    alpha: float | None
    only_labelled: bool
    provenance: str


def fit_colors(
    samples: Samples, shipped: GaussianModel, task: Task, space: str | None
) -> FittedModel:
    """Colour classes in the given space; without one, in that which does best on held-out stretches.

    RGB, the report's space, stays where no other accepts more signs by name for its false alarms by more than one
    standard error of the difference.

    Parameters
    ----------
    samples
        Mean colours of regions, RGB.
    shipped
        Classes that stand in for those of too few signs, in RGB.
    task, space
        As above; of `COLOR_SPACES`, or None.

    Raises
    ------
    InputError
        Not one class has enough signs, or too little is known to be no sign.
    """
    names = enough(samples, COLORS, "colour", task.settings)
    tried: dict[str, tuple[float, Held]] = {}
    for one in [space] if space else COLOR_SPACES:
        values = samples.with_values(color_features(samples.values, one))
        tried[one] = _validated(values, names, color_floor(one), task)
    chosen = space or _best_space({name: held for name, (_, held) in tried.items()})
    in_space = samples.with_values(color_features(samples.values, chosen))
    model, kept = _model(in_space, names, COLORS, shipped, chosen, tried[chosen][0], task)
    return FittedModel(
        model,
        tried[chosen][1],
        kept,
        _lacking(samples, COLORS, names),
        tried[chosen][0],
        {name: other for name, (_, other) in tried.items() if name != chosen},
        rates_of(shipped, _asked(samples, names), COLORS, task.settings.resamplings),
        rates_of(model, in_space, COLORS, task.settings.resamplings),
    )


def fit_classes_of(
    samples: Samples,
    known: tuple[str, ...],
    what: str,
    floor: Floor,
    shipped: GaussianModel,
    task: Task,
) -> FittedModel:
    """Classes among `known` in the space of the shipped model; parameters and errors are those of `fit_colors`."""
    names = enough(samples, known, what, task.settings)
    prior, held = _validated(samples, names, floor, task)
    model, kept = _model(samples, names, known, shipped, shipped.space, prior, task, floor)
    return FittedModel(
        model,
        held,
        kept,
        _lacking(samples, known, names),
        prior,
        {},
        rates_of(shipped, _asked(samples, names), known, task.settings.resamplings),
        rates_of(model, samples, known, task.settings.resamplings),
    )


def rates_of(
    model: GaussianModel, samples: Samples, names: tuple[str, ...], resamplings: int
) -> Rates:
    """How a model decides on samples in its space."""
    code, _, accepted = nearest_class(samples.values, model, names)
    others = np.asarray(samples.kind == "")
    rate = Resampled(samples, resamplings).rate
    named = rate(accepted & (np.array(names)[code] == samples.kind), ~others)
    false = rate(accepted, others)
    known = float(rate(accepted, ~others)[0])
    return Rates(known, float(named[0]), float(false[0]), (named - false)[1:])


def enough(
    samples: Samples, known: Sequence[str], what: str, settings: FitSettings
) -> tuple[str, ...]:
    """The classes that can be fitted and held out: enough signs, in two folds at least.

    Raises
    ------
    InputError
        There is none, or too little is known to be no sign.
    """
    others = int((samples.kind == "").sum())
    if others < settings.fewest_others:
        raise InputError(
            f"wanted {settings.fewest_others} samples of what is no sign, found {others}; mark images as "
            "complete (--complete: every sign of the labelled images is labelled), or label what is no sign"
        )
    counts = {name: samples.signs(name) for name in known}
    names = tuple(
        name
        for name in known
        if counts[name] >= settings.fewest_signs
        and len(np.unique(samples.fold[samples.kind == name])) > 1
    )
    if not names:
        found = ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "none"
        raise InputError(
            f"wanted {settings.fewest_signs} labelled signs of a {what}, in two stretches of road or more, "
            f"found {found}; label more"
        )
    return names


def color_floor(space: str) -> Floor:
    """The smallest scatter of a colour class in RGB, carried over into a space at the mean."""
    random = np.random.default_rng(SEED)
    steps = random.normal(0, COLOR_FLOOR, (DRAWS, 3))
    grid = np.stack(np.meshgrid(*[np.arange(0, 256, 15.0)] * 3), axis=-1).reshape(-1, 3)
    features = color_features(grid, space)

    def floor(mean: NDArray[np.float64]) -> NDArray[np.float64]:
        if space == "rgb":
            return np.array(COLOR_FLOOR)
        near = grid[((features - mean) ** 2 / features.var(axis=0)).sum(axis=1).argmin()]
        around = color_features(np.clip(near + steps, 0, 255), space)
        return np.asarray(around.std(axis=0), np.float64)

    return floor


def _validated(
    samples: Samples, names: Sequence[str], floor: Floor, task: Task
) -> tuple[float, Held]:
    """The strength of the prior that does best on held-out folds, and how the classes do there with it."""

    def fit(prior: float) -> Fit:
        return lambda part: fit_classes(part, names, floor, prior)

    own = samples.select(np.isin(samples.kind, names))
    choices = task.settings.prior_signs
    prior = choices[int(np.argmax([held_out_log_density(own, fit(one)) for one in choices]))]
    asked = _asked(samples, names)
    distance = held_out_distances(asked, names, fit(prior))
    return prior, score_held_out(asked, names, distance, task.alpha, task.settings.resamplings)


def _model(
    samples: Samples,
    names: Sequence[str],
    known: tuple[str, ...],
    shipped: GaussianModel,
    space: str,
    prior: float,
    task: Task,
    floor: Floor | None = None,
) -> tuple[GaussianModel, tuple[str, ...]]:
    """The classes of all samples and the shipped ones that are kept, with thresholds by held-out distances.

    A kept class has no labels, or few: values drawn from its density stand in for one sign more (Laplace's rule of
    succession).
    """
    scatter = floor or color_floor(space)

    def fit(part: Samples) -> tuple[FittedClass, ...]:
        return fit_classes(part, names, scatter, prior)

    drawn = {
        one.name: _drawn(one, space)
        for one in shipped.classes
        if one.name not in names and not task.only_labelled
    }
    own = [GaussianClass(c.name, c.mean, c.covariance, 0.0, "", c.views) for c in fit(samples)]
    counted = {one.name: one.count for one in shipped.classes}
    own += [
        GaussianClass(name, values.mean(axis=0), np.cov(values.T), 0.0, "", counted[name])
        for name, values in drawn.items()
    ]
    model = GaussianModel(
        space, tuple(sorted(own, key=lambda one: known.index(one.name))), task.provenance
    )
    # distances of the labelled to their own classes as held out, to the kept ones as they are
    ordered = [one.name for one in model.classes]
    distance = model.distances(samples.values)
    distance[:, [ordered.index(name) for name in names]] = held_out_distances(samples, names, fit)
    parts = [distance, *(model.distances(values) for values in drawn.values())]
    stand_in = len(drawn) * DRAWS
    on = np.concatenate([samples.kind != "", np.ones(stand_in, bool)])
    count = np.concatenate([counts_of(samples), np.full(stand_in, VIEWS // DRAWS)])
    group = np.concatenate([samples.stretch, np.arange(stand_in) % (samples.stretch.max() + 1)])
    every = np.minimum(np.concatenate(parts), BEYOND)
    learned = with_gate_thresholds(model, every, on, count, group, task.alpha, SEED)
    return learned, tuple(drawn)


def _drawn(one: GaussianClass, space: str) -> NDArray[np.float64]:
    """Values (n, d) drawn from a shipped class; colours in RGB, then carried over into the space."""
    random = np.random.default_rng(SEED)
    drawn = random.multivariate_normal(one.mean, one.covariance, DRAWS)
    return color_features(np.clip(drawn, 0, 255), space) if space in COLOR_SPACES else drawn


def _asked(samples: Samples, names: Sequence[str]) -> Samples:
    """Samples of these classes and of no sign."""
    return samples.select((samples.kind == "") | np.isin(samples.kind, names))


def _lacking(samples: Samples, known: Sequence[str], names: Sequence[str]) -> dict[str, int]:
    return {
        name: count for name in known if name not in names and (count := samples.signs(name)) > 0
    }


def _best_space(tried: dict[str, Held]) -> str:
    """The space of the largest gain; RGB where that is not larger than its own by a standard error."""
    gains = {name: float(np.nanmean(held.gain)) for name, held in tried.items()}
    best = max(gains, key=lambda name: gains[name])
    return best if exceeds(tried[best].gain, tried["rgb"].gain) else "rgb"
