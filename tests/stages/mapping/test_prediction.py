from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import SOURCES, Candidates, verdict_code
from wayside.schemas.models import ScoreModel
from wayside.schemas.settings import TrackSettings
from wayside.stages.detection import BoxClassifier
from wayside.stages.detection.box_network import BoxScores
from wayside.stages.mapping import SideClassifiers, assemble, track
from wayside.stages.mapping.prediction import add_predicted_views, predicted_boxes
from wayside.stages.mapping.window import WindowFrame, candidates_of

from ..made_frames import Panel, drive, landmarks_of, made_regions, with_candidates, with_image
from .made_windows import fitted

SETTINGS = TrackSettings()
RED = (200, 40, 40)


class Reddish:
    """A box network that takes a box for a face if its middle is red."""

    def scores_of_patches(self, patches, box):
        middle = patches[:, 24, 24]
        red = middle[:, 0] > 2.0 * middle[:, 1]
        front = np.where(red, 3.0, -3.0).astype(np.float32)
        none = np.zeros((len(box), 1), np.float32)
        return BoxScores(front, -front, none, none, none)


def reddish(threshold=0.0):
    """A classifier of views by that network."""
    return BoxClassifier(Reddish(), ScoreModel(threshold, "made up"))


def shown(panels, frames):
    """Frames of a drive with images: panels red on grey, those that are hidden from the candidates as well."""
    made = []
    everywhere = [replace(panel, hidden_in=(), only_in=None) for panel in panels]
    for moved, whole in zip(drive(panels, frames), drive(everywhere, frames), strict=True):
        rgb = np.full((1200, 1600, 3), 110, np.uint8)
        for x0, y0, x1, y1 in whole.detections.candidates.regions.box.round().astype(int):
            rgb[y0:y1, x0:x1] = RED
        regions = moved.detections.candidates.regions
        regions = made_regions(regions.box, RED, 100)
        made.append(with_image(with_candidates(moved, regions=regions), rgb))
    return made


def holding(frames):
    return [WindowFrame.of(m, m.motion, m.frame.camera) for m in frames]


def fit_of(held):
    """The landmark of all frames with a candidate."""
    return fitted(candidates_of(held))


@pytest.fixture
def near_only():
    """Frames of a panel without candidates in the first nine."""
    return shown([Panel(3.5, 1.2, 100.0, hidden_in=tuple(range(9)))], 13)


def with_predicted_views(fit, held, classifier):
    (found,) = add_predicted_views([fit], held, {fit.back: classifier})
    return found


def test_the_box_of_a_known_landmark_is_predicted_where_the_panel_stands():
    held = holding(shown([Panel(3.5, 1.2, 100.0, wide=0.6, tall=0.9)], 11))
    fit = fit_of(held)
    for k in (5, 6, 7, 8):
        _, frame, box = predicted_boxes([replace(fit, frames=fit.frames[fit.frames != k])], held)
        assert frame.tolist() == [k]
        np.testing.assert_allclose(box, held[k].candidates.regions.box, atol=0.02)


def test_a_landmark_of_large_scatter_is_not_predicted(near_only):
    held = holding(near_only)
    fit = fit_of(held)
    unsure = replace(fit, covariance=fit.covariance * 1e4)
    landmark, frame, _ = predicted_boxes([unsure, fit], held)
    assert landmark[frame == 6].tolist() == [1]


def test_a_view_too_small_to_be_searched_for_is_not_predicted():
    small = Panel(3.5, 1.2, 100.0, wide=0.2, tall=0.2, hidden_in=tuple(range(9)))
    held = holding(shown([small], 13))
    fit = fit_of(held)
    assert len(with_predicted_views(fit, held, reddish()).rows) == len(fit.rows)


def test_views_without_a_candidate_are_predicted(near_only):
    held = holding(near_only)
    fit = fit_of(held)
    followed = with_predicted_views(fit, held, reddish())
    assert len(followed.rows) > len(fit.rows) + 3
    assert followed.frames.tolist() == sorted(followed.frames.tolist())
    new = ~np.isin(followed.frames, fit.frames)
    assert not followed.used[new].any()
    np.testing.assert_array_equal(followed.point, fit.point)
    for frame in followed.frames[new]:
        sources = held[frame].all_candidates().regions.source
        assert [SOURCES[s] for s in sources] == ["predicted"]
    for frame, row in zip(followed.frames, followed.rows, strict=True):
        x, y, z = held[frame].motion.pose.to_camera(fit.point)
        np.testing.assert_allclose(held[frame].followed["ray"][row], [x / z, y / z], atol=1e-5)


