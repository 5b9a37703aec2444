from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Camera
from wayside.schemas.motion import StepPrior
from wayside.stages.geometry import halfway_direction
from wayside.stages.odometry import relative_pose
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.relative_pose import INLIER_RATIO, fit_relative_pose

CAMERA = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
VIEW = SimpleNamespace(camera=CAMERA, focal_px=1400.0)
AHEAD = np.array([0.0, 0.0, 1.0])
MOUNTED = StepPrior(np.eye(3), np.inf, AHEAD, np.radians([0.35, 0.25]), True, 8.0, 0.02)


def seen(points):
    return points[:, :2] / points[:, 2:] * 1400 + (799.5, 599.5)


def ties_on_a_curve(yaw_deg, standing, riding):
    """Ties of things that stand, and of a vehicle ahead that keeps our pace, with a little noise."""
    rng = np.random.default_rng(0)
    rotation = Rotation.from_rotvec([0.0, np.radians(yaw_deg), 0.0]).as_matrix()
    direction = halfway_direction(np.ascontiguousarray(rotation), AHEAD)
    depth = np.exp(rng.uniform(np.log(12), np.log(400), standing))
    aside = rng.uniform([-0.5, -0.12], [0.5, 0.05], (standing, 2)) * depth[:, None]
    points = np.column_stack([aside, depth])
    after = (points - 8.0 * direction) @ rotation
    car = rng.uniform([-1.0, -0.5, 22], [1.0, 1.2, 24], (riding, 3))
    previous = np.vstack([seen(points), seen(car)])
    current = np.vstack([seen(after), seen(car)])
    current += rng.normal(0, 0.08, current.shape)
    return SimpleNamespace(previous=previous, current=current), rotation, direction


@pytest.mark.parametrize("yaw_deg", [-0.9, -0.6, 0.6, 0.8])
def test_a_vehicle_at_our_pace_does_not_make_a_curve_straight(yaw_deg, monkeypatch):
    tied, rotation, direction = ties_on_a_curve(yaw_deg, standing=70, riding=30)
    start = np.eye(3), AHEAD
    straight = fit_relative_pose(relative_pose.PairMotion(VIEW, VIEW, *start), tied, MOUNTED)
    assert straight.inliers < INLIER_RATIO * len(straight.inlier)
    # Without pixels, the coarse pose is the straight one and every registration gives the same ties.
    coarse = SimpleNamespace(rotation=start[0], direction=start[1]), straight.inliers
    monkeypatch.setattr(relative_pose, "find_coarse_motion", lambda *_: coarse)
    monkeypatch.setattr(relative_pose, "register_ties", lambda *_: tied)
    expected = MotionPrior(MOUNTED, start, np.eye(3), 45.0, "straight")
    step = relative_pose.estimate_relative_pose(VIEW, VIEW, expected, Mount(), 20)
    assert np.degrees(Rotation.from_matrix(rotation.T @ step.rotation).magnitude()) < 0.05
    np.testing.assert_allclose(step.direction, direction, atol=np.radians(0.3))
    assert step.inlier[:70].mean() > 0.95
    assert step.inlier[70:].mean() < 0.3
