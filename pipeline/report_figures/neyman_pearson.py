"""The most powerful test of a stated false-alarm rate, of fitted densities and of the report's own (chapter 9).

Two hypotheses on a value y: no sign, with density p0, or a sign, with density p1. No test of false-alarm rate alpha has
more power than the one that accepts where p1 / p0 is at least eta (Neyman and Pearson 1933). The value of eta accepts
whatever is not a sign with probability alpha (report eq. 9.3 to 9.6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfinv
from scipy.stats import gaussian_kde

from wayside.schemas.errors import UsageError

REPORT_MEAN, REPORT_VARIANCE, REPORT_OFF = 118.337, 1489.0, (20.0, 252.6)
"""Eq. 9.1: red of pixels of no white sign, N(118.337, 1489) on 20 to 252.6. It is cut, not scaled: its integral is
0.99434."""

REPORT_GROWTH, REPORT_FACTOR, REPORT_ON = 235.0**0.5, 4.211e-9, (136.2, 253.8)
"""Eq. 9.2: red of pixels of white signs, 4.211e-9 exp(y / sqrt 235) on 136.2 to 253.8."""

GRID = 2048
"""Values at which fitted densities are compared."""


@dataclass(frozen=True, slots=True)
class Densities:
    """Both densities on equally spaced values (n,): `off` of what is no sign (p0), `on` of signs (p1)."""

    values: NDArray[np.float64]
    off: NDArray[np.float64]
    on: NDArray[np.float64]

    @property
    def step(self) -> float:
        """Distance of the values."""
        return float(self.values[1] - self.values[0])

    @property
    def likelihood_ratio(self) -> NDArray[np.float64]:
        """p1 / p0 (n,), eq. 9.3: inf where only signs have a density, 0 where neither has one."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.on / self.off
        return np.where(self.on > 0, ratio, 0.0)


@dataclass(frozen=True, slots=True)
class PowerfulTest:
    """The most powerful test of a false-alarm rate.

    `accepted` (n,) bool by value. `false_alarm`, `power`: probabilities that it accepts what is no sign, and a sign.
    `threshold`: the least accepted value where all larger ones are accepted too, None where these have gaps.
    """

    accepted: NDArray[np.bool_]
    false_alarm: float
    power: float
    threshold: float | None


def fitted_densities(on: NDArray[np.floating], off: NDArray[np.floating]) -> Densities:
    """Kernel densities (Gaussian, bandwidth by Scott's rule) of the values of signs (m,) and of everything else (n,).

    Raises
    ------
    ValueError
        Fewer than two different values of either kind.
    """
    kinds = [np.asarray(values, np.float64) for values in (off, on)]
    if any(len(np.unique(values)) < 2 for values in kinds):
        raise ValueError("densities: each kind needs two different values")
    together = np.concatenate(kinds)
    margin = 0.1 * float(np.ptp(together))
    grid = np.linspace(together.min() - margin, together.max() + margin, GRID)
    return Densities(grid, *(gaussian_kde(values)(grid) for values in kinds))


def report_densities() -> Densities:
    """The report's densities of the red of white signs (eq. 9.1 and 9.2), as printed."""
    values = np.linspace(0.0, 256.0, 2**16 + 1)
    off = np.exp(-((values - REPORT_MEAN) ** 2) / (2 * REPORT_VARIANCE))
    off /= np.sqrt(2 * np.pi * REPORT_VARIANCE)
    on = REPORT_FACTOR * np.exp(values / REPORT_GROWTH)
    return Densities(
        values,
        np.where((values >= REPORT_OFF[0]) & (values <= REPORT_OFF[1]), off, 0.0),
        np.where((values >= REPORT_ON[0]) & (values <= REPORT_ON[1]), on, 0.0),
    )


def most_powerful_test(densities: Densities, alpha: float) -> PowerfulTest:
    """The test of largest power among those of false-alarm rate at most `alpha` (eq. 9.4 to 9.6).

    Raises
    ------
    UsageError
        `alpha` is not from 0 to 1.
    """
    _check(alpha)
    ratio, step = densities.likelihood_ratio, densities.step
    order = np.argsort(-ratio, kind="stable")
    alarm = np.cumsum(densities.off[order]) * step
    # of equal ratios all are accepted or none: a set of positive probability is not cut
    ends = np.append(ratio[order][1:] < ratio[order][:-1], True)
    allowed = np.flatnonzero(ends & (alarm <= alpha))
    last = int(allowed[-1]) if len(allowed) else -1
    accepted = np.zeros(len(ratio), np.bool_)
    accepted[order[: last + 1]] = True
    accepted &= densities.on > 0
    first = int(np.argmax(accepted)) if accepted.any() else len(accepted)
    whole = bool(accepted.any()) and bool((accepted | (densities.on <= 0))[first:].all())
    return PowerfulTest(
        accepted,
        float(densities.off[accepted].sum() * step),
        min(1.0, float(densities.on[accepted].sum() * step)),
        float(densities.values[first]) if whole else None,
    )


def report_threshold(alpha: float) -> float:
    """Red from which a pixel belongs to a white sign, by eq. 9.7.

    167.73 at alpha 0.1 and 190.77 at 0.03. The captions of figures 9.5 and 9.6 say 172 and 207 for these, which are the
    thresholds of alpha 0.0819 and 0.0105. The constant 0.9995 is the error function at the upper end of eq. 9.1 alone;
    the exact tail gives 167.79 and 190.91.

    Raises
    ------
    UsageError
        `alpha` is not from 0 to 0.99975, for which the equation has a value.
    """
    if not 0 <= alpha < 0.99975:
        raise UsageError(f"alpha: {alpha:g} is outside 0 to 0.99975 (eq. 9.7)")
    return float(REPORT_MEAN - 54.57 * erfinv(2 * alpha - 0.9995))


def report_power(threshold: float) -> float:
    """Power of a threshold on the red, by eq. 9.8, cut to 0 to 1: 0.9967 at 167.73."""
    power = 6.4555e-8 * (15495907.18 - np.exp(threshold / REPORT_GROWTH))
    return float(np.clip(power, 0.0, 1.0))


def _check(alpha: float) -> None:
    if not 0 <= alpha <= 1:
        raise UsageError(f"alpha: {alpha:g} is not a false-alarm rate from 0 to 1")
