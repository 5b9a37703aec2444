import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from wayside.stages.geometry.ray_midpoint import pair_midpoint, pair_residual
from wayside.stages.mapping.triangulation import triangulate_views

SIGMA = 0.25 / 1400
small = st.floats(-0.1, 0.1)


def rays_of(points):
    return points[:, :2] / points[:, 2:]


def drive(views=6, seed=0, noise=SIGMA, point=(3.1, -0.6, 62.0)):
    """Cameras 8.05 m apart with a little of every rotation, and the rays to one point."""
    generator = np.random.default_rng(seed)
    rotations = Rotation.from_rotvec(generator.normal(0, 0.02, (views, 3))).as_matrix()
    centres = np.c_[generator.normal(0, 0.05, (views, 2)), 8.05 * np.arange(views)]
    local = np.einsum("nji,nj->ni", rotations, np.array(point) - centres)
    rays = rays_of(local) + generator.normal(0, noise, (views, 2))
    return rotations, centres, rays, np.full(views, SIGMA)


def test_the_midpoint_and_its_residual_are_those_of_equations_7_3_and_7_5():
    rng, centre = np.random.default_rng(2), np.array([0.0, 0.0, 8.05])
    previous = rng.uniform(-0.3, 0.3, (20, 2))
    current = 1.5 * previous + rng.normal(0, 0.01, (20, 2))  # points some 24 m ahead
    d0, d1 = (np.c_[half, np.ones(20)] for half in (previous, current))
    found = pair_midpoint(previous, current, np.eye(3), centre)
    residual = pair_residual(previous, current, np.eye(3), centre, (1400.0, 1400.0))
    for i in range(20):
        q3 = np.cross(d0[i], d1[i])
        g1, _, g3 = np.linalg.solve(np.c_[-d0[i], d1[i], -q3], -centre)
        q = g1 * d0[i] + g3 / 2 * q3
        r = q - centre
        np.testing.assert_allclose(found.point[i], q, rtol=1e-9)
        assert found.gap[i] == pytest.approx(abs(g3) * np.linalg.norm(q3))
        if q[2] > 0 and r[2] > 0 and found.ahead[i]:
            gaps = q[:2] / q[2] - previous[i], r[:2] / r[2] - current[i]
            assert residual[i] == pytest.approx(1400**2 * np.square(gaps).sum())
    assert found.ahead.sum() > 10


@given(st.tuples(small, small, small), st.tuples(small, small, small))
def test_rays_that_meet_give_their_meeting_point_whatever_the_pose(turn, shift):
    rotation, centre = Rotation.from_rotvec(turn).as_matrix(), np.array([0.1, 0.0, 8.05]) + shift
    points = np.array([[3.1, -0.6, 20.0], [-4.0, -2.0, 35.0]])
    found = pair_midpoint(*map(rays_of, (points, (points - centre) @ rotation)), rotation, centre)
    np.testing.assert_allclose(found.point, points, atol=1e-7)
    assert found.ahead.all()
    assert (found.gap < 1e-9).all()


def test_rays_that_do_not_meet_ahead_are_flagged():
    forward, c1, point = np.zeros((1, 2)), np.array([0.0, 0.0, 8.0]), np.array([[2.0, 0.0, -10.0]])
    parallel = pair_midpoint(forward, forward, np.eye(3), c1)
    at_rest = pair_midpoint(forward, np.array([[0.1, 0.0]]), np.eye(3), np.zeros(3))
    behind = pair_midpoint(rays_of(point), rays_of(point - c1), np.eye(3), c1)
    point_of, _, along_of = map(np.concatenate, zip(parallel, at_rest, behind, strict=True))
    np.testing.assert_allclose(point_of, [[np.nan] * 3, [0, 0, 0], point[0]])
    assert (along_of[2] < 0).all()
    assert not (parallel.ahead | at_rest.ahead | behind.ahead).any()


@pytest.mark.parametrize("views", [2, 3, 8])
def test_several_views_reach_the_minimum_that_scipy_finds(views):
    rotations, centres, rays, sigma = drive(views, seed=views)
    point, covariance = triangulate_views(rotations, centres, rays, sigma)

    def weighted(x):
        local = np.einsum("nji,nj->ni", rotations, x - centres)
        both = (local[:, :2] / local[:, 2:] - rays) / SIGMA
        square = (both**2).sum(axis=1, keepdims=True)
        return (both * np.sqrt(2.385**2 * np.log1p(square / 2.385**2) / square)).ravel()

    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14)
    best = least_squares(weighted, [3.0, -0.5, 61.0], x_scale="jac", **tight)
    along = np.sqrt(np.diag(covariance))
    assert (np.abs(point - best.x) < 0.01 * along).all()


