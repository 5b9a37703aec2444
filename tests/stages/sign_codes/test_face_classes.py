"""The pixels of faces, and the stage that classifies them."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.pipeline.models.model_folder import shipped_models
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.measurement import Alignment, Measurement, PanelView
from wayside.stages.sign_codes import (
    OTHER_FACE,
    PATCH_SIDE,
    FaceClassifier,
    classify_faces,
    face_patch,
    face_samples,
)
from wayside.stages.sign_codes.face_classes import FACE_VIEWS, LEAST_LOG_PROBABILITY

from ...made_landmarks import made_landmark
from ..made_frames import made_image

CLASSES = ("other", "stop", "R2-1 45")
SQUARE = np.array([20.0, 20, 60, 60])
UNKNOWN = {"color_distance": np.nan, "shape_distance": np.nan}
LANDMARK = made_landmark(views=(), height_m=0.76, color="white", shape="rectangle", **UNKNOWN)
"""One whose face nothing classified yet."""


class Linear:
    """A classifier whose scores are sums of the pixels, each by a weight; it is sure of most faces."""

    classes = CLASSES

    def log_probabilities(self, patches):
        weight = np.random.default_rng(3).normal(0, 0.01, (3 * PATCH_SIDE**2, len(CLASSES)))
        scores = patches.reshape(len(patches), -1) @ weight
        return scores - np.logaddexp.reduce(scores, axis=1, keepdims=True)


def pixels(seed=0, side=81):
    return np.random.default_rng(seed).uniform(0, 255, (side, side, 3)).astype(np.float32)


def view(rgb, shift=(0.0, 0.0)):
    return PanelView(4, rgb, Alignment(np.array(shift), np.ones(2), 1, 0, 0.9, np.zeros((4, 4))))


def classified(landmark, *views, face=SQUARE):
    measured = Measurement(landmark.track_id, views, None, "rectangle", face, None)
    frame = made_image(pixels()).frame
    tracked = TrackedFrame(frame, *[None] * 4, 0, (landmark,), measurements=(measured,))
    (seen,) = classify_faces(iter([tracked]), model=Linear())
    return seen.landmarks[0]


def test_a_patch_shows_the_face_whatever_its_size():
    small = np.zeros((60, 60, 3), np.uint8)
    small[20:40, 20:40] = (200, 30, 40)
    large = small.repeat(4, axis=0).repeat(4, axis=1)
    box = np.array([20.0, 20, 40, 40])
    one, other = (face_patch(*seen).astype(int) for seen in ((small, box), (large, 4 * box)))
    assert one.shape == (PATCH_SIDE, PATCH_SIDE, 3)
    assert (one[16, 16] == (200, 30, 40)).all()
    assert np.abs(one - other).mean() < 12


@pytest.mark.parametrize("box", [[-9.0, -9, 5, 5], [70.0, 70, 99, 99], [30.0, 30, 30, 30]])
def test_a_box_at_the_edge_or_without_area_has_a_patch(box):
    assert face_patch(pixels(), np.array(box)).shape == (PATCH_SIDE, PATCH_SIDE, 3)


def test_the_samples_do_not_depend_on_the_exposure():
    patch = np.random.default_rng(1).uniform(60, 110, (1, 32, 32, 3)).astype(np.uint8)
    brighter = (2 * patch.astype(int)).astype(np.uint8)
    assert np.corrcoef(face_samples(patch).ravel(), face_samples(brighter).ravel())[0, 1] > 0.99


def test_a_landmark_has_the_mean_of_its_views_and_one_bad_view_rules_nothing_out():
    views = view(pixels(1)), view(pixels(2))
    found = np.array(classified(LANDMARK, *views).face_log_probability)
    box = np.array([20.5, 20.5, 60.5, 60.5])
    each = Linear().log_probabilities(np.stack([face_patch(v.rgb, box) for v in views]))
    assert each.min() < LEAST_LOG_PROBABILITY
    wanted = np.maximum(each, LEAST_LOG_PROBABILITY).mean(axis=0)
    np.testing.assert_allclose(found, wanted - np.logaddexp.reduce(wanted))


def test_only_the_nearest_views_are_classified_where_they_lie():
    near = pixels(1)
    alone = classified(LANDMARK, view(near)).face_log_probability
    more = classified(LANDMARK, *[view(near)] * FACE_VIEWS, view(pixels(2)))
    np.testing.assert_allclose(more.face_log_probability, alone)
    moved = classified(LANDMARK, view(np.roll(near, 5, axis=1), shift=(5.0, 0.0)))
    np.testing.assert_allclose(moved.face_log_probability, alone)


@pytest.mark.parametrize("light", [1.0, 0.25])
@pytest.mark.parametrize(
    ("named", "ground", "color"),
    [
        *[("blue", (24, 24, 26), "black"), ("blue", (10, 66, 142), "blue")],
        *[("green", (0, 40, 26), "green"), ("white", (24, 24, 26), "white")],
    ],
)
def test_a_blue_face_whose_ground_is_too_dark_for_blue_is_black(named, ground, color, light):
    rgb = np.full((81, 81, 3), ground, np.float32)
    rgb[30:50, 36:44] = 232
    odds = (0.0, *[-5.0] * 7)
    seen = replace(LANDMARK, color=named, color_log_probability=odds)
    found = classified(seen, view(light * rgb))
    assert found.color == color
    assert found.color_log_probability == (() if color == "black" else odds)


def test_a_back_and_a_face_without_outline_stay_as_they_are():
    assert classified(replace(LANDMARK, back=True), view(pixels())).face_log_probability == ()
    assert classified(LANDMARK, view(pixels()), face=None).face_log_probability == ()


def test_the_classifier_that_ships_knows_its_classes_and_their_probabilities():
    model = FaceClassifier(str(shipped_models() / "face_code.onnx"))
    assert OTHER_FACE in model.classes
    assert len(set(model.classes)) == len(model.classes)
    patches = np.random.default_rng(2).integers(0, 256, (5, 32, 32, 3)).astype(np.uint8)
    found = model.log_probabilities(patches)
    assert found.shape == (5, len(model.classes))
    np.testing.assert_allclose(np.exp(found).sum(axis=1), 1)
    np.testing.assert_allclose(model.log_probabilities(patches[2:3])[0], found[2], atol=1e-4)
    assert model.log_probabilities(patches[:0]).shape == (0, len(model.classes))
