"""Colour and shape of a landmark by the votes of its views, on exact scenes."""

from dataclasses import replace

import numpy as np

from wayside.schemas.detections import COLORS
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping.tracker import track


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
        yield replace(
            moved,
            detections=replace(
                moved.detections, candidates=replace(table, color_log_probability=odds)
            ),
        )


def landmark_of(frames):
    (landmark,) = [
        one for tracked in track(iter(frames), TrackSettings()) for one in tracked.landmarks
    ]
    return landmark


def color_of(frames):
    return landmark_of(frames).color


def test_the_probabilities_of_all_views_together_decide(panel, drive):
    frames = drive([panel(5, 1, 75)], 9)
    faint = {"red": 0.55, "orange": 0.45}
    sure = {"red": 0.05, "orange": 0.95}
    assert color_of(classified(frames, lambda k: sure if k in (5, 6) else faint)) == "orange"


def test_one_sure_view_rules_nothing_out(panel, drive):
    frames = drive([panel(5, 1, 75)], 9)
    others = {"red": 0.9, "orange": 0.1}
    assert color_of(classified(frames, lambda k: {"orange": 1.0} if k == 2 else others)) == "red"


def test_unclassified_views_have_no_vote(panel, drive):
    frames = drive([panel(5, 1, 75)], 9)
    assert color_of(classified(frames, lambda k: {"blue": 1.0} if k == 6 else None)) == "blue"


def test_without_any_classified_view_the_nearest_class_decides(panel, drive):
    landmark = landmark_of(classified(drive([panel(5, 1, 75)], 9), lambda k: None))
    assert landmark.color == "yellow"
    assert landmark.color_distance == 1


def test_a_class_by_probabilities_has_no_distance(panel, drive):
    frames = classified(drive([panel(5, 1, 75)], 9), lambda k: {"yellow": 1.0})
    assert np.isnan(landmark_of(frames).color_distance)


def test_views_without_any_class_name_nothing(panel, drive):
    frames = [
        replace(
            moved,
            detections=replace(
                moved.detections,
                candidates=replace(
                    moved.detections.candidates,
                    color=np.full_like(moved.detections.candidates.color, -1),
                ),
            ),
        )
        for moved in drive([panel(5, 1, 75)], 9)
    ]
    landmark = landmark_of(frames)
    assert landmark.color is None
    assert np.isnan(landmark.color_distance)
