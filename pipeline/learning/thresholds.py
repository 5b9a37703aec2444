"""Thresholds at a stated false-alarm rate, and operating points at other rates (report chapter 9).

A gate accepts a score from a threshold on. A score that rises with the likelihood ratio has, by the lemma of Neyman and
Pearson, the most power of all tests of a false-alarm rate. Its threshold leaves this share of everything that is not a
sign above it, however many others there are.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from wayside.pipeline.statistics import TAILS, resamplings
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianModel, MixtureModel, OperatingPoint
from wayside.stages.classifiers import at_alpha

RATES = (
    *(0.001, 0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.04),
    *(0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5),
)
"""False-alarm rates of the operating points of a score, as far as there are samples for them."""

GATE_RATES = {"color": 0.3, "shape": 0.3, "trajectory": 0.3, "location": 0.2}
"""False-alarm rate of each gate as shipped, a share of what is no sign and reaches it.

Of the pairs of colour and location that lose no precision at their recall on learning drives, the one that finds most.
"""

Points = tuple[OperatingPoint, ...]
Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Numbers = NDArray[np.int64]
Tail = Callable[[Values, Values, Values], Values]
"""Thresholds (r,) that leave at most the shares (r,) above them, of values (n,) that weigh (n,)."""
Gate = TypeVar("Gate", GaussianModel, MixtureModel)


def with_threshold(model: Gate, score: Values, on: Flags, group: Numbers, alpha: float) -> Gate:
    """The model with its operating points, and the threshold of a false-alarm rate with its 95 % interval.

    Takes the same as `score_points`; what has no finite score is never accepted. Raises InputError for one kind alone.
    """
    known = np.isfinite(score)
    score, on, group = score[known], on[known], group[known]
    if not on.any() or on.all():
        raise InputError(
            f"threshold: signs and other things are needed, and there are {int(on.sum())} signs among {len(on)} "
            "samples. Label more images."
        )
    return at_alpha(replace(model, curve=gate_points(score, on, group, alpha)), alpha)


def gate_points(score: Values, on: Flags, group: Numbers, alpha: float) -> Points:
    """The operating points of a counted gate, one of them at a false-alarm rate."""
    return score_points(score, on, group, counted_tail, {*rates_of(int((~on).sum())), alpha})


def normal_tail(values: Values, weight: Values, rates: Values) -> Values:
    """By a normal density fitted to the values, as in the report: the largest are too few to count."""
    mean = np.average(values, weights=weight)
    variance = np.average((values - mean) ** 2, weights=weight)
    with np.errstate(invalid="ignore"):  # nan where all values are one
        return np.asarray(norm.ppf(1 - rates, mean, np.sqrt(variance)))


def counted_tail(values: Values, weight: Values, rates: Values) -> Values:
    """By counting, half-way between the last value above and the first that is one too many."""
    order = np.argsort(-values, kind="stable")
    falling, share = values[order], np.cumsum(weight[order]) / weight.sum()
    excess = falling[np.searchsorted(share, rates, side="right").clip(max=len(falling) - 1)]
    above = np.searchsorted(-falling, -excess, side="left")  # how many are larger
    halfway = (excess + falling[above - 1]) / 2
    return np.asarray(np.where(above > 0, halfway, np.nextafter(excess, np.inf)), np.float64)


def rates_of(others: int) -> list[float]:
    """The `RATES` that a number of samples allows: at least one of them must be above the threshold."""
    return [rate for rate in RATES if rate * others >= 1]


def score_points(
    score: Values, on: Flags, group: Numbers, tail: Tail, rates: Iterable[float]
) -> Points:
    """Operating points of a gate that accepts scores (n,) from a threshold on, by rising false-alarm rate.

    `score`: held out, if the gate was learned. `on` (n,): whether it is a sign; there are both. `group` (n,): drive or
    stretch of road; intervals are percentiles over resamplings of these, and absent where there is only one. `tail`:
    how a threshold follows from the scores of what is no sign. `rates`: shares of what is no sign that are accepted.
    """
    order = np.argsort(-score, kind="stable")  # what is in order is sorted fast in every draw
    score, on, group = score[order], on[order], group[order]
    others = score[~on]
    wanted = np.array(sorted(rates))
    threshold = tail(others, np.ones(len(others)), wanted)
    power = (score[on][:, None] >= threshold).mean(axis=0)
    groups, member = np.unique(group[~on], return_inverse=True)
    intervals: list[tuple[float, float] | None] = [None] * len(wanted)
    if len(groups) > 1:
        weights = resamplings(len(groups)).astype(np.float64)
        drawn = np.array([tail(others, weight[member], wanted) for weight in weights])
        drawn = drawn[np.isfinite(drawn).all(axis=1)]  # no density is fitted to one value
        if len(drawn):
            low, high = np.quantile(drawn, TAILS, axis=0)
            intervals = list(zip(low.tolist(), high.tolist(), strict=True))
    rows = zip(wanted.tolist(), power.tolist(), threshold.tolist(), intervals, strict=True)
    return tuple(OperatingPoint(*row) for row in rows)
