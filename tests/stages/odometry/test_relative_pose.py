from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Camera
from wayside.stages.geometry.rotation import rotation_from_vector
from wayside.stages.odometry.coarse_pose import fit_coarse_motion, fit_near_motions
from wayside.stages.odometry.epipolar import RelativePosePrior, halfway_direction
from wayside.stages.odometry.relative_pose import fit_relative_pose

CAMERA = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
VIEW = SimpleNamespace(camera=CAMERA, focal_px=1400.0)
AHEAD = np.array([0.0, 0.0, 1.0])
LAW = RelativePosePrior(np.eye(3), np.inf, AHEAD, np.radians([0.35, 0.25]), True)


def seen(points):
    return points[:, :2] / points[:, 2:] * 1400 + (799.5, 599.5)


def ties_on_a_curve(yaw_deg, standing, riding, seed=0, road=0):
    """Ties of things that stand, and of a vehicle ahead that keeps our pace, with a little noise."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec([0.0, np.radians(yaw_deg), 0.0]).as_matrix()
    direction = halfway_direction(np.ascontiguousarray(rotation), AHEAD)
    depth = np.exp(rng.uniform(np.log(12), np.log(400), standing))
    aside = rng.uniform([-0.5, -0.12], [0.5, 0.05], (standing, 2)) * depth[:, None]
    points = np.column_stack([aside, depth])
    lane = np.column_stack(
        [rng.uniform(-5, 5, road), np.full(road, 2.0), rng.uniform(14, 40, road)]
    )
    points = np.vstack([points, lane])
    after = (points - 8.0 * direction) @ rotation
    car = rng.uniform([-1.0, -0.5, 22], [1.0, 1.2, 24], (riding, 3))
    previous = np.vstack([seen(points), seen(car)])
    current = np.vstack([seen(after), seen(car)])
    current += rng.normal(0, 0.08, current.shape)
    tied = SimpleNamespace(previous=previous, current=current)
    return tied, rotation, direction


@pytest.mark.parametrize("yaw_deg", [-0.9, -0.6, 0.6, 0.8])
def test_a_vehicle_at_our_pace_does_not_make_a_curve_straight(yaw_deg):
    tied, rotation, direction = ties_on_a_curve(yaw_deg, standing=70, riding=30)
    step = fit_relative_pose(VIEW, VIEW, tied, (np.eye(3), AHEAD), LAW)
    off = Rotation.from_matrix(rotation.T @ step.rotation).magnitude()
    assert np.degrees(off) < 0.05
    np.testing.assert_allclose(step.direction, direction, atol=np.radians(0.3))
    assert step.inlier[:70].mean() > 0.95
    assert step.inlier[70:].mean() < 0.3


@pytest.mark.parametrize("seed", range(6))
def test_the_turn_is_among_the_near_motions_where_a_bus_fills_the_picture(seed):
    tied, rotation, _ = ties_on_a_curve(1.6, standing=110, riding=110, seed=seed, road=40)
    noise = np.random.default_rng(seed).normal(0, 1.0, tied.current.shape)
    wrong = np.random.default_rng(seed).uniform([300, 300], [1300, 700], (60, 2))
    rays = [
        (np.vstack([points, lost]) - (799.5, 599.5)) / 1400
        for points, lost in ((tied.previous, wrong), (tied.current + noise, wrong[::-1]))
    ]
    predicted = rotation_from_vector(np.radians([0.1, 1.3, -0.1]))

    def off(fit):
        return np.degrees(Rotation.from_matrix(rotation.T @ fit.rotation).magnitude())

    afar, _ = fit_coarse_motion(*rays, LAW, predicted, 1400.0)
    near = fit_near_motions(*rays, LAW, predicted, 1400.0)
    assert off(afar) > 1
    assert min(off(fit) for fit in near) < 0.2
    assert len(near) <= 3


def test_the_same_ties_give_the_same_step():
    tied, _, _ = ties_on_a_curve(0.7, standing=60, riding=25)
    first = fit_relative_pose(VIEW, VIEW, tied, (np.eye(3), AHEAD), LAW)
    again = fit_relative_pose(VIEW, VIEW, tied, (np.eye(3), AHEAD), LAW)
    assert first.rotation.tobytes() == again.rotation.tobytes()
    assert first.direction.tobytes() == again.direction.tobytes()
