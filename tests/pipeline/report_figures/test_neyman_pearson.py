import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from wayside.pipeline.report_figures.decisions import (
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


VALUES = np.linspace(0.0, 256.0, 2**16 + 1)
OFF, ON = (density * VALUES[1] for density in report_densities(VALUES)[1:])


def test_the_densities_of_the_report_have_the_integrals_of_their_equations():
    assert OFF.sum() == pytest.approx(0.99434, abs=1e-4)
    assert ON.sum() == pytest.approx(0.99985, abs=3e-4)


@pytest.mark.parametrize("alpha", [0.1, 0.05, 0.03, 0.01])
def test_the_test_of_the_report_s_densities_is_a_threshold_at_their_tail(alpha):
    found = most_powerful_test(OFF, ON, alpha)
    exact = norm.ppf(norm.cdf(252.6, 118.337, 1489**0.5) - alpha, 118.337, 1489**0.5)
    assert VALUES[found][0] == pytest.approx(exact, abs=0.01)
    assert OFF[found].sum() == pytest.approx(alpha, abs=1e-4)
    signs = quad(lambda y: 4.211e-9 * np.exp(y / 235**0.5), exact, 253.8)[0]
    assert ON[found].sum() == pytest.approx(signs, abs=1e-3)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.9))
def test_no_other_region_of_the_same_false_alarm_rate_has_more_power(seed, alpha):
    draw = np.random.default_rng(seed)
    off, on = (values / values.sum() for values in draw.random((2, 40)))
    best = most_powerful_test(off, on, alpha)
    assert off[best].sum() <= alpha + 1e-12
    other = draw.random(40) < draw.random()
    if off[other].sum() <= off[best].sum():
        assert on[other].sum() <= on[best].sum() + 1e-9


def test_signs_on_both_sides_of_the_others_need_two_thresholds():
    values = np.linspace(-5, 5, 1001)
    found = most_powerful_test(norm.pdf(values) / 100, norm.pdf(values, 0, 3) / 100, 0.2)
    assert found[[0, -1]].all()
    assert not found[500]
