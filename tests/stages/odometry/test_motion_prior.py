import math
from dataclasses import replace

import numpy as np
import pytest
from pyproj import Geod
from scipy.spatial.transform import Rotation

from wayside.schemas.errors import InputError
from wayside.schemas.frame import USED, Camera, Fix, Frame, Pose, PosePrior
from wayside.schemas.settings import MotionSettings
from wayside.stages.odometry.motion_prior import TravelDirection, fix_distance_m, predict_motion

AHEAD = np.array([0.0, 0.0, 1.0])
MOUNTED = TravelDirection(AHEAD, np.radians([0.35, 0.25]))
FRAME = Frame(7, 0, None, USED, "jpeg", b"", Camera(640, 480, 500, 500, 320, 240))


def expect(before, now, last_rotation=None, speed_mps=math.nan):
    return predict_motion(before, now, MOUNTED, last_rotation, speed_mps, MotionSettings())


def posed(centre, yaw_deg=0.0, sigma_m=0.02, sigma_rad=0.001):
    rotation = Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix()
    prior = PosePrior(Pose(rotation, np.array(centre)), sigma_m, sigma_rad, "poses")
    return replace(FRAME, pose=prior)


def test_spacing_expects_a_straight_line_of_that_length():
    found = expect(FRAME, replace(FRAME, spacing_m=8.05))
    assert (found.prior.length_m, found.prior.sigma_m, found.source) == (8.05, 0.02, "straight")
    np.testing.assert_array_equal(found.straight[0], np.eye(3))
    assert found.prior.sigma_rotation == np.inf
    assert found.prior.halfway


def test_corners_are_looked_for_round_the_last_turn_and_wider_without_one():
    turn = Rotation.from_euler("y", 2, degrees=True).as_matrix()
    now = replace(FRAME, spacing_m=8.05)
    np.testing.assert_array_equal(expect(FRAME, now, last_rotation=turn).search, turn)
    assert expect(FRAME, now).slack_px > expect(FRAME, now, last_rotation=turn).slack_px


def test_poses_come_before_spacing_and_fixes():
    found = expect(posed((0, 0, 0)), replace(posed((0, 0, 7.9), 1.0), spacing_m=8.05))
    assert found.source == "poses"
    assert found.prior.length_m == pytest.approx(7.9)
    assert found.prior.sigma_m == pytest.approx(0.02 * np.sqrt(2))
    assert found.prior.sigma_rotation == pytest.approx(0.001 * np.sqrt(2))
    np.testing.assert_allclose(found.prior.rotation, posed((0, 0, 0), 1.0).pose.pose.rotation)


def test_where_a_straight_line_may_stand_poses_give_its_length_alone():
    before, now = posed((0, 0, 0)), replace(posed((0.4, 0, 7.9), 5.0), spacing_m=8.05)
    report = MotionSettings(residual_px=0.5)
    found = predict_motion(before, now, MOUNTED, None, math.nan, report)
    expected = expect(FRAME, replace(FRAME, spacing_m=float(np.hypot(0.4, 7.9))))
    assert str(found) == str(expected)


@pytest.mark.parametrize(
    ("centre", "sigma_m", "low", "high", "back"),
    [
        ((0.08, 0, 8.0), 0.02, 0.001, 0.009, False),  # weighed against the mount
        ((0.08, 0, 8.0), 1e-5, 0.00999, 0.01001, False),
        ((0.08, 0, -8.0), 0.02, -0.009, -0.001, True),
        ((0, 0, -0.05), 0.02, 0.0, 0.0, False),  # may as well go ahead
        ((2.0, 0, 0), 0.02, 0.0, 0.0, False),  # across the view: nothing is said of the direction
        ((2.0, 0, -0.01), 0.02, 0.0, 0.0, False),
        ((0, 2.0, 0), 0.02, 0.0, 0.0, False),
    ],
)
def test_poses_tell_the_direction_as_surely_as_they_are_known(centre, sigma_m, low, high, back):
    found = expect(posed((0, 0, 0), sigma_m=sigma_m), posed(centre, sigma_m=sigma_m)).prior
    assert low - 1e-9 <= found.direction[0] / found.direction[2] <= high + 1e-9
    assert abs(found.direction[2]) > 0.99
    assert (found.direction[2] < 0) == back
    if max(centre[:2]) == 2.0:
        np.testing.assert_allclose(found.sigma_direction, MOUNTED.sigma)
        assert found.length_m == pytest.approx(2.0, abs=1e-3)


def test_a_vehicle_that_stands_falls_back_on_the_spacing():
    still = posed((0, 0, 0))
    assert expect(still, replace(still, spacing_m=8.05)).source == "straight"


@pytest.mark.parametrize(
    ("first", "second"),
    [((38.0, -97.0), (38.00005, -96.99995)), ((-17.0, 179.99999), (-17.0, -179.99999))],
    ids=["", "date line"],
)
def test_the_distance_of_fixes_is_the_geodesic_one(first, second):
    _, _, flat = Geod(ellps="WGS84").inv(*first[::-1], *second[::-1])
    found = fix_distance_m(Fix(*first, 500.0, None), Fix(*second, 500.3, None))
    assert found == pytest.approx(np.hypot(flat, 0.3), rel=5e-3)


def test_fixes_serve_where_there_is_neither_pose_nor_spacing():
    before = replace(FRAME, fix=Fix(38.0, -97.0, 500.0, (1.0, 1.0, 2.0)))
    now = replace(FRAME, fix=Fix(38.00007, -97.0, 500.0, (1.0, 1.0, 2.0)))
    found = expect(before, now)
    assert found.source == "fixes"
    assert found.prior.length_m == pytest.approx(7.78, abs=0.05)
    assert found.prior.sigma_m == pytest.approx(0.2)


@pytest.mark.parametrize("off_deg", [0.0005, 38.0])
def test_fixes_that_jump_further_than_a_vehicle_goes_say_little_of_the_way(off_deg):
    before = replace(FRAME, fix=Fix(38.0, -97.0, 500.0, (1.0, 1.0, 2.0)))
    now = replace(FRAME, fix=Fix(38.00007 + off_deg, -97.0, 500.0, None), log_time_ns=3 * 10**8)
    found = expect(before, now)
    assert found.prior.length_m == pytest.approx(22.5)
    assert found.prior.sigma_m == pytest.approx(22.5)
    untimed = expect(before, replace(now, log_time_ns=0))
    assert untimed.prior.length_m > 50


def test_without_any_source_the_last_speed_is_held_and_its_scatter_grows_with_time():
    soon, late = (expect(FRAME, replace(FRAME, log_time_ns=t), None, 12.0) for t in (10**8, 10**9))
    assert soon.source == late.source == "speed"
    assert (soon.prior.length_m, late.prior.length_m) == pytest.approx((1.2, 12.0))
    assert late.prior.sigma_m == pytest.approx(100 * soon.prior.sigma_m)


def test_no_source_of_the_distance_is_an_error_that_names_the_frame_and_the_option():
    with pytest.raises(InputError, match=r"frame 7.*--spacing"):
        expect(FRAME, FRAME)
