"""Models fitted to a user's samples: Gaussian classes of enough signs, and the confidence; thresholds by a rule."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning import fits, thresholds
from wayside.pipeline.learning.labelled import Faces
from wayside.schemas.detections import COLORS
from wayside.schemas.errors import InputError
from wayside.schemas.models import EvidenceModel, GaussianClass, GaussianModel
from wayside.stages.classifiers import at_alpha, nearest_class
from wayside.stages.report import COLOR_SPACES, color_features

FEWEST_SIGNS = 5
"""Signs that a class needs: five found of five tell a true positive rate above 0.48 (Clopper and Pearson, 95 %)."""
FEWEST_OTHERS = 50
"""Samples of what is no sign: a rate of 0.05, about the smallest that is of use, of fewer is that of two samples."""
FEWEST_LANDMARKS = 10
"""Landmarks of signs, and of others: ten a coefficient, of which the confidence has two (Peduzzi et al. 1996)."""
CLASS_WORDS = {"color": "colour", "shape": "shape", "location": "side of the road"}
"""Name of a class of each gate."""
PRIOR_SIGNS = (1.0, 3.0, 10.0, 30.0)
"""Signs that the pooled covariance counts as, from few to more than 50 images have; the best held out is taken."""
DRAWS = 420
"""Values drawn from a shipped class that is kept."""

Asked = tuple[fits.Samples, fits.Floor]
"""Samples in a space, and the smallest scatter of a class there."""


@dataclass(frozen=True, slots=True)
class FittedModel:
    """A model and its evidence.

    `held`: of its own classes on what was held out. `kept`: shipped classes in it. `lacking`: signs of each class that
    had too few, by name. `prior_signs`: what the pooled covariance counted as. `compared`: other spaces, and how these
    did. `shipped`: how the shipped model decides on the same samples as `held`. `fitted`: this one, kept classes
    included, on all samples (not held out).
    """

    model: GaussianModel
    held: fits.Held
    kept: tuple[str, ...]
    lacking: dict[str, int]
    prior_signs: float
    compared: dict[str, fits.Held]
    shipped: fits.Rates
    fitted: fits.Rates

    @property
    def better(self) -> bool:
        """Whether held-out signs and the rest are separated, and better than by the shipped model.

        By more than one standard error of the difference.
        """
        return fits.exceeds(self.held.gain) and fits.exceeds(self.held.gain, self.shipped.gain)


@dataclass(frozen=True, slots=True)
class FittedConfidence:
    """The landmark classifier with other log odds, slope * shipped + shift, and its evidence.

    `signs`, `others`: labelled landmarks. `before`, `after`: mean log loss (nats) of held-out landmarks with the
    shipped calibration and with one fitted without them. `brier_before`, `brier_after`: the same of the Brier score.
    """

    model: EvidenceModel
    slope: float
    shift: float
    signs: int
    others: int
    before: float
    after: float
    brier_before: float
    brier_after: float

    @property
    def better(self) -> bool:
        """Whether held-out landmarks are more likely with it."""
        return self.after < self.before


@dataclass(frozen=True, slots=True)
class Task:
    """Options common to the models of a fit.

    `alpha`: false-alarm rate wanted, None: of a gate that of the shipped one. `only_labelled`: leave out classes of too
    few signs instead of keeping their shipped form. `provenance`: what a model file says of its origin.
    """

    alpha: float | None
    only_labelled: bool
    provenance: str

    def rate(self, gate: str) -> float:
        """False-alarm rate of a gate."""
        return thresholds.GATE_RATES[gate] if self.alpha is None else self.alpha


def fit_colors(
    samples: fits.Samples, shipped: GaussianModel, task: Task, space: str
) -> FittedModel:
    """Colour classes by mean colours of regions, RGB; in a space, or (`auto`) that which does best when held out.

    RGB, the report's space, stays where no other accepts more signs by name for its false alarms by more than one
    standard error. The shipped classes are in RGB. Takes and raises the same as `fit_gaussians`.
    """
    tried = {
        one: (replace(samples, values=color_features(samples.values, one)), color_floor(one))
        for one in (COLOR_SPACES if space == "auto" else [space])
    }
    return fit_gaussians(samples, tried, COLORS, "color", shipped, task)


def fit_gaussians(
    samples: fits.Samples,
    spaces: Mapping[str, Asked],
    known: tuple[str, ...],
    gate: str,
    shipped: GaussianModel,
    task: Task,
) -> FittedModel:
    """The classes among `known` that have enough signs, in the space that does best on what is held out.

    `samples`: in the space of the shipped model. `spaces`: the same in each space that is tried; the first stays where
    no other is better by more than one standard error. `gate`: its name. `shipped`: classes that stand in for those of
    too few signs. Raises InputError where not one class has enough signs, or too little is known to be no sign.
    """
    names, alpha = enough(samples, known, CLASS_WORDS[gate]), task.rate(gate)
    tried = {one: _validated(*asked, names, alpha) for one, asked in spaces.items()}
    first = next(iter(tried))
    chosen = max(tried, key=lambda one: float(np.nanmean(tried[one][1].gain)))
    if not fits.exceeds(tried[chosen][1].gain, tried[first][1].gain):
        chosen = first
    prior, held = tried[chosen]
    kept = () if task.only_labelled else [c for c in shipped.classes if c.name not in names]
    fit = _fit(spaces[chosen][1], names, prior, chosen, [_carried(one, chosen) for one in kept])
    asked = spaces[chosen][0]
    every = [one.name for one in fit(asked).classes]
    score = fits.held_out(asked, every, fit)[1].max(axis=1)
    gated = thresholds.with_threshold(fit(asked), score, asked.kind != "", asked.stretch, alpha)
    model = replace(gated, provenance=task.provenance)
    counts = {name: samples.signs(name) for name in known if name not in names}
    return FittedModel(
        model,
        held,
        tuple(one.name for one in kept),
        {name: count for name, count in counts.items() if count},
        prior,
        {name: other for name, (_, other) in tried.items() if name != chosen},
        model_rates(shipped, _asked(samples, names), known),
        model_rates(model, spaces[chosen][0], known),
    )


def model_rates(model: GaussianModel, samples: fits.Samples, names: tuple[str, ...]) -> fits.Rates:
    """How a model decides on samples in its space."""
    code, _, ratio = nearest_class(samples.values, model, names)
    given = np.where(ratio >= model.threshold, np.array(names)[code], "")
    return fits.Resampled(samples).rates(given)


def enough(samples: fits.Samples, known: Sequence[str], what: str) -> tuple[str, ...]:
    """The classes that can be fitted and held out: enough signs, in two folds at least; InputError without one."""
    others = int((samples.kind == "").sum())
    if others < FEWEST_OTHERS:
        raise InputError(_FEW_OTHERS.format(others))
    counts = {name: samples.signs(name) for name in known}
    names = tuple(
        name
        for name in known
        if counts[name] >= FEWEST_SIGNS and len(np.unique(samples.fold[samples.kind == name])) > 1
    )
    if not names:
        raise InputError(_few_signs(FEWEST_SIGNS, what, counts))
    return names


def too_few_labels(faces: Sequence[Faces], what: str) -> str:
    """Why the labels are too few for the model `what`, whatever the images show; "" if they may suffice."""
    if not any(one.complete or one.others for one in faces):
        return _FEW_OTHERS.format(0)
    found: set[tuple[str, int]] = set()
    for one in faces:
        names = (
            getattr(one, what) if what in ("color", "shape") else np.full(len(one.sign), "in all")
        )
        known = (names != "") & (one.example | (names == "in all"))
        found.update(zip(names[known].tolist(), one.sign[known].tolist(), strict=True))
    counts = Counter(name for name, _ in sorted(found))
    fewest = FEWEST_LANDMARKS if what == "confidence" else FEWEST_SIGNS
    few = max(counts.values(), default=0) < fewest
    return _few_signs(fewest, CLASS_WORDS.get(what, "landmark"), counts) if few else ""


_FEW_OTHERS = (
    f"{FEWEST_OTHERS} samples that are not signs are needed, and there are {{}}. Mark images as complete (--complete: "
    "all signs in the labelled images are labelled), or label what is not a sign."
)


def _few_signs(fewest: int, what: str, counts: Mapping[str, int]) -> str:
    found = ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "none"
    needed = f"{fewest} labelled signs of a {what} are needed"
    return f"{needed}, from two stretches of road or more, and there are {found}. Label more."


def color_floor(space: str) -> fits.Floor:
    """The smallest scatter of a colour class in RGB, carried over into a space at the mean."""
    if space == "rgb":
        return lambda mean: np.array(fits.COLOR_FLOOR)
    steps = np.random.default_rng(fits.SEED).normal(0, fits.COLOR_FLOOR, (DRAWS, 3))
    grid = np.stack(np.meshgrid(*[np.arange(0, 256, 15.0)] * 3), axis=-1).reshape(-1, 3)
    features = color_features(grid, space)

    def floor(mean: NDArray[np.float64]) -> NDArray[np.float64]:
        near = grid[((features - mean) ** 2 / features.var(axis=0)).sum(axis=1).argmin()]
        around = color_features(np.clip(near + steps, 0, 255), space)
        return np.asarray(around.std(axis=0), np.float64)

    return floor


def _validated(
    samples: fits.Samples, floor: fits.Floor, names: Sequence[str], alpha: float
) -> tuple[float, fits.Held]:
    """The best strength of the prior on held-out folds, and the results of the classes there."""
    tried = {
        one: partial(fits.fit_classes, names=names, floor=floor, prior_signs=one)
        for one in PRIOR_SIGNS
    }
    own = samples.select(np.isin(samples.kind, names))
    # rounded: where there is one class alone, all do the same
    prior = max(tried, key=lambda one: round(fits.held_out_log_density(own, tried[one]), 6))
    asked = _asked(samples, names)
    found = fits.held_out(asked, names, _fit(floor, names, prior))
    return prior, fits.score_held_out(asked, names, *found, alpha)


def _fit(
    floor: fits.Floor,
    names: Sequence[str],
    prior: float,
    space: str = "",
    kept: Sequence[GaussianClass] = (),
) -> fits.Fit:
    """How a model of classes, some that are kept, and of the background is fitted to samples."""

    def fit(samples: fits.Samples) -> GaussianModel:
        classes = (*fits.fit_classes(samples, names, floor, prior), *kept)
        background = fits.fit_background(samples.values[samples.kind == ""], floor)
        return GaussianModel(space, classes, "", background)

    return fit


def _carried(one: GaussianClass, space: str) -> GaussianClass:
    """A shipped class in a space, of the weight of one sample; colours are drawn from it in RGB and carried over."""
    one = replace(one, count=1)
    if space not in COLOR_SPACES:
        return one
    drawn = np.random.default_rng(fits.SEED).multivariate_normal(one.mean, one.covariance, DRAWS)
    values = color_features(np.clip(drawn, 0, 255), space)
    return replace(one, mean=values.mean(axis=0), covariance=np.cov(values.T))


def _asked(samples: fits.Samples, names: Sequence[str]) -> fits.Samples:
    """Samples of these classes and of no sign."""
    return samples.select((samples.kind == "") | np.isin(samples.kind, names))


def fit_confidence(samples: fits.Samples, shipped: EvidenceModel, task: Task) -> FittedConfidence:
    """Fit slope and shift of the log odds (n, 1) of labelled landmarks, held out fold by fold (Platt 1999).

    The model decides where a sign is as likely as anything else, or at a false-alarm rate. Its operating points are
    computed from the held-out log odds. Raises InputError where landmarks of signs, or of others, are too few, for the
    false-alarm rate too, or all of one fold.
    """
    score, on = samples.values[:, 0], np.asarray(samples.kind != "")
    signs, others, folds = int(on.sum()), int((~on).sum()), np.unique(samples.fold)
    if min(signs, others) < FEWEST_LANDMARKS or len(folds) < 2:
        raise InputError(
            f"{FEWEST_LANDMARKS} landmarks of labelled signs and as many others are needed, from two stretches or "
            f"more. There are {signs} and {others} from {len(folds)}. Label more."
        )
    held = np.empty(len(score))
    for fold in folds:
        own = samples.fold == fold
        slope, shift = fits.calibrated(score[~own], on[~own])
        held[own] = slope * score[own] + shift
    slope, shift = fits.calibrated(score, on)
    model = replace(
        shipped,
        curves=tuple(slope * curve for curve in shipped.curves),
        shift=slope * shipped.shift + shift,
        threshold=shipped.threshold - shipped.decision,
        provenance=f"{task.provenance}; log odds {slope:.3f} x + {shift:.3f} of: {shipped.provenance}",
        decision=0.0,
        threshold_rule="log odds of 0: as likely a sign as anything else, by labelled landmarks (Platt 1999)",
        threshold_interval=None,
        curve=thresholds.score_points(
            held, on, samples.stretch, thresholds.normal_tail, thresholds.rates_of(others)
        ),
    )
    if task.alpha is not None:
        try:
            model = at_alpha(model, task.alpha)
        except ValueError as error:
            raise InputError(
                f"{error}. {others} landmarks that are not signs allow no smaller rate. Label more."
            ) from error
    losses = (loss(one, on) for loss in (fits.log_loss, fits.brier_score) for one in (score, held))
    return FittedConfidence(model, slope, shift, signs, others, *losses)
