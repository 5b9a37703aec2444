"""What the views of a landmark say together: evidence for a sign, its colour and shape."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.detections import LEARNED_COLORS
from wayside.schemas.settings import TrackSettings
from wayside.stages.classifiers import evidence_ratios
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping import FEATURES, LandmarkClassifier, SideClassifiers
from wayside.stages.mapping.landmark_evidence import SignPlaces
from wayside.stages.mapping.tracker import track

from ..made_frames import Panel, drive, landmarks_of, texture, with_candidates, with_image
from .made_windows import evidence_model


def landmark_of(frames):
    front = SideClassifiers(landmark=LandmarkClassifier())
    (found,) = landmarks_of(track(iter(frames), TrackSettings(), front))
    return found


def test_the_features_say_how_a_landmark_was_seen():
    frames = drive([Panel(3.5, 1.2, 120.0, wide=0.6, tall=0.9, hidden_in=(11,))], 20)
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


def test_the_images_show_whether_its_surroundings_move_with_a_panel():
    """The same image in every frame: what the box of the panel moves over is never twice the same."""
    grey = texture(1200, 1600, contrast=40.0)
    frames = [
        with_image(frame, np.dstack([grey] * 3)) for frame in drive([Panel(3.5, 1.2, 120.0)], 20)
    ]
    assert dict(zip(FEATURES, landmark_of(frames).features, strict=True))["surroundings"] < 0.5


@given(value=st.floats(-1e6, 1e6))
def test_what_lies_beyond_the_knots_says_as_much_as_the_last(value):
    model = replace(
        evidence_model(size_scatter=1.0),
        knots=(np.array([0.5, 1.0, 2.0]),),
        curves=(np.array([-1.5, -2.0, -6.0]),),
    )
    (ratio,) = evidence_ratios(model, {"size_scatter": value}).values()
    assert -6.0 <= ratio <= -1.5
    (bend,) = evidence_ratios(model, {"size_scatter": 1.5}).values()
    assert bend == pytest.approx(-4.0)


def test_what_is_not_known_says_nothing():
    model = evidence_model(missed=2.0, surroundings=1.0)
    ratios = evidence_ratios(model, {"missed": 3.0, "surroundings": float("nan")})
    assert ratios == {"missed": 6.0, "surroundings": 0.0}


def classified(frames, probabilities):
    """The frames, each view with the `probabilities(index of the frame)` of its colours; None: unclassified."""
    for index, moved in enumerate(frames):
        odds = np.full((len(moved.detections.candidates), len(LEARNED_COLORS)), np.nan, np.float32)
        given = probabilities(index)
        if given is not None:
            odds[:] = -np.inf
            for name, probability in given.items():
                odds[:, LEARNED_COLORS.index(name)] = np.log(probability)
        yield with_candidates(moved, color_log_probability=odds)


FAINT, SURE = {"red": 0.55, "orange": 0.45}, {"red": 0.05, "orange": 0.95}


@pytest.mark.parametrize(
    ("probabilities", "nearest", "expected"),
    [
        (lambda k: SURE if k in (5, 6) else FAINT, "yellow", ("orange", None)),
        (
            lambda k: {"orange": 1.0} if k == 2 else {"red": 0.9, "orange": 0.1},
            "yellow",
            ("red", None),
        ),
        (lambda k: {"blue": 1.0} if k == 6 else None, "yellow", ("blue", None)),  # no other votes
        (lambda k: None, "yellow", ("yellow", 1)),  # no view is classified
        (lambda k: None, None, (None, None)),
    ],
)
def test_all_views_together_name_the_colour_and_without_them_the_nearest_class(
    probabilities, nearest, expected
):
    frames = drive([Panel(5, 1, 75)], 9)
    if nearest is None:
        frames = [
            with_candidates(m, color=np.full_like(m.detections.candidates.color, -1))
            for m in frames
        ]
    landmark = landmark_of(classified(frames, probabilities))
    distance = landmark.color_distance
    assert (landmark.color, None if np.isnan(distance) else distance) == expected
