import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wayside.stages.odometry.mount import Mount, common_height, lane_heights

NOTHING = np.zeros((0, 3))
AHEAD = np.array([0.0, 0.0, 1.0])


def step(yaw_deg=0.0, mount_deg=(-1.5, 0.3)):
    """Rotation and direction of an arc driven with a camera whose travel direction is `mount_deg` off its axis."""
    slopes = np.tan(np.radians(mount_deg))
    mount = np.array([*slopes, 1.0]) / np.linalg.norm([*slopes, 1.0])
    half = Rotation.from_euler("y", yaw_deg / 2, degrees=True)
    return (half * half).as_matrix(), half.apply(mount)


def taught(steps, points=NOTHING):
    mount = Mount()
    for rotation, direction in steps:
        mount.learn(rotation, direction, points)
    return mount


@settings(max_examples=30)
@given(st.floats(-8, 8))
def test_the_mount_is_the_same_on_every_arc(yaw_deg):
    curve, straight = taught([step(yaw_deg)]), taught([step()])
    np.testing.assert_allclose(curve.slopes, straight.slopes, atol=1e-6)


def test_before_any_step_the_vehicle_travels_about_straight_ahead():
    travel = Mount().travel
    np.testing.assert_array_equal(travel.direction, [0, 0, 1])
    assert np.degrees(travel.sigma).min() >= 1


def test_the_mount_is_learnt_through_curves_and_in_spite_of_a_wrong_step():
    steps = [step(yaw) for yaw in (0, 2, 4, 4, 1)]
    steps.insert(2, step(0.0, (9.0, -5.0)))
    travel = taught(steps).travel
    slopes = np.degrees(travel.direction[:2] / travel.direction[2])
    np.testing.assert_allclose(slopes, (-1.5, 0.3), atol=0.01)
    assert np.degrees(travel.sigma).max() < 0.5


def test_the_road_is_known_after_enough_points_on_the_lane():
    lane = np.random.default_rng(0).uniform((-2, 1.65, 6), (2, 1.65, 15), (4, 3))
    ahead = [step(0.0, (0.0, 0.0))]
    assert taught(ahead, lane).ground(8.0) is None
    ground = taught(ahead * 4, lane).ground(8.0)
    assert ground is not None
    assert ground.baseline_m == 8.0
    np.testing.assert_allclose(ground.height_m, 1.65)
    np.testing.assert_allclose(ground.down, [0, 1, 0], atol=1e-9)


def road(height=2.1, pitch=0.0, count=30, seed=0):
    """Points of the road before the camera, whose axis points `pitch` below the road's direction."""
    generator = np.random.default_rng(seed)
    flat = generator.uniform((-2.5, height, 6), (2.5, height, 30), (count, 3))
    flat[:, 1] += generator.normal(0, 0.01, count)
    turn = Rotation.from_euler("x", pitch).as_matrix()
    return flat @ turn.T, turn @ AHEAD


def height_of(points, direction):
    return common_height(lane_heights(points, direction))


def test_the_height_is_that_above_the_road_however_the_camera_looks_up_or_down():
    for pitch in (-0.05, 0.0, 0.03):
        assert abs(height_of(*road(1.6, pitch)) - 1.6) < 0.01


def test_things_on_and_beside_the_road_do_not_matter():
    points, direction = road()
    generator = np.random.default_rng(1)
    cars = generator.uniform((-2.5, 0.6, 10), (2.5, 2.0, 30), (15, 3))
    verge = generator.uniform((5, 2.5, 10), (12, 4.0, 30), (60, 3))
    unknown = np.full((4, 3), np.nan)
    assert abs(height_of(np.vstack([cars, points, verge, unknown]), direction) - 2.1) < 0.03


def test_too_few_points_give_no_height():
    assert np.isnan(height_of(*road(count=7)))
    assert np.isnan(common_height(np.zeros(0)))
