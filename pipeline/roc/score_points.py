"""Thresholds of a gate with one score: for each false-alarm rate the one that it asks for, and its power there.

By the lemma of Neyman and Pearson (report chapter 9) a score that rises with the likelihood ratio has the most power of
all tests of a false-alarm rate where it accepts what is above one threshold: that which leaves this share of what is no
sign above it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from wayside.pipeline.statistics import CONFIDENCE
from wayside.schemas.models import OperatingPoint

RATES = (
    *(0.001, 0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.04),
    *(0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5),
)
"""False-alarm rates of the operating points that a model file holds, as far as there are samples for them."""

DRAWS = 400
"""Resamplings behind the interval of a threshold: an end of it then rests on ten."""

Values = NDArray[np.float64]
Tail = Callable[[Values, Values, Values], Values]
"""Thresholds (r,) that leave at most the shares (r,) above them, of values (n,) that weigh (n,)."""


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
    """The `RATES` that so many samples of what is no sign can tell: one of them at least is above the threshold."""
    return [rate for rate in RATES if rate * others >= 1]


def score_points(
    score: Values,
    on: NDArray[np.bool_],
    group: NDArray[np.int64],
    tail: Tail,
    rates: Iterable[float],
    seed: int = 1,
) -> tuple[OperatingPoint, ...]:
    """Operating points of a gate that accepts scores from a threshold on, by rising false-alarm rate.

    Parameters
    ----------
    score
        Of signs and of others, (n,); held out, if the gate was learned.
    on, group
        Whether it is a sign, (n,), there are both; number of the drive or stretch of road that it is from, (n,):
        intervals are percentiles over resamplings of these, and absent where there is only one.
    tail
        How a threshold follows from the scores of what is no sign.
    rates
        Shares of what is no sign that the points accept.
    seed
        Of the resampling: same scores, same intervals.
    """
    others = score[~on]
    wanted = np.array(sorted(rates))
    threshold = tail(others, np.ones(len(others)), wanted)
    power = (score[on][:, None] >= threshold).mean(axis=0)
    groups, member = np.unique(group[~on], return_inverse=True)
    intervals: list[tuple[tuple[float, float], ...]] = [()] * len(wanted)
    if len(groups) > 1:
        draw = np.random.default_rng(seed)
        weights = draw.multinomial(len(groups), np.full(len(groups), 1 / len(groups)), DRAWS)
        drawn = np.array([tail(others, w[member].astype(np.float64), wanted) for w in weights])
        drawn = drawn[np.isfinite(drawn).all(axis=1)]  # no density is fitted to one value
        if len(drawn):
            low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
            intervals = [(ends,) for ends in zip(low.tolist(), high.tolist(), strict=True)]
    rows = zip(wanted.tolist(), power.tolist(), threshold.tolist(), intervals, strict=True)
    return tuple(OperatingPoint(rate, found, (at,), ends) for rate, found, at, ends in rows)
