"""Panels seen from behind: what the detector takes for a back, and what tracking makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS, verdict_code
from wayside.schemas.measurement import Alignment, PanelView
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping import LandmarkClassifier, SideClassifiers, assemble, track
from wayside.stages.mapping.panel import Panel, PanelMeasurement, box_rays

BEHIND = SideClassifiers()
NO_PIXELS = np.zeros((1, 1, 3), np.float32)
UNMOVED = Alignment(np.zeros(2), np.ones(2), 1.0, 0.0, 1.0, np.zeros((4, 4)))


def seen_from_behind(frames, score, faces="score"):
    """The same frames: all candidates may be backs, and are faces as far as `faces` says."""
    made = []
    for one in frames:
        table = one.detections.candidates
        rows = len(table)
        told = replace(
            table,
            back_score=np.full(rows, score, np.float32),
            verdict=np.full(rows, verdict_code(faces), np.uint8),
            score=np.full(rows, -9.0 if faces == "score" else 3.0, np.float32),
        )
        made.append(replace(one, detections=replace(one.detections, candidates=told)))
    return made


def landmarks_of(tracked):
    return [landmark for item in tracked for landmark in item.landmarks]


def test_a_panel_seen_from_behind_is_measured_as_a_back_without_a_colour(panel, drive):
    frames = seen_from_behind(drive([panel(-6.0, 1.2, 120.0)], 20), 2.0)
    tracked = list(assemble(track(iter(frames), TrackSettings(), back=BEHIND)))
    (landmark,) = landmarks_of(tracked)
    assert landmark.back
    assert landmark.verdict == "sign"
    assert landmark.color is None
    np.testing.assert_allclose(
        landmark.best_pose.to_world(landmark.position), [-6, -1.2, 120], atol=0.02
    )
    verdicts = {VERDICTS[v] for item in tracked for v in item.candidates.verdict}
    assert verdicts == {"sign"}


@pytest.mark.parametrize(
    ("outline", "shape"), [("triangle_up", "triangle"), ("diamond", "diamond")]
)
def test_the_shape_of_a_back_is_that_of_the_outline_of_its_panel(
    panel, drive, monkeypatch, panel_method, outline, shape
):
    def measured(fit, window, offset, method):
        panel = Panel(
            fit.point,
            fit.frames[fit.used],
            box_rays(fit, window),
            fit.weight_sigma[fit.used],
            fit.ray_sigma[fit.used],
            np.full(2, 0.01),
            fit.metric,
            np.full(2, 0.02),
            0.0,
            5.0,
            outline,
            0.1,
        )
        return PanelMeasurement((PanelView(0, NO_PIXELS, UNMOVED),) * 3, None, panel)

    monkeypatch.setattr("wayside.stages.mapping.tracker.measure_panel", measured)
    frames = seen_from_behind(drive([panel(-6.0, 1.2, 120.0)], 20), 2.0)
    (landmark,) = landmarks_of(
        track(iter(frames), TrackSettings(), back=BEHIND, panel=panel_method)
    )
    assert (landmark.color, landmark.shape) == (None, shape)


def test_backs_are_not_tracked_where_no_classifier_of_them_is_given(panel, drive):
    frames = seen_from_behind(drive([panel(-6.0, 1.2, 120.0)], 20), 2.0)
    tracked = list(track(iter(frames), TrackSettings()))
    assert landmarks_of(tracked) == []
    assert {VERDICTS[v] for item in tracked for v in item.candidates.verdict} == {"score"}


@pytest.mark.parametrize(("face", "back"), [(1.0, 3.0), (3.0, 1.0)])
def test_what_may_be_face_or_back_is_reported_once_as_the_likelier(
    panel, drive, evidence_model, face, back
):
    frames = seen_from_behind(drive([panel(-6.0, 1.2, 120.0)], 20), 2.0, faces="open")
    classifiers = [
        SideClassifiers(landmark=LandmarkClassifier(evidence_model(odds))) for odds in (face, back)
    ]
    tracked = list(assemble(track(iter(frames), TrackSettings(), *classifiers)))
    reported = [landmark for landmark in landmarks_of(tracked) if landmark.verdict == "sign"]
    assert [landmark.back for landmark in reported] == [back > face]
    kept = {track for item in tracked for track in item.track_id.tolist()}
    assert kept == {reported[0].track_id}


def test_a_face_and_a_back_apart_are_both_reported(panel, drive):
    stand = [panel(3.5, 1.2, 120.0), panel(-6.0, 1.2, 120.0)]
    frames = []
    for one in drive(stand, 20):
        table = one.detections.candidates
        left = table.center[:, 0] < 800
        told = replace(
            table,
            back_score=np.where(left, 2.0, np.nan).astype(np.float32),
            verdict=np.where(left, verdict_code("score"), 0).astype(np.uint8),
            score=np.where(left, -9, 3).astype(np.float32),
        )
        frames.append(replace(one, detections=replace(one.detections, candidates=told)))
    found = landmarks_of(track(iter(frames), TrackSettings(), back=BEHIND))
    assert sorted((landmark.back, landmark.color) for landmark in found) == [
        (False, "yellow"),
        (True, None),
    ]
