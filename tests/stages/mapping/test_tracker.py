from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping import LandmarkClassifier, SideClassifiers, assemble
from wayside.stages.mapping.landmark import BORDER
from wayside.stages.mapping.tracker import WINDOW_STEP, track
from wayside.stages.report import match_segments

from ..made_frames import Panel, drive, landmarks_of, verdicts_of
from .made_windows import evidence_model

SETTINGS = TrackSettings()
SUREST = LandmarkClassifier(evidence_model(score_best=1.0))
"""By it a landmark is as likely as the best score of its views."""


def run(frames, settings=SETTINGS, classifier=None):
    front = SideClassifiers(landmark=classifier or LandmarkClassifier())
    return list(assemble(track(iter(frames), settings, front)))


def test_a_panel_is_measured_where_it_stands():
    (landmark,) = landmarks_of(run(drive([Panel(3.5, 1.2, 120.0, wide=0.6, tall=0.9)], 20)))
    centre = landmark.best_pose.to_world(landmark.position)
    np.testing.assert_allclose(centre, [3.5, -1.2, 120.0], atol=0.02)
    size = [landmark.width_m / BORDER, landmark.height_m / BORDER]
    np.testing.assert_allclose(size, [0.6, 0.9], rtol=0.01)
    place = [landmark.station_m, landmark.right_m, landmark.above_m]
    np.testing.assert_allclose(place, [120.0, 3.5, 1.2], atol=0.02)
    assert (landmark.verdict, landmark.color, landmark.shape) == ("sign", "yellow", "rectangle")
    assert (np.linalg.eigvalsh(landmark.covariance) > 0).all()
    assert landmark.best_frame == max(view.frame for view in landmark.views)
    assert landmark.best_box[2] <= 1600


@pytest.mark.parametrize("union_score", [2.0, 5.0])
def test_a_sign_and_its_plaque_in_one_box_of_far_images_are_both_found(union_score):
    far, near = tuple(range(7)), tuple(range(7, 20))  # frames 7 to 14 show both boxes
    sign = Panel(3.5, 2.0, 120.0, only_in=near)
    plaque = Panel(3.5, 1.44, 120.0, wide=0.6, tall=0.3, only_in=near)
    union = Panel(3.5, 1.8325, 120.0, tall=1.085, score=union_score, only_in=far)
    landmarks = landmarks_of(run(drive([sign, plaque, union], 20)))
    found = sorted((p for p in landmarks if p.verdict == "sign"), key=lambda p: p.height_m)
    assert [p.height_m for p in found] == pytest.approx([0.3 * BORDER, 0.75 * BORDER], rel=0.02)
    centres = [p.best_pose.to_world(p.position) for p in found]
    np.testing.assert_allclose(centres, [[3.5, -1.44, 120.0], [3.5, -2.0, 120.0]], atol=0.02)
    assert [p.verdict for p in landmarks if p.verdict != "sign"] == ["duplicate"]


@pytest.mark.parametrize("spanning", [(2.0, 2.5), (1.0, 4.0)])
@pytest.mark.parametrize(
    "sides",
    [
        [(1.6, 0.7), (1.6, 0.3), (1.6, 0.3)],  # stacked direction boards
        [(0.75, 0.75), (0.6, 0.3)],  # a sign and its plate
        [(0.3, 0.45), (0.3, 0.45), (0.3, 0.45), (0.3, 0.45)],  # parking plates
    ],
)
def test_panels_that_touch_are_a_row_each_and_none_spans_two(sides, spanning):
    wides, talls = np.array(sides).T
    tops = 3.0 - np.cumsum([0.0, *talls])
    plates = [
        Panel(4.0, top - tall / 2, 120.0, wide=wide, tall=tall, score=5.0)
        for (wide, tall), top in zip(sides, tops[:-1], strict=True)
    ]
    low, high = spanning  # scores of boxes that span two plates, and all
    spans = [
        Panel(4.0, (tops[a] + tops[b]) / 2, 120.0, max(wides[a:b]), tops[a] - tops[b], score=score)
        for a in range(len(sides))
        for b in range(a + 2, len(sides) + 1)
        for score in [high if b - a == len(sides) else low]
    ]
    landmarks = landmarks_of(run(drive(spans + plates, 20), classifier=SUREST))
    signs = [p for p in landmarks if p.verdict == "sign"]
    found = sorted((p.best_pose.to_world(p.position)[1], p.height_m / BORDER) for p in signs)
    wanted = sorted((-one.up, one.tall) for one in plates)
    np.testing.assert_allclose(found, wanted, atol=0.02)
    assert {p.verdict for p in landmarks} <= {"sign", "duplicate"}


