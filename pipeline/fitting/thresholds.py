"""Thresholds of all classes of a gate together, for the knee or a stated false-alarm rate, with their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.roc.operating import component_points
from wayside.pipeline.statistics import CONFIDENCE
from wayside.schemas.models import GaussianModel, OperatingPoint

KNEE_WORDS = (
    "knee of the ROC of all classes together: largest true minus false positive rate (report chapter 10), on held-out "
    "distances"
)
RESAMPLINGS = 50
"""Resamplings behind the interval of a threshold."""


def gate_thresholds(
    distance: NDArray[np.float64],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
    alpha: float | None,
) -> tuple[NDArray[np.float64], tuple[OperatingPoint, ...]]:
    """Thresholds (classes,) of a gate, and its operating points.

    Every class gets the threshold of one likelihood ratio (lemma of Neyman and Pearson, report chapter 9): at the
    largest true minus false positive rate of the gate, or the most true positives of at most the false-alarm rate.

    Parameters
    ----------
    distance
        From each class, (n, classes), finite.
    on, count
        Whether a sample is a sign, (n,), and how many it stands for, (n,). There are signs and others.
    alpha
        The false-alarm rate; None: the knee.
    """
    points = component_points(distance, on, count)
    allowed = [one for one in points if alpha is None or one.false_alarm <= alpha]
    cost = 1.0 if alpha is None else 0.0
    best = max(allowed, key=lambda one: one.power - cost * one.false_alarm)
    return np.array(best.thresholds), points


def with_gate_thresholds(
    model: GaussianModel,
    distance: NDArray[np.float64],
    on: NDArray[np.bool_],
    count: NDArray[np.int64],
    stretch: NDArray[np.int64],
    alpha: float | None,
    seed: int,
) -> GaussianModel:
    """The model with the thresholds of `gate_thresholds`, their 95 % intervals, the rule and all operating points.

    The intervals are percentiles over resamplings of the stretches (n,).
    """
    chosen, points = gate_thresholds(distance, on, count, alpha)
    groups, member = np.unique(stretch, return_inverse=True)
    random = np.random.default_rng(seed)
    drawn = []
    for _ in range(RESAMPLINGS):
        weight = random.multinomial(len(groups), np.full(len(groups), 1 / len(groups)))[member]
        kept = weight > 0
        if (on & kept).any() and (~on & kept).any():
            counted = (count * weight)[kept]
            drawn.append(gate_thresholds(distance[kept], on[kept], counted, alpha)[0])
    tails = [50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)]
    low, high = np.percentile(drawn, tails, axis=0) if drawn else (chosen, chosen)
    words = KNEE_WORDS if alpha is None else f"alpha {alpha:g}: {ALPHA_WORDS}"
    classes = tuple(
        replace(
            one,
            threshold=float(chosen[j]),
            threshold_rule=words,
            threshold_interval=(float(min(low[j], chosen[j])), float(max(high[j], chosen[j]))),
        )
        for j, one in enumerate(model.classes)
    )
    return replace(model, classes=classes, curve=points)


ALPHA_WORDS = (
    "most true positives of all classes together of at most this false positive rate (report chapter 9), on held-out "
    "distances"
)
