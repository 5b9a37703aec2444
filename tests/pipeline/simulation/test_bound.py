import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from wayside.pipeline.simulation.bound import motion_jacobian, point_bound, step_bound
from wayside.stages.geometry import tangent_basis
from wayside.stages.mapping.landmark import point_covariance
from wayside.stages.odometry import sampson_px

POINT = np.array([3.12, -0.6, 52.0])
FRAMES = 6
ROTATIONS = np.repeat(np.eye(3)[None], FRAMES, axis=0)
CENTRES = np.array([[0.0, 0.0, 8.05 * k] for k in range(FRAMES)])
EXACT = np.repeat(1e-18 * np.eye(6)[None], FRAMES, axis=0)
LOOSE = np.repeat(np.diag([3e-4, 3e-4, 3e-4, 0.01, 0.01, 0.03])[None] ** 2, FRAMES, axis=0)


def bound(steps, sigma=1 / 1400, **kwargs):
    views, spread = np.arange(FRAMES), np.full(FRAMES, sigma)
    return point_bound(ROTATIONS, CENTRES, POINT, views, spread, steps, FRAMES - 1, **kwargs)


def test_derivatives_of_the_motion_are_those_of_the_distance():
    rng = np.random.default_rng(6)
    point = rng.uniform((-8, -3, 16), (8, 2, 60), (12, 3))
    previous, after = point[:, :2] / point[:, 2:], point - [0.0, 0.0, 8.0]
    current = after[:, :2] / after[:, 2:] + rng.normal(0, 1e-4, (12, 2))
    ahead, small = np.array([0.0, 0.0, 1.0]), 1e-4
    slopes = motion_jacobian(previous, current, np.eye(3), ahead, 1400.0)
    moved = ahead + small * tangent_basis(ahead)[0]
    there, here = (
        sampson_px(previous, current, np.eye(3), d / np.linalg.norm(d), 1400.0)
        for d in (moved, ahead)
    )
    assert (there - here) / small == pytest.approx(slopes[:, 3], rel=1e-2, abs=0.5)


def test_with_known_motion_it_is_the_formula_for_views_on_a_line():
    """s_Z^2 = s^2 S2 / (f^2 R^2 (S2 S4 - S3^2)) with S_p the sums of inverse depths to the p."""
    near = 1 / (POINT[2] - CENTRES[:, 2])
    s2, s3, s4 = (float((near**p).sum()) for p in (2, 3, 4))
    square = s2 / (1400**2 * (POINT[:2] ** 2).sum() * (s2 * s4 - s3**2))
    assert bound(EXACT)[2, 2] == pytest.approx(square, rel=1e-4)


def test_nothing_that_weighs_the_views_alone_can_beat_it():
    views, sigma = np.arange(FRAMES), np.full(FRAMES, 1 / 1400)
    stated = point_covariance(ROTATIONS, CENTRES, POINT, views, sigma, sigma, LOOSE, FRAMES - 1)
    least = bound(LOOSE)
    assert (np.linalg.eigvalsh(stated - least) > -1e-9).all()
    assert (np.diag(least) > np.diag(bound(EXACT))).all()


@pytest.mark.slow
def test_adjusting_all_together_reaches_it():
    rng = np.random.default_rng(8)
    sigma, deviations = 0.5 / 1400, np.sqrt(np.diag(LOOSE[0]))
    true = np.stack([((POINT - c) / (POINT - c)[2])[:2] for c in CENTRES])
    found = []
    for _ in range(75):
        measured = rng.normal(0, deviations, (FRAMES - 1, 6))
        rays = true + rng.normal(0, sigma, true.shape)

        def gaps(unknown, measured=measured, rays=rays):
            errors = unknown[3:].reshape(-1, 6)
            rotation, centre = np.eye(3), np.zeros(3)
            poses = [(rotation, centre)]
            for error in errors:
                centre = centre + rotation @ (np.array([0, 0, 8.05]) + error[3:])
                rotation = rotation @ Rotation.from_rotvec(error[:3]).as_matrix()
                poses.append((rotation, centre))
            last_r, last_c = poses[-1]
            point = last_r @ unknown[:3] + last_c
            out = [((errors - measured) / deviations).ravel()]
            for (r, c), ray in zip(poses, rays, strict=True):
                local = r.T @ (point - c)
                out.append((local[:2] / local[2] - ray) / sigma)
            return np.concatenate(out)

        start = np.concatenate([POINT - CENTRES[-1], np.zeros(6 * (FRAMES - 1))])
        found.append(least_squares(gaps, start, method="lm").x[:3])
    reached = np.std(np.array(found), axis=0)
    assert reached == pytest.approx(np.sqrt(np.diag(bound(LOOSE, sigma))), rel=0.2)


def test_given_poses_can_only_help():
    free, given = bound(LOOSE), bound(LOOSE, pose_sigma=(0.02, 7e-4))
    assert (np.linalg.eigvalsh(free - given) > -1e-12).all()
    exact = bound(LOOSE, pose_sigma=(1e-7, 1e-9))
    assert exact == pytest.approx(bound(EXACT), rel=1e-2, abs=1e-9)


def test_a_step_is_as_sure_as_its_ties_and_its_length():
    slopes = np.vstack([np.eye(5)] * 4) * 1000
    covariance = step_bound(slopes, 0.01 * np.eye(20), np.array([0.0, 0.0, 1.0]), 8.0, 0.02)
    assert np.diag(covariance) == pytest.approx([2.5e-9] * 3 + [1.6e-7] * 2 + [4e-4])