def test_a_box_beside_a_face_waits_until_the_more_likely_face_is_passed_too():
    # the middle of the wide box has left the last image of the first window, that of the face has not
    face = Panel(3.5, 1.2, 142.7, score=4.0)
    wide = Panel(4.2, 1.2, 142.7, wide=1.6, score=2.0)
    landmarks = landmarks_of(run(drive([wide, face], 24), classifier=SUREST))
    found = {p.verdict: p.width_m / BORDER for p in landmarks}
    assert found == pytest.approx({"sign": 0.75, "duplicate": 1.6}, rel=0.02)


def test_chevrons_in_a_row_that_hide_part_of_each_other_are_a_row_each():
    # each stands 8 m behind the one before and half a metre farther right: far images show it behind that one
    row = [Panel(2.0 + 0.5 * k, 1.0, 100.0 + 8.0 * k, wide=0.6, tall=0.75) for k in range(5)]
    landmarks = landmarks_of(run(drive(row, 24)))
    assert [p.verdict for p in landmarks] == ["sign"] * 5
    stations = sorted(p.station_m for p in landmarks)
    np.testing.assert_allclose(stations, [one.along for one in row], atol=0.1)


def test_the_inner_field_of_a_panel_is_no_second_panel():
    both = [Panel(3.5, 2.0, 120.0), Panel(3.5, 2.0, 120.0, wide=0.6, tall=0.6, score=1)]
    found = {p.verdict: p.height_m / BORDER for p in landmarks_of(run(drive(both, 20)))}
    assert found == pytest.approx({"sign": 0.75, "duplicate": 0.6}, rel=0.02)


@pytest.mark.parametrize(
    ("right", "along", "speed", "change"),
    [
        (-3.0, 40.0, 8.0, 0.0),  # at the same pace
        (-3.5, 90.0, 2.0, 1.2),  # faster and faster
        (-3.5, 90.0, 4.0, 0.6),
        (-2.5, 200.0, -12.0, 0.0),  # oncoming: it looks small, near and standing in the lane
    ],
)
def test_a_vehicle_is_no_sign(right, along, speed, change):
    vehicle = Panel(right, 0.2, along, wide=1.7, tall=1.3, speed=speed, change=change)
    tracked = run(drive([vehicle], 14))
    assert {p.verdict for p in landmarks_of(tracked)} <= {"moving", "residual", "few_views"}
    if speed < 8:
        assert "moving" in verdicts_of(tracked)


def test_a_gap_of_two_frames_is_bridged():
    (landmark,) = landmarks_of(run(drive([Panel(3.5, 1.2, 120.0, hidden_in=(10, 11))], 20)))
    seen = {view.frame for view in landmark.views}
    assert {9, 12} <= seen
    assert not {10, 11} & seen


def test_a_single_view_is_unmatched_and_two_are_too_few():
    panels = Panel(3.5, 1.2, 120.0, only_in=(10,)), Panel(-4.0, 1.2, 120.0, only_in=(10, 11))
    tracked = run(drive(panels, 20), replace(SETTINGS, fewest_views=3))
    assert landmarks_of(tracked) == []
    assert sorted(verdicts_of(tracked)) == ["few_views", "few_views", "unmatched"]