def test_a_predicted_box_is_a_view_only_where_the_classifier_accepts_it(near_only):
    for covered in (3, 5):
        near_only[covered].detections.image.rgb[:] = 110
    held = holding(near_only)
    fit = fit_of(held)
    before = [len(h.followed) for h in held]
    assert with_predicted_views(fit, held, reddish(99.0)).rows.tolist() == fit.rows.tolist()
    assert [len(h.followed) for h in held] == before
    found = with_predicted_views(fit, held, reddish())
    assert {4, 6} <= set(found.frames.tolist())
    assert not {3, 5} & set(found.frames.tolist())


def test_views_of_a_back_are_predicted_by_the_classifier_of_backs(near_only):
    held = holding(near_only)
    fit = fit_of(held)
    behind = replace(reddish(-4.0), back=True)
    found = with_predicted_views(replace(fit, back=True), held, behind)
    new = {held[k].all_candidates().back_score[0] for k in set(found.frames) - set(fit.frames)}
    assert new == {-3}
    (same,) = add_predicted_views([replace(fit, back=True)], held, {False: reddish()})
    assert same.rows.tolist() == fit.rows.tolist()


def test_views_that_were_predicted_are_views_of_the_sign():
    def tracked(classifier):
        frames = shown([Panel(3.5, 1.2, 100.0, only_in=(8, 9, 10, 11))], 18)
        return list(assemble(track(iter(frames), SETTINGS, SideClassifiers(classifier))))

    (alone,) = landmarks_of(tracked(None))
    followed = tracked(reddish())
    (landmark,) = landmarks_of(followed)
    assert len(landmark.views) >= len(alone.views) + 3
    np.testing.assert_array_equal(landmark.position, alone.position)
    for view in landmark.views:
        table = followed[view.frame].candidates
        assert table.verdict[view.row] == verdict_code("sign")
        assert tuple(table.regions.box[view.row].tolist()) == view.box


def tracked_landmarks(panels, frames):
    return landmarks_of(track(iter(shown(panels, frames)), SETTINGS, SideClassifiers(reddish())))


@pytest.mark.parametrize(("score", "found"), [(3.0, 114.0), (9.0, 120.0)])
def test_of_two_points_that_no_image_shows_apart_that_of_more_evidence_stays(score, found):
    # one face that the motion sets 6 m apart: each point predicts the views of the other
    early = Panel(3.0, 1.2, 114.0, wide=1.5, tall=1.5, only_in=tuple(range(4, 10)))
    late = replace(early, along=120.0, only_in=tuple(range(10, 15)), score=score)
    by_verdict = {p.verdict: p for p in tracked_landmarks([early, late], 20)}
    assert by_verdict.keys() == {"duplicate", "sign"}
    assert by_verdict["sign"].station_m == pytest.approx(found, abs=0.3)


def test_two_panels_that_one_image_shows_apart_are_both_found():
    early = Panel(3.0, 1.2, 114.0, wide=1.5, tall=1.5, only_in=(*range(4, 10), 13))
    late = replace(early, along=120.0, only_in=tuple(range(10, 15)))
    assert [p.verdict for p in tracked_landmarks([early, late], 20)] == ["sign", "sign"]


def test_two_views_that_no_third_confirms_are_no_sign():
    found = tracked_landmarks([Panel(3.5, 1.2, 100.0, only_in=(10, 11))], 18)
    assert {p.verdict for p in found} == {"residual"}


def test_joined_tables_fill_what_only_one_of_them_has():
    plain = Candidates.of(made_regions([[1, 2, 9, 12]]))
    color, back = np.zeros((1, 8), np.float32), np.array([1.5], np.float32)
    named = replace(plain, color_log_probability=color, back_score=back)
    both = Candidates.joined([named, plain])
    assert np.isnan(both.color_log_probability).any(axis=1).tolist() == [False, True]
    assert both.shape_log_probability is None
    joined = both, *(Candidates.joined([plain, other]) for other in (named, plain))
    assert [table.back_rows().tolist() for table in joined] == [[0], [1], []]
