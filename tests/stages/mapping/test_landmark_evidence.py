"""What the views of a landmark say together: evidence for a sign, its colour and shape."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.detections import COLORS
from wayside.schemas.settings import TrackSettings
from wayside.stages.classifiers import evidence_ratios
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping import FEATURES, LandmarkClassifier, SideClassifiers, SignPlaces
from wayside.stages.mapping.tracker import track


def landmark_of(frames, classifier=None):
    front = SideClassifiers(landmark=classifier or LandmarkClassifier())
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
    landmark = landmark_of(frames)
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
    named = dict(zip(FEATURES, landmark_of(frames).features, strict=True))
    assert named["surroundings"] < 0.5


@given(value=st.floats(-1e6, 1e6))
def test_what_lies_beyond_the_knots_says_as_much_as_the_last(value, evidence_model):
    model = replace(
        evidence_model(size_scatter=1.0),
        knots=(np.array([0.5, 1.0, 2.0]),),
        curves=(np.array([-1.5, -2.0, -6.0]),),
    )
    (ratio,) = evidence_ratios(model, {"size_scatter": value}).values()
    assert -6.0 <= ratio <= -1.5
    (bend,) = evidence_ratios(model, {"size_scatter": 1.5}).values()
    assert bend == pytest.approx(-4.0)


def test_what_is_not_known_says_nothing(evidence_model):
    model = evidence_model(missed=2.0, surroundings=1.0)
    ratios = evidence_ratios(model, {"missed": 3.0, "surroundings": float("nan")})
    assert ratios == {"missed": 6.0, "surroundings": 0.0}


def test_a_model_of_evidence_is_the_same_after_a_file(evidence_model):
    model = evidence_model(0.25, -1.4, 0.5, missed=-0.5, log_place=0.125)
    again = model_from_json(model_to_json(model))
    assert model_to_json(again) == model_to_json(model)
    assert again.terms == model.terms
    np.testing.assert_equal(again.curves, model.curves)


def classified(frames, probabilities):
    """The frames, each view with the `probabilities(index of the frame)` of its colours; None: unclassified."""
    for index, moved in enumerate(frames):
        table = moved.detections.candidates
        odds = np.full((len(table), len(COLORS)), np.nan, np.float32)
        given = probabilities(index)
        if given is not None:
            odds[:] = -np.inf
            for name, probability in given.items():
                odds[:, COLORS.index(name)] = np.log(probability)
        yield with_candidates(moved, color_log_probability=odds)


def with_candidates(posed, **columns):
    table = replace(posed.detections.candidates, **columns)
    return replace(posed, detections=replace(posed.detections, candidates=table))


FAINT, SURE = {"red": 0.55, "orange": 0.45}, {"red": 0.05, "orange": 0.95}


@pytest.mark.parametrize(
    ("probabilities", "color"),
    [
        (lambda k: SURE if k in (5, 6) else FAINT, "orange"),  # all views together decide
        (lambda k: {"orange": 1.0} if k == 2 else {"red": 0.9, "orange": 0.1}, "red"),
        (lambda k: {"blue": 1.0} if k == 6 else None, "blue"),  # the others have no vote
    ],
)
def test_the_probabilities_of_all_views_together_decide(panel, drive, probabilities, color):
    landmark = landmark_of(classified(drive([panel(5, 1, 75)], 9), probabilities))
    assert landmark.color == color
    assert np.isnan(landmark.color_distance)


def test_without_any_classified_view_the_nearest_class_decides(panel, drive):
    landmark = landmark_of(classified(drive([panel(5, 1, 75)], 9), lambda k: None))
    assert (landmark.color, landmark.color_distance) == ("yellow", 1)


def test_views_without_any_class_name_nothing(panel, drive):
    frames = drive([panel(5, 1, 75)], 9)
    none = [np.full_like(moved.detections.candidates.color, -1) for moved in frames]
    unnamed = [with_candidates(m, color=color) for m, color in zip(frames, none, strict=True)]
    landmark = landmark_of(unnamed)
    assert landmark.color is None
    assert np.isnan(landmark.color_distance)
