from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.settings import TieSettings
from wayside.stages.adjustment import tie_scatter
from wayside.stages.adjustment.scatter import residual_scatter

PULLS = np.random.default_rng(3).normal(0, 1, 20_000)
SETTINGS = TieSettings()


@pytest.mark.parametrize("quantile", [0.5, 0.75, 0.9])
def test_the_scatter_is_that_of_the_residuals_over_the_stated_one(quantile):
    assert residual_scatter(2.5 * PULLS, quantile) == pytest.approx(2.5, rel=0.03)


def test_errors_are_never_stated_smaller_than_before():
    assert residual_scatter(0.3 * PULLS, 0.75) == 1.0


def test_without_residuals_the_errors_are_as_stated():
    assert residual_scatter(np.zeros(0), 0.75) == 1.0


def test_gross_errors_count_no_more_however_large_they_are():
    some, more = PULLS.copy(), PULLS.copy()
    some[::20], more[::20] = 20.0, 2000.0
    assert residual_scatter(some, 0.75) == residual_scatter(more, 0.75)
    assert residual_scatter(more, 0.75) < 1.2


def test_sampson_distances_are_compared_with_the_error_of_a_registered_coordinate():
    assert tie_scatter(0.2 * PULLS, SETTINGS) == pytest.approx(0.2 / 0.08, rel=0.03)
    assert tie_scatter(0.2 * PULLS, replace(SETTINGS, sigma_px=0.2)) == pytest.approx(1, rel=0.03)
