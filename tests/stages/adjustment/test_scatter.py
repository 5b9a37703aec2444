import numpy as np
import pytest

from wayside.stages.adjustment import TIE_ERRORS, tie_scatter

PULLS = np.random.default_rng(3).normal(0, TIE_ERRORS.sigma_px, 20_000)
"""Errors as large as stated, px."""


@pytest.mark.parametrize("factor", [1.25, 2.5])
def test_the_scatter_is_that_of_the_residuals_over_the_stated_one(factor):
    assert tie_scatter(factor * PULLS) == pytest.approx(factor, rel=0.03)


def test_errors_are_never_stated_smaller_than_before():
    assert tie_scatter(0.3 * PULLS) == 1.0


def test_without_residuals_the_errors_are_as_stated():
    assert tie_scatter(np.zeros(0)) == 1.0


def test_gross_errors_count_no_more_however_large_they_are():
    some, more = PULLS.copy(), PULLS.copy()
    some[::20], more[::20] = 2.0, 200.0
    assert tie_scatter(some) == tie_scatter(more)
    assert tie_scatter(more) < 1.2
