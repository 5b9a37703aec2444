import numpy as np
import pytest

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment.correlated_errors import (
    TIE_ERRORS,
    TieErrors,
    correlated_covariance,
    tie_scatter,
)
from wayside.stages.geometry.rotation import tangent_basis, vector_from_rotation
from wayside.stages.odometry.pair_adjustment import adjust_pair

FOCAL, SIGMA, REACH = 1400.0, 0.2, 80.0
AHEAD = np.array([0.0, 0.0, 1.0])


def ties(rng, count=120):
    point = np.column_stack(
        [rng.uniform(-8, 8, count), rng.uniform(-3, 2, count), rng.uniform(16, 60, count)]
    )
    after = point - [0.0, 0.0, 8.0]
    return point[:, :2] / point[:, 2:], after[:, :2] / after[:, 2:]


def adjust(previous, current, errors):
    prior = StepPrior(np.eye(3), 1.0, AHEAD, np.array([1.0, 1.0]), False, 8.0, 0.02)
    return adjust_pair(
        previous, current, (np.eye(3), AHEAD), prior, focal_px=FOCAL, errors=errors, scale_px=100.0
    )


def of_field(sigma_px, reach_px=REACH):
    """A field of the same scatter everywhere, beside a tiny noise of each tie."""
    return TieErrors(1e-3, sigma_px, 0.0, reach_px)


def test_the_covariance_is_that_of_simulated_fields():
    rng = np.random.default_rng(4)
    previous, current = ties(rng)
    apart = ((current[:, None] - current[None]) ** 2).sum(axis=2) * FOCAL**2
    factor = np.linalg.cholesky(np.exp(-apart / (2 * REACH**2)) + 1e-9 * np.eye(len(current)))
    found = []
    for _ in range(300):
        field = factor @ rng.normal(0, SIGMA / FOCAL, (len(current), 2))
        result = adjust(previous, current + field, of_field(SIGMA))
        turn = vector_from_rotation(result.rotation)
        found.append(np.concatenate([turn, tangent_basis(AHEAD) @ result.direction]))
    stated = adjust(previous, current, of_field(SIGMA)).step_covariance(1.0, 0.0)
    stated = np.r_[
        np.diag(stated)[:3], np.diag(tangent_basis(AHEAD) @ stated[3:, 3:] @ tangent_basis(AHEAD).T)
    ]
    np.testing.assert_allclose(np.sqrt(stated), np.std(np.array(found), axis=0), rtol=0.25)


def test_errors_that_hang_together_harm_more_than_single_ones():
    previous, current = ties(np.random.default_rng(5))
    alone, together = (
        np.diag(adjust(previous, current, of_field(0.1, reach)).step_covariance(1.0, 0.0))[:5]
        for reach in (0.01, 100.0)
    )
    assert (together > 2 * alone).all()


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


def test_no_ties_share_no_error():
    none = np.zeros((0, 2))
    assert not correlated_covariance(none, np.zeros(0, np.int64), np.zeros((0, 2, 3)), REACH).any()


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
