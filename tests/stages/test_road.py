import numpy as np

from wayside.stages.numerics.road import camera_height

AHEAD = np.array([0.0, 0.0, 1.0])


def road(height=2.1, pitch=0.0, count=30, seed=0):
    """Points of the road before the camera, whose axis points `pitch` below the road's direction."""
    generator = np.random.default_rng(seed)
    flat = np.c_[
        generator.uniform(-2.5, 2.5, count), np.full(count, height), generator.uniform(6, 30, count)
    ]
    flat[:, 1] += generator.normal(0, 0.01, count)
    turn = np.array(
        [
            [1, 0, 0],
            [0, np.cos(pitch), -np.sin(pitch)],
            [0, np.sin(pitch), np.cos(pitch)],
        ]
    )
    return flat @ turn.T, turn @ AHEAD


def test_the_height_is_that_above_the_points_of_the_road():
    points, direction = road()
    assert abs(camera_height(points, direction) - 2.1) < 0.01


def test_a_camera_that_looks_up_or_down_gets_the_same_height():
    for pitch in (-0.05, 0.03):
        points, direction = road(1.6, pitch)
        assert abs(camera_height(points, direction) - 1.6) < 0.01


def test_things_on_and_beside_the_road_do_not_matter():
    points, direction = road()
    generator = np.random.default_rng(1)
    cars = generator.uniform((-2.5, 0.6, 10), (2.5, 2.0, 30), (15, 3))
    verge = generator.uniform((5, 2.5, 10), (12, 4.0, 30), (60, 3))
    unknown = np.full((4, 3), np.nan)
    found = camera_height(np.vstack([cars, points, verge, unknown]), direction)
    assert abs(found - 2.1) < 0.03


def test_too_few_points_give_no_height():
    points, direction = road(count=4)
    assert np.isnan(camera_height(points, direction))
    assert np.isnan(camera_height(np.zeros((0, 3)), direction))


def test_points_that_share_no_height_give_none():
    heights = np.array([0.6, 0.8, 1.1, 1.5, 2.0, 2.7, 3.6])
    points = np.c_[np.zeros(7), heights, np.full(7, 15.0)]
    assert np.isnan(camera_height(points, AHEAD))