def test_the_covariance_is_the_scatter_of_many_trials():
    trials = [triangulate_views(*drive(6, seed, noise=SIGMA)) for seed in range(300)]
    # the cameras differ a little from trial to trial, so the scatter is taken in units of the stated sigma
    pulls = np.array(
        [(p - [3.1, -0.6, 62.0]) / np.sqrt(np.diag(covariance)) for p, covariance in trials]
    )
    assert (np.abs(pulls.mean(axis=0)) < 0.2).all()
    assert ((0.8 < pulls.std(axis=0)) & (pulls.std(axis=0) < 1.15)).all()


def test_one_wrong_view_of_seven_does_little_harm():
    rotations, centres, rays, sigma = drive(7, seed=4)
    clean, covariance = triangulate_views(rotations, centres, rays, sigma)
    rays[3] += 40 / 1400
    spoilt, _ = triangulate_views(rotations, centres, rays, sigma)
    assert np.abs(spoilt - clean).max() < 3 * np.sqrt(np.diag(covariance)).max()


@settings(max_examples=25)
@given(st.tuples(small, small, small), st.tuples(small, small, small))
def test_another_world_frame_moves_the_point_and_turns_its_covariance(turn, shift):
    rotation = Rotation.from_rotvec(turn).as_matrix()
    rotations, centres, rays, sigma = drive(5, seed=6)
    point, covariance = triangulate_views(rotations, centres, rays, sigma)
    moved, turned = triangulate_views(
        rotation @ rotations, centres @ rotation.T + shift, rays, sigma
    )
    np.testing.assert_allclose(moved, point @ rotation.T + shift, atol=1e-4)
    expected = rotation @ covariance @ rotation.T
    np.testing.assert_allclose(turned, expected, atol=1e-3 * np.abs(covariance).max())


def test_one_view_or_views_from_one_place_give_no_point():
    rotations, centres, rays, sigma = drive(4, noise=0.0)
    still = [np.repeat(column[:1], 4, axis=0) for column in (rotations, centres, rays)]
    for views in (drive(1), (*still, sigma)):
        point, covariance = triangulate_views(*views)
        assert np.isnan(point).all()
        assert np.isnan(covariance).all()


def test_arrays_that_do_not_fit_together_are_refused():
    rotations, centres, rays, sigma = drive(4)
    for views, message in (
        ((rotations, centres, rays[:3], sigma), "shape"),
        ((rotations[:, :2], centres, rays, sigma), "shape"),
        ((rotations, centres, rays, 0 * sigma), "positive"),
    ):
        with pytest.raises(ValueError, match=message):
            triangulate_views(*views)


def test_the_residual_of_the_true_motion_is_nought_and_grows_with_an_unmodelled_turn():
    points = np.random.default_rng(8).uniform((-8, -4, 20), (8, 2, 60), (30, 3))
    direction = np.array([0.0, 0.0, 1.0])
    turn = Rotation.from_rotvec([0.004, 0.0, 0.0]).as_matrix()
    local = (points - 8.05 * direction) @ turn
    previous, current = points[:, :2] / points[:, 2:], local[:, :2] / local[:, 2:]
    focal = (1400.0, 1400.0)
    assert pair_residual(previous, current, turn, direction, focal).max() < 1e-12
    straight = pair_residual(previous, current, np.eye(3), direction, focal)
    # a pitch of 0.23 deg moves everything 5.6 px up or down; the midpoint takes a part of that
    assert 1.0 < np.sqrt(np.median(straight) / 4) < 2.8


def test_rays_that_part_have_the_residual_of_a_point_at_infinity():
    previous, current, centre = (np.array(v) for v in ([[0.1, 0]], [[0.09, 0]], [0, 0, 8.05]))
    found = pair_residual(previous, current, np.eye(3), centre, (1000.0, 1000.0))
    assert found[0] == pytest.approx(0.5 * 10**2)
