"""Evidence for landmarks: bounded terms, their sum, and what registered images add."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.model_json import model_from_json, model_to_json
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import MappingSettings
from wayside.stages.mapping import LandmarkClassifier, SideClassifiers
from wayside.stages.mapping.landmark_evidence import (
    EXACT_PX,
    FEATURES,
    FREE_PX,
    registration_agreement,
)
from wayside.stages.mapping.surroundings import UNCOMPARED
from wayside.stages.mapping.tracker import track


class Outlined:
    """A panel as far as agreement needs it."""

    def __init__(self, residual_px):
        self.residual_px = residual_px


def landmark_of(frames, classifier):
    front = SideClassifiers(landmark=classifier)
    (found,) = [p for item in track(iter(frames), MappingSettings(), front) for p in item.landmarks]
    return found


def with_image(posed, grey):
    detections = posed.detections
    image = replace(detections.image, rgb=np.dstack([grey] * 3), grey=grey)
    segmentation = replace(detections.segmentation, image=image)
    return replace(posed, detections=replace(detections, segmentation=segmentation))


def test_the_score_is_the_sum_of_the_terms_and_the_shift(panel, drive, evidence_model):
    model = evidence_model(0.5, log_views=1.0, missed=-2.0)
    landmark = landmark_of(drive([panel(3.5, 1.2, 120.0)], 20), LandmarkClassifier(model))
    named = dict(zip(FEATURES, landmark.features, strict=True))
    expected = {"log_views": named["log_views"], "missed": -2.0 * named["missed"]}
    assert dict(landmark.evidence) == pytest.approx(expected)
    assert landmark.score == pytest.approx(0.5 + sum(expected.values()))


def test_the_features_say_how_a_landmark_was_seen(panel, drive):
    location = GaussianModel(
        "right_up_m", (GaussianClass("c", np.array([3.5, 0.2]), np.eye(2), 9.0, "test", 1),), "test"
    )
    frames = drive([panel(3.5, 1.2, 120.0, wide=0.6, tall=0.9, hidden_in=(11,))], 20)
    landmark = landmark_of(frames, LandmarkClassifier(location=location))
    named = dict(zip(FEATURES, landmark.features, strict=True))
    assert named["log_views"] == pytest.approx(np.log(len(landmark.views)))
    assert named["missed"] == pytest.approx(1 / (1 + len(landmark.views)))
    assert named["log_height"] - named["log_width"] == pytest.approx(np.log(1.5), abs=0.02)
    assert named["color_certainty"] == named["shape_certainty"] == 0
    assert named["place_sigmas"] == pytest.approx(1.0, abs=0.02)
    assert named["size_scatter"] < 0.05
    assert named["agreement"] == 0
    assert named["surroundings"] == UNCOMPARED


def test_the_images_show_whether_its_surroundings_move_with_a_panel(panel, drive, texture):
    """The same image in every frame: what the box of the panel moves over is never twice the same."""
    grey = texture(1200, 1600, contrast=40.0)
    frames = [with_image(frame, grey) for frame in drive([panel(3.5, 1.2, 120.0)], 20)]
    named = dict(zip(FEATURES, landmark_of(frames, LandmarkClassifier()).features, strict=True))
    assert UNCOMPARED != named["surroundings"] < 0.5


@given(value=st.floats(-1e6, 1e6) | st.just(float("nan")))
def test_nothing_outside_what_was_learned_from_says_more_than_its_edge(value, evidence_model):
    model = replace(evidence_model(size_scatter=-3.0), low=np.array([0.5]), high=np.array([2.0]))
    (ratio,) = model.ratios({"size_scatter": value}).values()
    assert -6.0 <= ratio <= -1.5


def test_what_is_not_known_yet_is_taken_for_the_best_case(evidence_model):
    model = replace(evidence_model(agreement=2.0), low=np.array([0.0]), high=np.array([10.0]))
    known = [model.ratios({"agreement": value})["agreement"] for value in (0.0, 5.0, 10.0)]
    assert model.ratios({"agreement": float("nan")})["agreement"] == max(known)


def test_a_model_of_evidence_is_the_same_after_a_file(evidence_model):
    model = evidence_model(0.25, -1.4, 0.5, missed=-0.5, agreement=0.125)
    again = model_from_json(model_to_json(model))
    assert model_to_json(again) == model_to_json(model)
    assert again.terms == model.terms
    np.testing.assert_array_equal(again.weight, model.weight)


@given(st.integers(0, 20), st.floats(0, 100))
def test_images_in_register_never_count_against_a_landmark(registered, size_scatter):
    assert registration_agreement(registered, Outlined(size_scatter)) >= 0


def test_one_image_or_no_panel_agrees_with_nothing():
    assert registration_agreement(1, Outlined(0.0)) == 0
    assert registration_agreement(5, None) == 0


def test_each_coordinate_that_the_point_leaves_over_counts_once():
    pair, three = (registration_agreement(n, Outlined(FREE_PX / np.e)) for n in (2, 3))
    assert pair == pytest.approx(1)
    assert three == pytest.approx(3)
    assert registration_agreement(2, Outlined(FREE_PX)) == 0
    assert registration_agreement(2, Outlined(0.0)) == registration_agreement(2, Outlined(EXACT_PX))
