"""Calibration of the landmark classifier by a user's labelled landmarks (Platt 1999), shrunk to the shipped one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from wayside.pipeline.fitting.gaussians import Samples
from wayside.pipeline.roc.score_points import normal_tail, rates_of, score_points
from wayside.schemas.errors import InputError
from wayside.schemas.models import EvidenceModel
from wayside.schemas.settings.fitting import FitSettings


@dataclass(frozen=True, slots=True)
class FittedConfidence:
    """The landmark classifier with other log odds, slope * shipped + shift, and what it rests on.

    signs, others: labelled landmarks; before, after: mean log loss (nats) of held-out landmarks with the shipped
    calibration and with one fitted without them; brier_before, brier_after: their mean squared errors of probability.
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
        """Whether held-out landmarks are the likelier for it."""
        return self.after < self.before


def fit_confidence(
    samples: Samples,
    shipped: EvidenceModel,
    settings: FitSettings,
    provenance: str,
    alpha: float | None = None,
) -> FittedConfidence:
    """Fit slope and shift of the log odds (n, 1) of labelled landmarks, held out fold by fold.

    The model decides where a sign is as likely as anything else, or at a false-alarm rate; its operating points are
    those of the held-out log odds.

    Raises
    ------
    InputError
        There are too few landmarks of signs, or of others, for the false-alarm rate too, or all are of one fold.
    """
    score, on = samples.values[:, 0], samples.kind != ""
    signs, others = int(on.sum()), int((~on).sum())
    if min(signs, others) < settings.fewest_landmarks or len(np.unique(samples.fold)) < 2:
        raise InputError(
            f"wanted {settings.fewest_landmarks} landmarks of labelled signs and of what is no sign, "
            f"in two stretches or more, found {signs} and {others} in {len(np.unique(samples.fold))}; label more"
        )
    held = np.empty(len(score))
    for fold in np.unique(samples.fold):
        own = samples.fold == fold
        slope, shift = calibrated(score[~own], on[~own], settings)
        held[own] = slope * score[own] + shift
    slope, shift = calibrated(score, on, settings)
    points = score_points(held, on, samples.stretch, normal_tail, rates_of(others))
    model = replace(
        shipped,
        curves=tuple(slope * curve for curve in shipped.curves),
        shift=slope * shipped.shift + shift,
        threshold=shipped.threshold - shipped.decision,
        provenance=f"{provenance}; log odds {slope:.3f} x + {shift:.3f} of: {shipped.provenance}",
        decision=0.0,
        threshold_rule="log odds of 0: as likely a sign as anything else, by labelled landmarks (Platt 1999)",
        threshold_interval=None,
        curve=points,
    )
    if alpha is not None:
        try:
            model = model.at_alpha(alpha)
        except ValueError as error:
            raise InputError(
                f"{error}; {others} landmarks that are no sign tell no smaller one: label more"
            ) from error
    return FittedConfidence(
        model,
        slope,
        shift,
        signs,
        others,
        log_loss(score, on),
        log_loss(held, on),
        brier_score(score, on),
        brier_score(held, on),
    )


def calibrated(
    score: NDArray[np.float64], on: NDArray[np.bool_], settings: FitSettings
) -> tuple[float, float]:
    """Slope and shift of log odds (n,) of the largest posterior probability: logistic likelihood, normal priors."""
    columns = np.stack([score, np.ones(len(score))], axis=1)
    expected = np.array([1.0, 0.0])
    precision = np.array([settings.slope_sigma, settings.shift_sigma]) ** -2.0

    def cost(found: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        odds, gap = columns @ found, found - expected
        value = len(on) * log_loss(odds, on) if len(on) else 0.0
        return value + 0.5 * float(precision @ gap**2), columns.T @ (
            expit(odds) - on
        ) + precision * gap

    slope, shift = minimize(cost, expected, jac=True, method="BFGS", options={"gtol": 1e-7}).x
    return float(slope), float(shift)


def log_loss(score: NDArray[np.float64], on: NDArray[np.bool_]) -> float:
    """Mean negative log probability of what landmarks are, by their log odds (n,)."""
    return float(np.logaddexp(0, np.where(on, -score, score)).mean())


def brier_score(score: NDArray[np.float64], on: NDArray[np.bool_]) -> float:
    """Mean squared error of the probabilities of log odds (n,)."""
    return float(((expit(score) - on) ** 2).mean())
