"""Panels seen from behind: what the detector takes for a back, and what tracking makes of it."""

import numpy as np
import pytest

from wayside.schemas.detections import verdict_code
from wayside.schemas.measurement import Alignment, PanelView
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping import LandmarkClassifier, SideClassifiers, assemble, track
from wayside.stages.mapping.panel import Panel, PanelMeasurement, PanelModels

from ..made_frames import OUTLINE_MODEL, drive, landmarks_of, verdicts_of, with_candidates
from ..made_frames import Panel as MadePanel
from .made_windows import evidence_model

BEHIND = SideClassifiers()
NO_PIXELS = np.zeros((1, 1, 3), np.float32)
UNMOVED = Alignment(np.zeros(2), np.ones(2), 1.0, 0.0, 1.0, np.zeros((4, 4)))


def seen_from_behind(frames, faces="score", before_column=1600):
    """The same frames: candidates left of that column may be backs, and are faces as far as `faces` says."""
    made = []
    for one in frames:
        left = one.detections.candidates.center[:, 0] < before_column
        told = {
            "back_score": np.where(left, 2.0, np.nan).astype(np.float32),
            "verdict": np.where(left, verdict_code(faces), 0).astype(np.uint8),
            "score": np.where(left & (faces == "score"), -9.0, 3.0).astype(np.float32),
        }
        made.append(with_candidates(one, **told))
    return made


@pytest.fixture
def frames():
    return drive([MadePanel(-6.0, 1.2, 120.0)], 20)


def test_a_panel_seen_from_behind_is_measured_as_a_back_beside_a_face():
    stand = [MadePanel(3.5, 1.2, 120.0), MadePanel(-6.0, 1.2, 120.0)]
    frames = seen_from_behind(drive(stand, 20), before_column=800)
    tracked = list(assemble(track(iter(frames), TrackSettings(), back=BEHIND)))
    back, face = sorted(landmarks_of(tracked), key=lambda landmark: landmark.right_m)
    assert (back.back, back.color, back.verdict) == (True, None, "sign")
    assert (face.back, face.color, face.verdict) == (False, "yellow", "sign")
    np.testing.assert_allclose(back.best_pose.to_world(back.position), [-6, -1.2, 120], atol=0.02)
    assert set(verdicts_of(tracked)) == {"sign"}


@pytest.mark.parametrize(
    ("outline", "shape"), [("triangle_up", "triangle"), ("diamond", "diamond")]
)
def test_the_shape_of_a_back_is_that_of_the_outline_of_its_panel(
    frames, monkeypatch, outline, shape
):
    def measured(fit, window, offset, method):
        rays, used = fit.seen["ray"][fit.used], fit.used
        views = fit.frames[used], rays, fit.weight_sigma[used], fit.ray_sigma[used]
        sigma = np.full(2, 0.02)
        panel = Panel(fit.point, *views, sigma, fit.metric, sigma, 0.0, 5.0, outline, 0.1)
        return PanelMeasurement((PanelView(0, NO_PIXELS, UNMOVED),) * 3, None, panel)

    monkeypatch.setattr("wayside.stages.mapping.tracker.measure_panel", measured)
    behind = iter(seen_from_behind(frames))
    (landmark,) = landmarks_of(
        track(behind, TrackSettings(), back=BEHIND, panel=PanelModels(OUTLINE_MODEL))
    )
    assert (landmark.color, landmark.shape) == (None, shape)


def test_backs_are_not_tracked_where_no_classifier_of_them_is_given(frames):
    tracked = list(track(iter(seen_from_behind(frames)), TrackSettings()))
    assert landmarks_of(tracked) == []
    assert set(verdicts_of(tracked)) == {"score"}


@pytest.mark.parametrize(("face", "back"), [(1.0, 3.0), (3.0, 1.0)])
def test_what_may_be_face_or_back_is_reported_once_as_the_likelier(frames, face, back):
    behind = iter(seen_from_behind(frames, faces="open"))
    classifiers = [
        SideClassifiers(landmark=LandmarkClassifier(evidence_model(odds))) for odds in (face, back)
    ]
    tracked = list(assemble(track(behind, TrackSettings(), *classifiers)))
    reported = [landmark for landmark in landmarks_of(tracked) if landmark.verdict == "sign"]
    assert [landmark.back for landmark in reported] == [back > face]
    kept = {track for item in tracked for track in item.track_id.tolist()}
    assert kept == {reported[0].track_id}
