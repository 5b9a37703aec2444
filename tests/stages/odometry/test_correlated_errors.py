import numpy as np
import pytest

from wayside.stages.geometry.rotation import tangent_basis, vector_from_rotation
from wayside.stages.odometry.correlated_errors import (
    correlated_motion_covariance,
    correlated_point_covariance,
    motion_jacobian,
)
from wayside.stages.odometry.epipolar import RelativePosePrior, sampson_px
from wayside.stages.odometry.two_view_adjustment import adjust_two_views

FOCAL, SIGMA, REACH = 1400.0, 0.2, 80.0
AHEAD = np.array([0.0, 0.0, 1.0])


def ties(rng, count=120):
    point = np.column_stack(
        [rng.uniform(-8, 8, count), rng.uniform(-3, 2, count), rng.uniform(16, 60, count)]
    )
    after = point - [0.0, 0.0, 8.0]
    return point[:, :2] / point[:, 2:], after[:, :2] / after[:, 2:]


def test_the_covariance_is_that_of_simulated_fields():
    rng = np.random.default_rng(4)
    previous, current = ties(rng)
    prior = RelativePosePrior(np.eye(3), 1.0, AHEAD, np.array([1.0, 1.0]), False)
    apart = ((current[:, None] - current[None]) ** 2).sum(axis=2) * FOCAL**2
    factor = np.linalg.cholesky(np.exp(-apart / (2 * REACH**2)) + 1e-9 * np.eye(len(current)))
    found = []
    for _ in range(300):
        field = factor @ rng.normal(0, SIGMA / FOCAL, (len(current), 2))
        result = adjust_two_views(
            previous,
            current + field,
            (np.eye(3), AHEAD),
            prior,
            focal_px=(FOCAL, FOCAL),
            sigma_px=0.1,
            scale_px=100.0,
        )
        turn = vector_from_rotation(result.rotation)
        found.append(np.concatenate([turn, tangent_basis(AHEAD) @ result.direction]))
    _, slopes = motion_jacobian(previous, current, np.eye(3), AHEAD, FOCAL)
    gain = result.covariance @ slopes.T / 0.1**2
    stated = correlated_motion_covariance(
        current, AHEAD, gain, focal_px=FOCAL, sigma_px=np.full(len(current), SIGMA), reach_px=REACH
    )
    np.testing.assert_allclose(np.sqrt(np.diag(stated)), np.std(np.array(found), axis=0), rtol=0.25)


def test_errors_that_hang_together_harm_more_than_single_ones():
    rng = np.random.default_rng(5)
    previous, current = ties(rng)
    _, slopes = motion_jacobian(previous, current, np.eye(3), AHEAD, FOCAL)
    gain = np.linalg.inv(slopes.T @ slopes) @ slopes.T
    alone, together = (
        np.diag(
            correlated_motion_covariance(
                current,
                AHEAD,
                gain,
                focal_px=FOCAL,
                sigma_px=np.full(len(current), 0.1),
                reach_px=reach,
            )
        )
        for reach in (0.01, 100.0)
    )
    assert (together > 2 * alone).all()


def test_slopes_are_those_of_the_distance():
    rng = np.random.default_rng(6)
    previous, current = ties(rng, 12)
    current = current + rng.normal(0, 1e-4, current.shape)
    gaps, slopes = motion_jacobian(previous, current, np.eye(3), AHEAD, FOCAL)
    small = 1e-4
    moved = AHEAD + small * tangent_basis(AHEAD)[0]
    there = sampson_px(previous, current, np.eye(3), moved / np.linalg.norm(moved), FOCAL)
    assert (there - gaps) / small == pytest.approx(slopes[:, 3], rel=1e-2, abs=0.5)


def test_fields_of_each_image_add_up_as_simulated_ones():
    """Against the sum written out over all pairs of ties of the same image."""
    rng = np.random.default_rng(6)
    image = rng.integers(0, 3, 50)
    place, felt = rng.uniform(0, 400, (50, 2)), rng.normal(0, 1, (50, 2, 3))
    apart = ((place[:, None] - place[None]) ** 2).sum(axis=2)
    alike = np.exp(-apart / (2 * REACH**2)) * (image[:, None] == image[None])
    wanted = np.einsum("ij,iak,jam->km", alike, felt, felt)
    stated = correlated_point_covariance(place, image, felt, REACH)
    np.testing.assert_allclose(stated, wanted, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(stated, stated.T)


def test_no_ties_share_no_error():
    none = np.zeros((0, 2))
    assert not correlated_point_covariance(
        none, np.zeros(0, np.int64), np.zeros((0, 2, 3)), REACH
    ).any()
