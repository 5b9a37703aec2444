import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from wayside.schemas.motion import StepPrior
from wayside.stages.geometry import Schedule
from wayside.stages.odometry.epipolar import fit_epipolar, sampson_px

from .made_pairs import AHEAD, FOCAL, errors_deg, make_pair

VAGUE = StepPrior(np.eye(3), np.inf, AHEAD, np.radians([1.5, 1.5]), True, 8.0, 0.02)
START = (np.eye(3), AHEAD)


def fit(previous, current, start=START, prior=VAGUE):
    how = {"focal_px": FOCAL, "sigma_px": 0.1, "scales_px": [1e6], "schedule": Schedule(15, 1e-7)}
    return fit_epipolar(previous, current, start, prior, **how)


def test_the_sampson_distance_is_the_textbook_formula():
    rotation, direction, _, previous, current = make_pair(noise_px=2.0)
    essential = np.cross(direction, rotation, axisb=0, axisc=0)
    p, q = (np.c_[rays, np.ones(len(rays))] for rays in (previous, current))
    line, back = q @ essential.T, p @ essential
    expected = FOCAL * (p * line).sum(axis=1)
    expected /= np.sqrt((line[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
    found = sampson_px(previous, current, rotation, direction, FOCAL)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_the_minimum_is_that_of_scipy():
    *_, previous, current = make_pair(seed=5)
    found = fit(previous, current)

    def residuals(unknowns):
        rotation = Rotation.from_rotvec(unknowns[:3]).as_matrix()
        direction = np.array([unknowns[3], unknowns[4], 1.0])
        direction /= np.linalg.norm(direction)
        half = Rotation.from_rotvec(unknowns[:3] / 2).apply(AHEAD)
        known = (direction[:2] / direction[2] - half[:2] / half[2]) / np.radians(1.5)
        return np.r_[sampson_px(previous, current, rotation, direction, FOCAL) / 0.1, known]

    best = least_squares(residuals, np.zeros(5), x_scale="jac", xtol=1e-14, ftol=1e-14)
    turn = Rotation.from_rotvec(best.x[:3]).as_matrix()
    direction = np.array([best.x[3], best.x[4], 1.0])
    direction /= np.linalg.norm(direction)
    assert errors_deg(found, turn, direction).max() < 1e-4


def test_without_rays_the_prior_is_the_answer():
    nothing = np.zeros((0, 2))
    turn = Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix()
    prior = StepPrior(turn, 0.001, AHEAD, np.array([0.01, 0.01]), False, 8.0, 0.02)
    found = fit(nothing, nothing, start=(np.eye(3), np.array([0.1, 0.0, 0.99])), prior=prior)
    assert errors_deg(found, turn, AHEAD).max() < 1e-3


def test_rays_of_other_shapes_are_refused():
    with pytest.raises(ValueError, match="current"):
        fit(np.zeros((4, 2)), np.zeros((3, 2)))
