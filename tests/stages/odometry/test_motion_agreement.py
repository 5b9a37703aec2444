"""Poses against the motion that images show: conventions are recognised, contradictions are found."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.stages.odometry.motion_agreement import AXES, CameraPath, ImageStep, agreement, upright

LEVEL = AXES["x forward, y left, z up"]
"""A camera that looks along x in a world whose z axis is up: its axes are the columns."""


def drive(count=20, turn_deg=4.0):
    """Poses of a camera on a road with bends up and down, in a world with z up."""
    yaw = np.radians(turn_deg) * np.sin(np.arange(count) / 3).cumsum()
    pitch = np.radians(1.5) * np.sin(np.arange(count) / 2)
    turns = Rotation.from_euler("ZY", np.stack([yaw, pitch], axis=1)).as_matrix() @ LEVEL
    ahead = turns[:, :, 2]
    centre = np.vstack([np.zeros(3), np.cumsum(5 * (ahead[:-1] + ahead[1:]) / 2, axis=0)])
    return CameraPath(np.ones(count, bool), turns, centre + np.array([100.0, -50.0, 1.5]))


def steps_of(path, noise_deg=0.0):
    rng = np.random.default_rng(3)
    steps = []
    for i in range(len(path.centre) - 1):
        shift = (path.centre[i + 1] - path.centre[i]) @ path.rotation[i]
        shake = Rotation.from_rotvec(np.radians(rng.normal(0, noise_deg, 3))).as_matrix()
        turn = path.rotation[i].T @ path.rotation[i + 1]
        steps.append(ImageStep(i, i + 1, turn, shake @ shift / np.linalg.norm(shift)))
    return steps


def moved(path, rotation, shift=(0.0, 0.0, 0.0)):
    """The same poses in a world that is turned."""
    return CameraPath(path.known, rotation @ path.rotation, path.centre @ rotation.T + shift)


def test_poses_of_the_camera_agree_whatever_their_world():
    path = drive()
    for world in Rotation.random(5, rng=1).as_matrix():
        found = agreement(steps_of(path, noise_deg=3.0), moved(path, world, (5e5, 4e6, 0.0)))
        assert found.tells
        assert found.agrees
        assert found.steps == found.agree == 19


def test_too_few_steps_tell_nothing():
    path = drive()
    nowhere = CameraPath(np.zeros(20, bool), path.rotation, path.centre)
    assert not agreement(steps_of(path), nowhere).tells
    assert not agreement(steps_of(path)[:2], path).tells


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_a_world_is_turned_until_its_z_axis_is_up(up):
    path, axis = drive(), np.array([letter == up[-1] for letter in "xyz"], float)
    turn, _ = Rotation.align_vectors(-axis if "-" in up else axis, [0, 0, 1])
    turned, found = upright(moved(path, turn.as_matrix()))
    assert found == up
    assert np.linalg.det(turned.rotation) == pytest.approx(1.0)
    assert -turned.rotation[:, 2, 1] == pytest.approx(-path.rotation[:, 2, 1], abs=1e-9)
    assert np.ptp(turned.centre, axis=0)[2] == pytest.approx(np.ptp(path.centre[:, 2]), abs=1e-9)
    assert agreement(steps_of(path), turned).agrees


def test_a_camera_on_its_side_leaves_no_direction_up():
    tilted = drive().mounted(Rotation.from_euler("z", 45, degrees=True).as_matrix())
    assert upright(tilted)[1] == ""


@pytest.mark.parametrize(("latitude", "longitude"), [(49.0, 8.4), (-33.9, 151.2), (64.1, -21.9)])
def test_poses_about_the_centre_of_the_earth_come_level_at_the_first(latitude, longitude):
    from pyproj import Transformer  # an independent oracle

    path = drive()
    local = path.centre - path.centre[0]
    to_earth = Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lon_0={longitude} "
        f"+lat_0={latitude} +h_0=120"
    )
    centre = np.stack(to_earth.transform(*local.T), axis=1)
    axes = np.stack(to_earth.transform(*np.eye(3)), axis=1) - centre[0]
    turned, up = upright(CameraPath(path.known, axes.T @ path.rotation, centre))
    assert up == "earth"
    assert turned.centre == pytest.approx(local, abs=1e-3)
    assert turned.rotation == pytest.approx(path.rotation, abs=1e-5)
