import numpy as np

from wayside.stages.odometry.road import common_height, lane_heights, road_down

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


def height_of(points, direction):
    return common_height(lane_heights(points, direction))


def test_the_height_is_that_above_the_points_of_the_road():
    assert abs(height_of(*road()) - 2.1) < 0.01


def test_a_camera_that_looks_up_or_down_gets_the_same_height():
    for pitch in (-0.05, 0.03):
        assert abs(height_of(*road(1.6, pitch)) - 1.6) < 0.01


def test_things_on_and_beside_the_road_do_not_matter():
    points, direction = road()
    generator = np.random.default_rng(1)
    cars = generator.uniform((-2.5, 0.6, 10), (2.5, 2.0, 30), (15, 3))
    verge = generator.uniform((5, 2.5, 10), (12, 4.0, 30), (60, 3))
    unknown = np.full((4, 3), np.nan)
    found = height_of(np.vstack([cars, points, verge, unknown]), direction)
    assert abs(found - 2.1) < 0.03


def test_points_ahead_behind_and_beside_the_lane_are_told_apart():
    points = np.array(
        [[0.0, 2.0, 10], [0.0, 2.0, -10], [5.0, 2.0, 10], [0.0, 2.0, 60], [0, 9.0, 10]]
    )
    assert lane_heights(points, AHEAD).tolist() == [2.0]


def test_too_few_points_give_no_height():
    assert np.isnan(height_of(*road(count=7)))
    assert np.isnan(common_height(np.zeros(0)))


def test_points_that_share_no_height_give_none():
    assert np.isnan(common_height(1.1 ** np.arange(12)))


def test_down_is_at_right_angles_to_the_road():
    direction = np.array([0.1, 0.05, 1.0]) / np.linalg.norm([0.1, 0.05, 1.0])
    down = road_down(direction)
    assert abs(down @ direction) < 1e-12
    assert abs(np.linalg.norm(down) - 1) < 1e-12
    assert down[1] > 0.99
