import numpy as np
import pytest

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment import TIE_ERRORS, TieErrors, correlated_covariance, tie_scatter
from wayside.stages.geometry.rotation import tangent_basis, vector_from_rotation
from wayside.stages.odometry.pair_adjustment import adjust_pair

from ..odometry.made_pairs import AHEAD, FOCAL, make_pair

SIGMA, REACH = 0.2, 80.0


def adjust(previous, current):
    prior = StepPrior(np.eye(3), 1.0, AHEAD, np.array([1.0, 1.0]), False, 8.0, 0.02)
    start = np.eye(3), AHEAD
    return adjust_pair(
        previous, current, start, prior, focal_px=FOCAL, errors=FIELD, scale_px=100.0
    )


FIELD = TieErrors(1e-3, SIGMA, 0.0, REACH)
"""Of the same scatter everywhere, beside a tiny noise of each tie."""


def test_the_covariance_is_that_of_simulated_fields():
    rng = np.random.default_rng(4)
    *_, previous, current = make_pair(0.0, 120, turn=(0.0, 0.0, 0.0), slope=(0.0, 0.0))
    apart = ((current[:, None] - current[None]) ** 2).sum(axis=2) * FOCAL**2
    factor = np.linalg.cholesky(np.exp(-apart / (2 * REACH**2)) + 1e-9 * np.eye(len(current)))
    found = []
    for _ in range(300):
        field = factor @ rng.normal(0, SIGMA / FOCAL, (len(current), 2))
        result = adjust(previous, current + field)
        turn = vector_from_rotation(result.rotation)
        found.append(np.concatenate([turn, tangent_basis(AHEAD) @ result.direction]))
    stated = adjust(previous, current).step_covariance(1.0, 0.0)
    across = tangent_basis(AHEAD) @ stated[3:, 3:] @ tangent_basis(AHEAD).T
    stated = np.concatenate([np.diag(stated)[:3], np.diag(across)])
    np.testing.assert_allclose(np.sqrt(stated), np.std(np.array(found), axis=0), rtol=0.25)


def test_fields_of_each_picture_add_up_as_simulated_ones():
    """Against the sum written out over all pairs of ties of the same picture."""
    rng = np.random.default_rng(6)
    picture = rng.integers(0, 3, 50)
    place, felt = rng.uniform(0, 400, (50, 2)), rng.normal(0, 1, (50, 2, 3))
    apart = ((place[:, None] - place[None]) ** 2).sum(axis=2)
    alike = np.exp(-apart / (2 * REACH**2)) * (picture[:, None] == picture[None])
    wanted = np.einsum("ij,iak,jam->km", alike, felt, felt)
    stated = correlated_covariance(place, picture, felt, REACH)
    np.testing.assert_allclose(stated, wanted, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(stated, stated.T)


PULLS = np.random.default_rng(3).normal(0, TIE_ERRORS.sigma_px, 20_000)
"""Errors as large as stated, px."""


@pytest.mark.parametrize(("factor", "scatter"), [(1.25, 1.25), (2.5, 2.5), (0.3, 1.0)])
def test_the_scatter_is_that_of_the_residuals_over_the_stated_one_and_not_below_it(factor, scatter):
    assert tie_scatter(factor * PULLS) == pytest.approx(scatter, rel=0.03)
    assert tie_scatter(PULLS[:0]) == 1.0


def test_gross_errors_count_no_more_however_large_they_are():
    some, more = PULLS.copy(), PULLS.copy()
    some[::20], more[::20] = 2.0, 200.0
    assert tie_scatter(some) == tie_scatter(more)
    assert tie_scatter(more) < 1.2
