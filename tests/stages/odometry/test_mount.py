import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wayside.stages.odometry.mount import Mount, travel_slopes

NOTHING = np.zeros((0, 3))


def step(yaw_deg=0.0, mount_deg=(-1.5, 0.3)):
    """Rotation and direction of an arc driven with a camera whose travel direction is `mount_deg` off its axis."""
    slopes = np.tan(np.radians(mount_deg))
    mount = np.array([*slopes, 1.0]) / np.linalg.norm([*slopes, 1.0])
    half = Rotation.from_euler("y", yaw_deg / 2, degrees=True)
    return (half * half).as_matrix(), half.apply(mount)


def taught(steps, points=NOTHING):
    vehicle = Mount()
    for rotation, direction in steps:
        vehicle.learn(rotation, direction, points)
    return vehicle


@settings(deadline=None, max_examples=30)
@given(st.floats(-8, 8))
def test_the_mount_is_the_same_on_every_arc(yaw_deg):
    np.testing.assert_allclose(travel_slopes(*step(yaw_deg)), travel_slopes(*step()), atol=1e-6)


def test_before_any_step_the_vehicle_travels_about_straight_ahead():
    law = Mount().law
    np.testing.assert_array_equal(law.direction, [0, 0, 1])
    assert np.degrees(law.sigma).min() >= 1


def test_the_mount_is_learnt_through_curves_and_in_spite_of_a_wrong_step():
    steps = [step(yaw) for yaw in (0, 2, 4, 4, 1)]
    steps.insert(2, step(0.0, (9.0, -5.0)))
    law = taught(steps).law
    slopes = np.degrees(law.direction[:2] / law.direction[2])
    np.testing.assert_allclose(slopes, (-1.5, 0.3), atol=0.01)
    assert np.degrees(law.sigma).max() < 0.5


def test_a_step_that_goes_sideways_strays_once_the_mount_is_known():
    aside = step(0.0, (1.5, 0.3))
    assert not Mount().strays(*aside)
    vehicle = taught([step(yaw) for yaw in (0, 1, 2)])
    assert vehicle.strays(*aside)
    assert not vehicle.strays(*step(5.0))


def test_the_road_is_known_after_enough_points_on_the_lane():
    generator = np.random.default_rng(0)
    lane = np.c_[generator.uniform(-2, 2, 4), np.full(4, 1.65), generator.uniform(6, 15, 4)]
    ahead = [step(0.0, (0.0, 0.0))]
    assert taught(ahead, lane).ground(8.0) is None
    ground = taught(ahead * 4, lane).ground(8.0)
    assert ground is not None
    assert ground.baseline_m == 8.0
    np.testing.assert_allclose(ground.height_m, 1.65)
    np.testing.assert_allclose(ground.down, [0, 1, 0], atol=1e-9)