def test_frames_come_out_once_in_order_with_unused_ones_between():
    tracked = run(drive([Panel(3.5, 1.2, 120.0)], 40, unused=(0, 7, 8, 21, 39)))
    assert [item.frame.index for item in tracked] == list(range(40))
    assert len(landmarks_of(tracked)) == 1
    assert tracked[7].motion is None


def test_a_landmark_comes_with_the_first_frame_it_was_seen_in():
    tracked = run(drive([Panel(3.5, 1.2, 120.0), Panel(-4, 1.2, 170.0)], 30))
    assert len(landmarks_of(tracked)) == 2
    firsts = [(item.frame.index, p.views) for item in tracked for p in item.landmarks]
    assert all(min(view.frame for view in views) == index for index, views in firsts)


def test_a_drive_without_frames_or_candidates_is_no_fault():
    assert run([]) == []
    assert [len(item.candidates) for item in run(drive([], 25))] == [0] * 25


def test_the_input_is_left_as_it_was():
    frames = drive([Panel(3.5, 1.2, 120.0)], 20)
    run(frames)
    assert all((f.detections.candidates.verdict == 0).all() for f in frames)


@pytest.mark.parametrize("follow", [track, match_segments])
def test_no_more_frames_are_held_than_the_window_is_long(follow):
    taken = 0

    def counted():
        nonlocal taken
        for frame in drive([Panel(3.5, 1.2, 8.0 * k + 60.0) for k in range(0, 60, 5)], 60):
            taken += 1
            yield frame

    most = 0
    settings = replace(SETTINGS, fewest_views=2)
    for given, _ in enumerate(follow(counted(), settings), 1):
        most = max(most, taken - given + 1)
    assert most <= SETTINGS.longest + WINDOW_STEP


def test_a_landmark_below_threshold_is_refused_for_its_weakest_term():
    model = evidence_model(-3.0, score_best=0.1, depth_sigma=-9.0)
    model = replace(model, terms=("appearance", "rigidity"))
    tracked = run(drive([Panel(3.5, 1.2, 120.0)], 20), classifier=LandmarkClassifier(model))
    (landmark,) = landmarks_of(tracked)
    ratios = dict(landmark.evidence)
    assert ratios["rigidity"] < ratios["appearance"]
    assert landmark.score == pytest.approx(-3.0 + sum(ratios.values()))
    assert landmark.verdict == "residual"
    assert {"residual"} <= set(verdicts_of(tracked)) <= {"residual", "far_view", "few_views"}


def test_a_face_under_a_box_with_half_of_a_known_one_is_found_in_the_rest():
    plate = Panel(3.5, 2.3, 120.0, wide=0.6, tall=0.4, score=5.0)
    shield = Panel(3.5, 1.8, 120.0, wide=0.6, tall=0.6, score=2.5)
    double = Panel(3.5, 1.94, 120.0, wide=0.6, tall=0.78, score=3.0)
    landmarks = landmarks_of(run(drive([plate, shield, double], 20), classifier=SUREST))
    heights = {round(p.height_m / BORDER, 2): p.verdict for p in landmarks}
    assert heights == {0.4: "sign", 0.78: "duplicate", 0.6: "sign"}


def test_views_of_a_standing_panel_from_before_the_window_do_not_move():
    far = SETTINGS.longest + 4 * WINDOW_STEP
    tracked = run(drive([Panel(3.5, 1.2, 8.0 * far + 6.0)], far + 3))
    (landmark,) = landmarks_of(tracked)
    by_frame = verdicts_of(tracked)
    assert landmark.verdict == "sign"
    assert len(landmark.views) >= SETTINGS.longest
    early = by_frame[: len(by_frame) - len(landmark.views)]
    # the first of all have no earlier one to be paired with
    assert early.count("far_view") >= len(early) - 2
    assert "moving" not in by_frame
