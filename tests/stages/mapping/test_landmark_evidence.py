"""Evidence for landmarks: what was measured of them, monotone curves, and their sum."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.model_json import model_from_json, model_to_json
from wayside.schemas.settings import TrackSettings
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping import FEATURES, LandmarkClassifier, SideClassifiers, SignPlaces
from wayside.stages.mapping.tracker import track


def landmark_of(frames, classifier):
    front = SideClassifiers(landmark=classifier)
    (found,) = [p for item in track(iter(frames), TrackSettings(), front) for p in item.landmarks]
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
    frames = drive([panel(3.5, 1.2, 120.0, wide=0.6, tall=0.9, hidden_in=(11,))], 20)
    landmark = landmark_of(frames, LandmarkClassifier())
    named = dict(zip(FEATURES, landmark.features, strict=True))
    assert named["log_views"] == pytest.approx(np.log(len(landmark.views)))
    assert named["missed"] == pytest.approx(1 / (1 + len(landmark.views)))
    assert named["log_side"] == pytest.approx(np.log(0.6 * 0.9) / 2, abs=0.1)
    assert named["oversize"] == pytest.approx(max(np.log(landmark.height_m), 0), abs=0.05)
    beside = FrenetOffset(landmark.station_m, landmark.right_m, landmark.above_m)
    assert named["log_place"] == pytest.approx(SignPlaces().log_density(beside), abs=0.05)
    assert named["size_scatter"] < 0.05
    assert np.isnan(named["surroundings"])


def test_the_images_show_whether_its_surroundings_move_with_a_panel(panel, drive, texture):
    """The same image in every frame: what the box of the panel moves over is never twice the same."""
    grey = texture(1200, 1600, contrast=40.0)
    frames = [with_image(frame, grey) for frame in drive([panel(3.5, 1.2, 120.0)], 20)]
    named = dict(zip(FEATURES, landmark_of(frames, LandmarkClassifier()).features, strict=True))
    assert named["surroundings"] < 0.5


@given(value=st.floats(-1e6, 1e6))
def test_what_lies_beyond_the_knots_says_as_much_as_the_last(value, evidence_model):
    model = replace(
        evidence_model(size_scatter=1.0),
        knots=(np.array([0.5, 1.0, 2.0]),),
        curves=(np.array([-1.5, -2.0, -6.0]),),
    )
    (ratio,) = model.ratios({"size_scatter": value}).values()
    assert -6.0 <= ratio <= -1.5
    (bend,) = model.ratios({"size_scatter": 1.5}).values()
    assert bend == pytest.approx(-4.0)


def test_what_is_not_known_says_nothing(evidence_model):
    model = evidence_model(missed=2.0, surroundings=1.0)
    ratios = model.ratios({"missed": 3.0, "surroundings": float("nan")})
    assert ratios == {"missed": 6.0, "surroundings": 0.0}


def test_a_model_of_evidence_is_the_same_after_a_file(evidence_model):
    model = evidence_model(0.25, -1.4, 0.5, missed=-0.5, log_place=0.125)
    again = model_from_json(model_to_json(model))
    assert model_to_json(again) == model_to_json(model)
    assert again.terms == model.terms
    np.testing.assert_equal(again.curves, model.curves)
