from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.settings import TieSettings
from wayside.stages.adjustment import tie_scatter

SETTINGS = TieSettings()
PULLS = np.random.default_rng(3).normal(0, SETTINGS.sigma_px, 20_000)
"""Errors as large as stated, px."""


@pytest.mark.parametrize("quantile", [0.5, 0.75, 0.9])
def test_the_scatter_is_that_of_the_residuals_over_the_stated_one(quantile):
    settings = replace(SETTINGS, scatter_quantile=quantile)
    assert tie_scatter(2.5 * PULLS, settings) == pytest.approx(2.5, rel=0.03)
    stated_twice = replace(settings, sigma_px=2 * SETTINGS.sigma_px)
    assert tie_scatter(2.5 * PULLS, stated_twice) == pytest.approx(1.25, rel=0.03)


def test_errors_are_never_stated_smaller_than_before():
    assert tie_scatter(0.3 * PULLS, SETTINGS) == 1.0


def test_without_residuals_the_errors_are_as_stated():
    assert tie_scatter(np.zeros(0), SETTINGS) == 1.0


def test_gross_errors_count_no_more_however_large_they_are():
    some, more = PULLS.copy(), PULLS.copy()
    some[::20], more[::20] = 2.0, 200.0
    assert tie_scatter(some, SETTINGS) == tie_scatter(more, SETTINGS)
    assert tie_scatter(more, SETTINGS) < 1.2
