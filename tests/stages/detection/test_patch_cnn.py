from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import Regions
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.models import ConvolutionModel, TreeModel
from wayside.stages.detection.detector import view_features, view_names, view_odds
from wayside.stages.detection.patch_cnn import (
    FEATURES,
    check_closer,
    closer_odds,
    relative_colors,
    told_of,
)
from wayside.stages.detection.patch_features import INNER, SIDE, drawn_patches
from wayside.stages.imaging import pyramid

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
BOXES = np.array([[40, 40, 60, 60], [200, 100, 240, 160]], np.float32)


def says(feature, near=-1.0):
    """A network that says what it is told of one feature, and nothing of the pixels."""
    column = FEATURES.index(feature)
    samples = SIDE * SIDE
    hidden = np.zeros((samples + len(FEATURES), 2), np.float32)
    hidden[samples + column] = [1, -1]
    none = np.zeros(len(FEATURES), np.float32)
    return ConvolutionModel(
        FEATURES,
        SIDE,
        near,
        0.5,
        100.0,
        (np.zeros((3, 3, 3, 1), np.float32),),
        (np.zeros(1, np.float32),),
        (False,),
        none,
        none + 1,
        hidden,
        np.zeros(2, np.float32),
        np.array([1, -1], np.float32),
        np.zeros((), np.float32),
        "made by hand",
    )


def picture(bright):
    rgb = np.random.default_rng(0).integers(60, 80, (240, 320, 3)).astype(np.uint8)
    x0, y0, x1, y1 = BOXES[1].astype(int)
    rgb[y0:y1, x0:x1] = bright
    return pyramid(rgb)


def regions(box=BOXES):
    n = len(box)
    return Regions(box, np.full(n, 50), np.full((n, 3), 90, np.float32), np.zeros(n, np.uint8))


def test_a_patch_is_the_box_with_its_surroundings():
    patches = drawn_patches(picture(250), BOXES)
    edge = (SIDE - INNER) // 2
    assert patches.shape == (2, SIDE, SIDE, 3)
    assert (patches[1, edge:-edge, edge:-edge] == 250).all()
    assert patches[1, 0].max() < 80


def test_colors_hold_whatever_the_exposure_and_brightness_tells_it():
    patches = drawn_patches(picture(200), BOXES)
    dim = (patches // 2).astype(np.uint8)
    (colors, bright), (dimmer, dark) = relative_colors(patches), relative_colors(dim)
    assert np.abs(colors - dimmer).mean() < 0.1
    assert (bright - dark).mean() == pytest.approx(np.log(2), abs=0.15)
    middle = colors[:, 6:26, 6:26, 0].mean(axis=(1, 2))
    assert middle == pytest.approx(0, abs=1e-5)


def test_the_network_is_told_where_a_box_stands_and_how_bright_it_is():
    levels, none = picture(200), np.zeros(2, np.float32)
    told = told_of(view_names(), view_features(levels, regions(), CAMERA))
    assert told.shape == (2, len(FEATURES) - 1)
    odds = closer_odds(says("log_height"), levels, BOXES, told, none)
    assert odds == pytest.approx(np.log([20 / 300, 60 / 300]), abs=1e-5)
    bright = closer_odds(says("brightness"), levels, BOXES, told, none)
    assert bright[1] == pytest.approx(np.log(200 + 16), abs=1e-4)


def test_trees_and_network_are_both_heard():
    levels = picture(200)
    told = told_of(view_names(), view_features(levels, regions(), CAMERA))
    said = [
        closer_odds(says("log_height"), levels, BOXES, told, np.full(2, trees, np.float32))
        for trees in (1, 3)
    ]
    assert said[1] - said[0] == pytest.approx([1, 1], abs=1e-5)


def test_only_what_is_near_by_the_trees_is_looked_at_closer():
    levels, shown = picture(200), regions()
    values = view_features(levels, shown, CAMERA)
    n = len(view_names())
    trees = TreeModel(view_names(), 0.0, *(np.zeros((1, 1)),) * 5, 0.0, "made by hand")
    first = np.array([-2.0, 2.0], np.float32)
    assert values.shape == (2, n)
    assert view_odds(trees, levels, shown, values, first) is first
    closer = replace(trees, closer=says("log_height"))
    odds = view_odds(closer, levels, shown, values, first)
    assert odds == pytest.approx([-2.0, 1 + np.log(60 / 300)], abs=1e-5)
    assert first.tolist() == [-2.0, 2.0]


@pytest.mark.parametrize("strange", [{"side": 16}, {"features": ("smell",)}])
def test_a_network_that_looks_at_something_else_is_refused(strange):
    with pytest.raises(InputError, match="closer look: wanted a patch of 32"):
        check_closer(replace(says("up"), **strange))
    check_closer(None)
