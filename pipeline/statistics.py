"""Small statistics of an evaluation: spreads, shares and rates, with the confidence intervals of what is counted."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, ndtri

CONFIDENCE = 0.95
"""Two-sided: half of the rest lies on each side."""


class Interval(NamedTuple):
    """Both ends of an interval, in the unit of what was estimated."""

    low: float
    high: float


def share_interval(count: int, total: int) -> Interval | None:
    """Where the share lies that `count` of `total` independent trials estimate; None of no trials.

    Wilson's score interval (J. Am. Stat. Assoc. 22, 1927, p. 209). For none and for all of them the exact one (Clopper
    and Pearson, Biometrika 26, 1934, p. 404), because Wilson's is too narrow there.
    """
    if total == 0:
        return None
    tail = (1 - CONFIDENCE) / 2
    if count == 0:
        return Interval(0.0, 1 - tail ** (1 / total))
    if count == total:
        return Interval(tail ** (1 / total), 1.0)
    share, z2 = count / total, float(ndtri(1 - tail)) ** 2 / total
    centre, half = share + z2 / 2, sqrt(z2 * (share * (1 - share) + z2 / 4))
    return Interval((centre - half) / (1 + z2), (centre + half) / (1 + z2))


TAILS = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)
"""Quantiles at both ends of an interval."""


def resamplings(groups: int, draws: int = 400, seed: int = 1) -> NDArray[np.int64]:
    """How often each group (drive, stretch of road) is in each resampling, (draws, groups).

    Samples of a group are alike, so whole groups are drawn, never single samples (Efron and Tibshirani 1993, chapter
    8). With 400 draws an end of a 95 % interval rests on ten.
    """
    return np.random.default_rng(seed).multinomial(groups, np.full(groups, 1 / groups), draws)


def resampled_interval(
    groups: int, value: Callable[[NDArray[np.int64]], float], draws: int = 400, seed: int = 1
) -> Interval | None:
    """Percentiles of a value over resamplings of groups (drives), the argument how often each counts; None of one."""
    if groups < 2:
        return None
    drawn = [value(count) for count in resamplings(groups, draws, seed)]
    return Interval(*np.quantile(drawn, TAILS).tolist())


def rate_interval(count: int, exposure: float) -> Interval | None:
    """Where the rate of events per unit of `exposure` lies that `count` of them estimate; None of no exposure.

    Exact for a Poisson count (Garwood, Biometrika 28, 1936, p. 437).
    """
    if exposure <= 0:
        return None
    tail = (1 - CONFIDENCE) / 2
    low = float(gammaincinv(count, tail)) if count else 0.0
    return Interval(low / exposure, float(gammaincinv(count + 1, 1 - tail)) / exposure)


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and 95th percentile of n values, None where there are none; rounded to four decimals."""

    n: int
    median: float | None
    p95: float | None


class SigmaShare(NamedTuple):
    """Fraction of n errors within one and two stated standard deviations (a normal error: 0.68 and 0.95)."""

    n: int
    one: float | None
    two: float | None


def spread(values: Iterable[float] | NDArray[np.float64]) -> Spread:
    """Median and 95th percentile (linear interpolation)."""
    array = np.asarray(list(values), np.float64)
    if not len(array):
        return Spread(0, None, None)
    ends = float(np.median(array)), float(np.percentile(array, 95))
    return Spread(len(array), *(round(one, 4) for one in ends))


def fraction(flags: Sequence[bool]) -> float | None:
    """Fraction of true flags, rounded to four decimals; None where there are none."""
    return round(sum(flags) / len(flags), 4) if flags else None


def sigma_share(errors: Iterable[float], sigmas: Iterable[float | None]) -> SigmaShare:
    """Fraction of errors within one and two of their own sigmas; unknown and zero sigmas are left out."""
    ratios = [abs(e) / s for e, s in zip(errors, sigmas, strict=True) if s]
    return SigmaShare(
        len(ratios), fraction([r <= 1 for r in ratios]), fraction([r <= 2 for r in ratios])
    )


def share_words(count: int, total: int) -> str:
    """`45 of 50, 90 % (79 to 96)`."""
    interval = share_interval(count, total)
    if interval is None:
        return "0 of 0"
    low, high = (_percent(end) for end in interval)
    return f"{count} of {total}, {_percent(count / total)} % ({low} to {high})"


def rate_words(count: int, images: int) -> str:
    """`3 in 24 images, 12.5 per 100 (2.6 to 36.5)`."""
    interval = rate_interval(count, images / 100)
    if interval is None:
        return f"{count} in no image"
    return f"{count} in {images} images, {100 * count / images:.1f} per 100 ({interval.low:.1f} to {interval.high:.1f})"


def _percent(share: float) -> str:
    percent = 100 * share
    return f"{percent:.0f}" if percent >= 10 or percent == 0 else f"{percent:.2g}"
