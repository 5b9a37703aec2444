from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import Regions
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.models import ConvolutionModel, TreeModel
from wayside.stages.detection.box_classifier import BoxClassifier
from wayside.stages.detection.feature_vectors import box_feature_names, box_features
from wayside.stages.detection.patch_cnn import (
    PATCH_CNN_FEATURES,
    patch_log_odds,
    placement_features,
    relative_colors,
)
from wayside.stages.detection.patch_features import INNER, SIDE, drawn_patches
from wayside.stages.imaging import pyramid

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
BOXES = np.array([[40, 40, 60, 60], [200, 100, 240, 160]], np.float32)


def says(feature, near=-1.0):
    """A network whose output is one of its features, whatever the pixels."""
    column = PATCH_CNN_FEATURES.index(feature)
    samples = SIDE * SIDE
    hidden = np.zeros((samples + len(PATCH_CNN_FEATURES), 2), np.float32)
    hidden[samples + column] = [1, -1]
    none = np.zeros(len(PATCH_CNN_FEATURES), np.float32)
    return ConvolutionModel(
        PATCH_CNN_FEATURES,
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


def image(bright):
    rgb = np.random.default_rng(0).integers(60, 80, (240, 320, 3)).astype(np.uint8)
    x0, y0, x1, y1 = BOXES[1].astype(int)
    rgb[y0:y1, x0:x1] = bright
    return pyramid(rgb)


def regions(box=BOXES):
    n = len(box)
    return Regions(box, np.full(n, 50), np.full((n, 3), 90, np.float32), np.zeros(n, np.uint8))


def test_a_patch_is_the_box_with_its_surroundings():
    patches = drawn_patches(image(250), BOXES)
    edge = (SIDE - INNER) // 2
    assert patches.shape == (2, SIDE, SIDE, 3)
    assert (patches[1, edge:-edge, edge:-edge] == 250).all()
    assert patches[1, 0].max() < 80


def test_colors_hold_whatever_the_exposure_and_brightness_tells_it():
    patches = drawn_patches(image(200), BOXES)
    dim = (patches // 2).astype(np.uint8)
    (colors, bright), (dimmer, dark) = relative_colors(patches), relative_colors(dim)
    assert np.abs(colors - dimmer).mean() < 0.1
    assert (bright - dark).mean() == pytest.approx(np.log(2), abs=0.15)
    middle = colors[:, 6:26, 6:26, 0].mean(axis=(1, 2))
    assert middle == pytest.approx(0, abs=1e-5)


def classifier(patch_cnn=None):
    """Trees without any, to be given scores by hand."""
    none, leaf = np.zeros((1, 1)), np.full((1, 1), -1)
    trees = TreeModel(box_feature_names(), 0.0, leaf, none, leaf, leaf, none, 0.0, "made by hand")
    return BoxClassifier(replace(trees, patch_cnn=patch_cnn))


def test_the_network_gets_the_placement_of_a_box_and_its_brightness():
    levels = image(200)
    placement = placement_features(box_features(levels, regions(), CAMERA))
    assert placement.shape == (2, len(PATCH_CNN_FEATURES) - 1)
    patches = drawn_patches(levels, BOXES)
    odds = patch_log_odds(says("log_height"), patches, placement)
    assert odds == pytest.approx(np.log([20 / 300, 60 / 300]), abs=1e-5)
    bright = patch_log_odds(says("brightness"), patches, placement)
    assert bright[1] == pytest.approx(np.log(200 + 16), abs=1e-4)


def test_the_scores_of_trees_and_network_are_added():
    levels = image(200)
    values = box_features(levels, regions(), CAMERA)
    both = classifier(says("log_height"))
    scores = [
        both.combined(levels, regions(), values, np.full(2, trees, np.float32)) for trees in (1, 3)
    ]
    assert scores[1] - scores[0] == pytest.approx([1, 1], abs=1e-5)


def test_the_network_is_evaluated_only_where_the_trees_score_enough():
    levels, shown = image(200), regions()
    values = box_features(levels, shown, CAMERA)
    trees = np.array([-2.0, 2.0], np.float32)
    assert classifier().combined(levels, shown, values, trees) is trees
    scores = classifier(says("log_height")).combined(levels, shown, values, trees)
    assert scores == pytest.approx([-2.0, 1 + np.log(60 / 300)], abs=1e-5)
    assert trees.tolist() == [-2.0, 2.0]


@pytest.mark.parametrize("strange", [{"side": 16}, {"features": ("smell",)}])
def test_a_network_of_other_patches_or_features_is_refused(strange):
    with pytest.raises(InputError, match="patch CNN: wanted"):
        classifier(replace(says("up"), **strange))
