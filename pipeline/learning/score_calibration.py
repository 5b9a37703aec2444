"""Calibration of scores (Platt 1999): a logistic regression, with normal priors where labels are few."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

Values = NDArray[np.float64]


def platt(scores: NDArray[np.floating[Any]], positive: NDArray[np.bool_]) -> tuple[Values, float]:
    """Slopes (k,) and shift that make one log odds of k scores (n, k), by Platt's softened targets."""
    count, rest = positive.sum(), (~positive).sum()
    target = np.where(positive, (count + 1) / (count + 2), 1 / (rest + 2))
    start = np.append(np.full(scores.shape[1], 1 / scores.shape[1]), 0.0)
    found = _logistic(np.asarray(scores, np.float64), target, start, np.zeros(len(start)))
    return found[:-1], float(found[-1])


SLOPE_SIGMA = 0.5
"""Scatter of the slope before any label is seen: of the shipped classifier, drive by drive, it is less."""
SHIFT_SIGMA = 2.0
"""Scatter of the shift, log odds: a factor of seven in the share of signs among what is asked about."""


def calibrated(score: Values, on: NDArray[np.bool_]) -> tuple[float, float]:
    """Slope and shift of log odds (n,) of the largest posterior probability: logistic likelihood, normal priors.

    Before any label is seen the slope is 1 and the shift 0.
    """
    precision = np.array([SLOPE_SIGMA, SHIFT_SIGMA]) ** -2.0
    slope, shift = _logistic(score[:, None], on.astype(np.float64), np.array([1.0, 0]), precision)
    return float(slope), float(shift)


def _logistic(scores: Values, target: Values, expected: Values, precision: Values) -> Values:
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
