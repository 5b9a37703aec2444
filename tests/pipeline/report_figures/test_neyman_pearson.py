from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from wayside.pipeline.report_figures.decisions import (
    Densities,
    fitted_densities,
    most_powerful_test,
    report_densities,
    report_power,
    report_threshold,
)


@pytest.mark.parametrize(
    ("alpha", "red", "power"),
    [
        (0.10, 167.73, 0.9967),
        (0.05, 181.71, 0.9913),
        (0.03, 190.77, 0.9840),
        (0.01, 207.75, 0.9507),
        (0.0819, 172.0, 0.9955),
        (0.0105, 207.0, 0.9531),
    ],
)
def test_the_equations_of_the_report_give_these_thresholds_and_powers(alpha, red, power):
    """The last two: the thresholds in the captions of figures 9.5 and 9.6."""
    assert report_threshold(alpha) == pytest.approx(red, abs=0.12 if red in (172, 207) else 0.005)
    assert report_power(report_threshold(alpha)) == pytest.approx(power, abs=2e-4)


def test_the_densities_of_the_report_have_the_integrals_of_their_equations():
    densities = report_densities()
    assert densities.off.sum() * densities.step == pytest.approx(0.99434, abs=1e-4)
    assert densities.on.sum() * densities.step == pytest.approx(0.99985, abs=3e-4)


@pytest.mark.parametrize("alpha", [0.1, 0.05, 0.03, 0.01])
def test_the_test_of_the_report_s_densities_is_a_threshold_at_their_tail(alpha):
    found = most_powerful_test(report_densities(), alpha)
    upper = norm.cdf(252.6, 118.337, 1489**0.5)
    exact = norm.ppf(upper - alpha, 118.337, 1489**0.5)
    assert found.threshold == pytest.approx(exact, abs=0.01)
    assert found.false_alarm == pytest.approx(alpha, abs=1e-4)
    signs = quad(lambda y: 4.211e-9 * np.exp(y / 235**0.5), exact, 253.8)[0]
    assert found.power == pytest.approx(signs, abs=1e-3)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.9))
def test_no_other_region_of_the_same_false_alarm_rate_has_more_power(seed, alpha):
    draw = np.random.default_rng(seed)
    off, on = draw.random((2, 40))
    densities = Densities(np.arange(40.0) / 40, off / off.mean(), on / on.mean())
    best = most_powerful_test(densities, alpha)
    assert best.false_alarm <= alpha + 1e-12
    other = draw.random(40) < draw.random()
    if densities.off[other].sum() * densities.step <= best.false_alarm:
        assert densities.on[other].sum() * densities.step <= best.power + 1e-9


def test_two_fitted_normal_densities_have_the_power_of_the_normal_ones():
    draw = np.random.default_rng(3)
    fitted = fitted_densities(draw.normal(2, 1, 1000), draw.normal(0, 1, 1000))
    found = most_powerful_test(fitted, 0.1)
    assert found.power == pytest.approx(norm.sf(norm.isf(0.1) - 2), abs=0.05)


def test_signs_on_both_sides_of_the_others_need_two_thresholds():
    values = np.linspace(-5, 5, 1001)
    densities = Densities(values, norm.pdf(values), norm.pdf(values, 0, 3))
    found = most_powerful_test(densities, 0.2)
    assert found.threshold is None
    assert found.accepted[0]
    assert found.accepted[-1]
    assert not found.accepted[500]
