from dataclasses import replace
from math import nan

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import USED, Camera, Frame, Pose, PosePrior
from wayside.schemas.settings import MotionSettings
from wayside.stages.odometry.motion_prior import PoseNoise, TravelDirection, predict_motion
from wayside.stages.odometry.pair_adjustment import PairAdjustment

STEP = Pose(np.eye(3), np.array([0.0, 0.0, 8.0]))
STRAIGHT = TravelDirection(np.array([0.0, 0.0, 1.0]), np.radians([0.35, 0.25]))
FRAME = Frame(0, 0, None, USED, "", b"", Camera(640, 480, 500, 500, 320, 240), spacing_m=8.0)
IMAGE_RAD = 2e-4


def drive(count, sigma_m, sigma_rad, seed=1):
    """Frames 8 m apart, straight ahead, with poses of that noise that state none."""
    generator, frames = np.random.default_rng(seed), []
    for k in range(count):
        turn = Rotation.from_rotvec(generator.normal(0, sigma_rad, 3)).as_matrix()
        centre = k * STEP.centre + generator.normal(0, sigma_m, 3)
        frames.append(replace(FRAME, pose=PosePrior(Pose(turn, centre), None, None, "poses")))
    return frames


def learnt(frames, wrong=()):
    """Noise after a drive whose images measure every step to `IMAGE_RAD`."""
    noise, generator = PoseNoise(), np.random.default_rng(2)
    for k in range(1, len(frames)):
        pair = noise.of(frames[k - 1]), noise.of(frames[k])
        expected = predict_motion(*pair, STRAIGHT, None, nan, MotionSettings())
        error = generator.normal(0, IMAGE_RAD, 6) + (0.1 if k in wrong else 0.0)
        direction = np.array([error[3], error[4], 1.0])
        turn, none = Rotation.from_rotvec(error[:3]).as_matrix(), (np.zeros((0, 3)), np.zeros(0))
        covariance = np.diag([IMAGE_RAD**2] * 5 + [0.0])
        motion = turn, direction / np.linalg.norm(direction)
        noise.learn(expected, PairAdjustment(*motion, *none, covariance, 1.0, np.zeros(1)))
    return noise


@pytest.mark.parametrize(("sigma_m", "sigma_deg"), [(0.01, 0.03), (0.05, 0.2), (0.3, 0.05)])
def test_the_noise_of_poses_is_found_from_the_steps_of_the_images(sigma_m, sigma_deg):
    frames = drive(60, sigma_m, np.radians(sigma_deg))
    found = learnt(frames).of(frames[-1]).pose
    assert found.sigma_m == pytest.approx(sigma_m, rel=0.3)
    assert found.sigma_rad == pytest.approx(np.radians(sigma_deg), rel=0.3)


def test_what_a_log_states_stands():
    frames = drive(60, 0.1, 1e-3)
    stated = [replace(f, pose=replace(f.pose, sigma_m=0.01)) for f in frames]
    found = learnt(stated).of(stated[-1]).pose
    assert found.sigma_m == 0.01
    assert found.sigma_rad == pytest.approx(1e-3, rel=0.3)


def test_some_wrongly_measured_steps_do_not_count():
    frames = drive(60, 0.02, 1e-3)
    found, usual = (learnt(frames, wrong).of(frames[-1]).pose for wrong in (range(20, 30), ()))
    assert found.sigma_m == pytest.approx(usual.sigma_m, rel=0.5)
    assert found.sigma_rad == pytest.approx(usual.sigma_rad, rel=0.5)


def test_the_first_steps_and_steps_of_a_stated_spacing_leave_the_usual_noise():
    np.testing.assert_allclose(learnt(drive(4, 0.3, 0.02)[:3]).variance, PoseNoise().variance)
    noise = learnt([replace(FRAME, pose=None)] * 20)
    np.testing.assert_array_equal(noise.variance, PoseNoise().variance)
    assert noise.of(FRAME).pose is None
