import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment import TieErrors
from wayside.stages.odometry.pair_adjustment import FIT, adjust_pair

from .made_pairs import AHEAD, FOCAL, SIGMA_PX, errors_deg, make_pair

LOOSE = StepPrior(np.eye(3), np.inf, AHEAD, np.radians([60.0, 60.0]), True, 8.0, 0.02)


def adjust(previous, current, prior=LOOSE, start=None, **how):
    own = {"focal_px": FOCAL, "errors": TieErrors(SIGMA_PX, 0.0, 0.0), "scale_px": 1e6}
    own |= {"schedule": FIT._replace(iterations=30, gain=1e-9)}
    return adjust_pair(previous, current, start or (np.eye(3), AHEAD), prior, **own | how)


def squares(found, previous, current):
    """Eq. 7.5 of each tie, px squared."""
    solid = np.c_[found.points[:, :2], np.ones(len(found.points))]
    local = (solid - np.outer(found.points[:, 2], found.direction)) @ found.rotation
    gaps = np.c_[found.points[:, :2] - previous, local[:, :2] / local[:, 2:] - current] * FOCAL
    return (gaps**2).sum(axis=1)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_cost_is_the_minimum_that_scipy_finds(seed):
    _, direction, points, previous, current = make_pair(seed=seed, count=40)
    found = adjust(previous, current)
    assert np.linalg.norm(found.direction) == pytest.approx(1, abs=1e-12)
    stated = found.step_covariance(8.0, 0.05)[3:, 3:]  # the baseline is held
    assert found.direction @ stated @ found.direction == pytest.approx(0.05**2, rel=1e-6)

    def residuals(unknowns):
        turn = Rotation.from_rotvec(unknowns[:3]).as_matrix()
        centre = np.array([unknowns[3], unknowns[4], 1.0])
        centre /= np.linalg.norm(centre)
        solid = unknowns[5:].reshape(-1, 3)
        local = (solid - centre) @ turn
        seen = solid[:, :2] / solid[:, 2:], local[:, :2] / local[:, 2:]
        return (np.hstack(seen) - np.hstack([previous, current])).ravel() * FOCAL / SIGMA_PX

    start = np.r_[0, 0.03, 0, direction[:2] / direction[2], points.ravel()]
    best = least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12)
    reached = squares(found, previous, current).sum() / SIGMA_PX**2
    assert reached == pytest.approx(2 * best.cost, rel=1e-3)
    turn = Rotation.from_rotvec(best.x[:3]).as_matrix()
    assert Rotation.from_matrix(found.rotation @ turn.T).magnitude() < 1e-5
    # the covariance equals the one from scipy's normal equations: points eliminated
    inverse = np.linalg.inv(best.jac.T @ best.jac)
    sigma = np.sqrt(np.diag(found.covariance)) / found.scatter
    np.testing.assert_allclose(sigma[:3], np.sqrt(np.diag(inverse))[:3], rtol=0.05)


def test_ties_of_larger_errors_give_the_same_motion_and_a_larger_covariance():
    rotation, *_, previous, current = make_pair()
    third = TieErrors(SIGMA_PX / 3, 0.0, 0.0)
    sure, larger = adjust(previous, current), adjust(previous, current, errors=third)
    assert max(errors_deg(larger, sure.rotation, sure.direction)) < 1e-5
    assert larger.scatter == pytest.approx(3 * sure.scatter, rel=0.2)
    alone = (one.covariance[:3, :3] / one.scatter**2 for one in (larger, sure))
    np.testing.assert_allclose(9 * next(alone), next(alone), rtol=0.05)
    known = LOOSE._replace(rotation=rotation, sigma_rotation=1e-6)  # stays as sure as it is
    found = adjust(previous, current, known, errors=third).covariance
    assert np.sqrt(found[0, 0]) == pytest.approx(1e-6, rel=0.05)


def test_wrong_ties_do_not_pull():
    rotation, direction, _, previous, current = make_pair(seed=3, count=150)
    current[::10, 1] += 3 / FOCAL
    found = adjust(previous, current, start=(rotation, direction), scale_px=0.3)
    assert errors_deg(found, rotation, direction)[0] < 0.01
    left = squares(found, previous, current)
    assert np.median(left[::10]) > 1
    assert np.delete(left, np.s_[::10]).max() < 1


def test_points_at_infinity_do_no_harm():
    rotation, direction, _, previous, current = make_pair(seed=4)
    far = np.c_[np.linspace(-0.4, 0.4, 40), np.linspace(-0.3, 0.0, 40), np.ones(40)]
    seen = far @ rotation
    noise = np.random.default_rng(5).normal(0, SIGMA_PX, (2, 40, 2)) / FOCAL
    previous = np.vstack([previous, far[:, :2] + noise[0]])
    current = np.vstack([current, seen[:, :2] / seen[:, 2:] + noise[1]])
    found = adjust(previous, current)
    assert errors_deg(found, rotation, direction)[0] < 0.01
    assert np.abs(found.points[-40:, 2]).max() < 0.02
    assert np.sqrt(squares(found, previous, current).mean() / 4) < 1.2 * SIGMA_PX


def test_without_points_the_prior_is_the_answer():
    nothing = np.zeros((0, 2))
    turn = Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix()
    prior = StepPrior(turn, 0.001, AHEAD, np.array([0.01, 0.02]), False, 8.0, 0.02)
    found = adjust(nothing, nothing, prior=prior)
    np.testing.assert_allclose(found.rotation, turn, atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance))[:3], 0.001, rtol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance))[3:5], [0.01, 0.02], rtol=1e-2)
    stated = np.sqrt(np.diag(found.step_covariance(8.0, 0.03)))
    np.testing.assert_allclose(stated[3:], [0.08, 0.16, 0.03], rtol=1e-2)


def test_rays_of_other_shapes_are_refused():
    with pytest.raises(ValueError, match="previous"):
        adjust(np.zeros((4, 3)), np.zeros((4, 2)))


def test_the_residual_falls_from_step_to_step_until_too_little_is_gained_or_the_limit_is_reached():
    *_, previous, current = make_pair()
    found = adjust(previous, current)
    # The prior has a share in the cost, so a step may cost the ties a trifle.
    assert (np.diff(found.history_px) <= 1e-6 * found.history_px[0]).all()
    assert found.history_px[0] ** 2 > 10 * found.history_px[-1] ** 2
    two, short = (FIT._replace(iterations=2, gain=0), FIT._replace(gain=0.5))
    assert len(adjust(previous, current, schedule=two).history_px) == 3
    assert len(adjust(previous, current, schedule=short).history_px) < len(found.history_px)
    left = squares(found, previous, current).mean()
    assert found.history_px[-1] == pytest.approx(np.sqrt(left / 4), rel=1e-4)
