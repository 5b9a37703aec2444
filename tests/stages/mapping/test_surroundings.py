"""The surroundings of a board on a wall move with it; around a sign that stands apart they do not."""

import numpy as np
import pytest

from wayside.stages.mapping.surroundings import surroundings_correlation

from ..made_frames import stamp, texture

FOCAL, SIZE, RIGHT, UP = 800.0, 0.8, 6.0, 1.0
DEPTHS = (12.0, 15.0, 19.0, 24.0, 30.0)
PER_METRE = 30


def seen(behind, seed=0):
    """Views of a panel with a plane so far behind it: images, each with its box."""
    wall = texture(900, 2400, seed)
    face = texture(int(SIZE * PER_METRE), int(SIZE * PER_METRE), seed + 1)
    views = []
    for depth in DEPTHS:
        image = np.zeros((480, 1000), np.uint8)
        for plane, far in ((wall, depth + behind), (face, depth)):
            scale = FOCAL / far
            stamp(image, plane, scale / PER_METRE, (300 + scale * RIGHT, 300 - scale * UP))
        centre = np.array([300 + FOCAL * RIGHT / depth, 300 - FOCAL * UP / depth])
        half = FOCAL * SIZE / depth / 2
        views.append((np.dstack([image] * 3), np.concatenate([centre - half, centre + half])))
    return views


@pytest.mark.parametrize("seed", range(3))
def test_a_board_on_a_wall_keeps_its_surroundings(seed):
    assert surroundings_correlation(seen(0.0, seed)) > 0.7


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("behind", [4.0, 40.0])
def test_a_sign_that_stands_apart_does_not(behind, seed):
    assert abs(surroundings_correlation(seen(behind, seed))) < 0.35


def test_boxes_that_are_not_exact_change_little():
    views = seen(0.0)
    views[::2] = [(rgb, box + 0.04 * np.ptp(box[::2])) for rgb, box in views[::2]]
    assert surroundings_correlation(views) > 0.6


def test_plain_surroundings_show_nothing():
    rgb = np.full((480, 1000, 3), 90, np.uint8)
    boxes = [np.array([400.0, 200, 400 + side, 200 + side]) for side in (20, 30, 40)]
    assert surroundings_correlation([(rgb, box) for box in boxes]) == pytest.approx(0)


def test_without_two_whole_views_from_unlike_distances_nothing_is_compared():
    views = seen(0.0)
    cut = [(rgb[:, : int(box[2]) + 2], box) for rgb, box in views]
    for few in (views[:0], views[:1], views[:1] * 4, cut):
        assert np.isnan(surroundings_correlation(few))
