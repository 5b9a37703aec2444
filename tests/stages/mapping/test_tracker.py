from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.schemas.models import TreeModel
from wayside.schemas.settings import SiftSettings, TrackSettings
from wayside.stages.mapping import SideClassifiers
from wayside.stages.mapping.association import Sightings
from wayside.stages.mapping.hypotheses import fit_views
from wayside.stages.mapping.landmark import BORDER, FEATURES
from wayside.stages.mapping.tracker import CERTAIN, HOP, SURE, same_face, stands, track
from wayside.stages.report import match_by_descriptors

SETTINGS = TrackSettings()


def places_of(settled):
    return [place for item in settled for place in item.places]


def verdicts_of(settled):
    return [VERDICTS[v] for item in settled for v in item.candidates.verdict]


def run(frames, settings=SETTINGS, judge=None):
    return list(track(iter(frames), settings, SideClassifiers(landmark=judge)))


def test_a_panel_is_placed_where_it_stands(panel, drive):
    frames = drive([panel(3.5, 1.2, 120.0, wide=0.6, tall=0.9)], 20)
    (place,) = places_of(run(frames))
    centre = place.best_pose.to_world(place.position)
    np.testing.assert_allclose(centre, [3.5, -1.2, 120.0], atol=0.02)
    assert place.width_m == pytest.approx(0.6 * BORDER, rel=0.01)
    assert place.height_m == pytest.approx(0.9 * BORDER, rel=0.01)
    assert place.station_m == pytest.approx(120.0, abs=0.02)
    np.testing.assert_allclose(place.offset[:2], [3.5, 1.2], atol=0.01)
    assert place.verdict == "sign"
    assert place.color == "yellow"
    assert place.shape == "rectangle"
    assert (np.linalg.eigvalsh(place.covariance) > 0).all()


def test_the_best_frame_shows_the_panel_largest_and_whole(panel, drive):
    frames = drive([panel(3.5, 1.2, 120.0)], 20)
    (place,) = places_of(run(frames))
    assert place.best_frame == max(view.frame for view in place.views)
    assert place.best_box[2] <= 1600


def test_two_panels_on_one_post_are_both_found(panel, drive):
    frames = drive([panel(3.5, 2.0, 120.0), panel(3.5, 1.2, 120.0)], 20)
    assert len(places_of(run(frames))) == 2


def test_a_plaque_under_a_sign_is_kept(panel, drive):
    frames = drive([panel(3.5, 2.0, 120.0), panel(3.5, 1.4, 120.0, wide=0.6, tall=0.3)], 20)
    heights = sorted(place.height_m for place in places_of(run(frames)))
    assert heights == pytest.approx([0.3 * BORDER, 0.75 * BORDER], rel=0.02)


def test_the_inner_field_of_a_panel_is_no_second_panel(panel, drive):
    frames = drive(
        [panel(3.5, 2.0, 120.0), panel(3.5, 2.0, 120.0, wide=0.6, tall=0.6, score=1)], 20
    )
    settled = run(frames)
    assert [p.verdict for p in places_of(settled)] == ["sign"]
    assert "overlap" in verdicts_of(settled)


def test_a_vehicle_at_the_same_pace_is_no_sign(panel, drive):
    settled = run(drive([panel(-3.0, 0.3, 40.0, wide=1.7, tall=1.3, speed=8.0)], 14))
    assert places_of(settled) == []


@pytest.mark.parametrize(("along", "speed", "change"), [(90.0, 2.0, 1.2), (90.0, 4.0, 0.6)])
def test_a_vehicle_that_changes_its_pace_is_no_sign(panel, drive, along, speed, change):
    vehicle = panel(-3.5, 0.3, along, wide=1.7, tall=1.3, speed=speed, change=change)
    settled = run(drive([vehicle], 14))
    assert not [p for p in places_of(settled) if p.verdict == "sign"]
    assert "moving" in verdicts_of(settled)


def test_what_seems_to_stand_in_the_travelled_lane_moves(panel, drive):
    # An oncoming vehicle at a constant pace looks like something small and near that stands still.
    settled = run(drive([panel(-2.5, 0.1, 200.0, wide=1.7, tall=1.3, speed=-12.0)], 12))
    assert {p.verdict for p in places_of(settled)} == {"moving"}


def test_a_gap_of_two_frames_is_bridged(panel, drive):
    frames = drive([panel(3.5, 1.2, 120.0, hidden_in=(10, 11))], 20)
    (place,) = places_of(run(frames))
    seen = {view.frame for view in place.views}
    assert {9, 12} <= seen
    assert not {10, 11} & seen


def test_a_single_view_is_unmatched_and_two_are_too_few(panel, drive):
    frames = drive(
        [panel(3.5, 1.2, 120.0, only_in=(10,)), panel(-4.0, 1.2, 120.0, only_in=(10, 11))], 20
    )
    settled = run(frames, replace(SETTINGS, fewest_views=3))
    assert places_of(settled) == []
    assert sorted(verdicts_of(settled)) == ["few_views", "few_views", "unmatched"]


def test_every_claimed_candidate_carries_its_track_and_residual(panel, drive):
    settled = run(drive([panel(3.5, 1.2, 120.0)], 20))
    (place,) = places_of(settled)
    by_frame = {item.frame.index: item for item in settled}
    for view in place.views:
        item = by_frame[view.frame]
        assert item.track_id[view.row] == place.track_id
        assert item.residual_px[view.row] == pytest.approx(view.residual_px, abs=1e-5)
        assert VERDICTS[item.candidates.verdict[view.row]] == "sign"


def test_frames_come_out_once_in_order_with_unused_ones_between(panel, drive):
    frames = drive([panel(3.5, 1.2, 120.0)], 40, unused=(0, 7, 8, 21, 39))
    settled = run(frames)
    assert [item.frame.index for item in settled] == list(range(40))
    assert len(places_of(settled)) == 1
    assert settled[7].motion is None


def test_a_place_comes_with_the_first_frame_it_was_seen_in(panel, drive):
    for item in run(drive([panel(3.5, 1.2, 120.0), panel(-4, 1.2, 170.0)], 30)):
        for place in item.places:
            assert min(view.frame for view in place.views) == item.frame.index


def test_a_drive_shorter_than_the_window_is_settled_at_its_end(panel, drive):
    (place,) = places_of(run(drive([panel(3.5, 1.2, 40.0)], 4)))
    assert len(place.views) == 4


def test_a_drive_without_frames_or_candidates_is_no_fault(drive):
    assert run([]) == []
    assert [len(item.candidates) for item in run(drive([], 25))] == [0] * 25


def test_the_same_input_gives_the_same_output(panel, drive):
    frames = drive([panel(3.5, 1.2, 120.0), panel(3.5, 1.9, 120.0), panel(-4, 1, 90.0)], 25)
    one, two = run(frames), run(frames)
    assert repr(places_of(one)) == repr(places_of(two))
    assert verdicts_of(one) == verdicts_of(two)


def test_the_input_is_left_as_it_was(panel, drive):
    frames = drive([panel(3.5, 1.2, 120.0)], 20)
    run(frames)
    assert all((f.detections.candidates.verdict == 0).all() for f in frames)


@pytest.mark.parametrize("follow", [track, partial(match_by_descriptors, sift=SiftSettings())])
def test_no_more_frames_are_held_than_the_window_is_long(panel, drive, follow):
    taken = 0

    def counted():
        nonlocal taken
        for frame in drive([panel(3.5, 1.2, 8.0 * k + 60.0) for k in range(0, 60, 5)], 60):
            taken += 1
            yield frame

    most = 0
    settings = replace(SETTINGS, fewest_views=2)
    for given, _ in enumerate(follow(counted(), settings), 1):
        most = max(most, taken - given + 1)
    assert most <= SETTINGS.longest + HOP


def test_a_place_below_the_judges_bar_is_refused_with_its_candidates(panel, drive):
    settled = run(drive([panel(3.5, 1.2, 120.0)], 20), judge=constant_judge(-3.0))
    (place,) = places_of(settled)
    assert place.verdict == "place_score"
    assert place.score == pytest.approx(-3.0)
    assert "place_score" in verdicts_of(settled)
    assert "sign" not in verdicts_of(settled)


def fit_at(ahead, sigma_ahead):
    """A place 6 m to the right, 1.7 x 0.8 m, seen from two cameras at the origin and 8 m on."""
    cameras = Sightings(
        rotation=np.repeat(np.eye(3)[None], 2, axis=0),
        centre=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 8.0]]),
        focal=np.full(2, 1400.0),
        bounds=np.repeat([[-0.57, -0.43, 0.57, 0.43]], 2, axis=0),
        first=np.array([0, 1, 2]),
        ray=np.array([[6.0, -1.0] / np.float64(ahead), [6.0, -1.0] / np.float64(ahead - 8.0)]),
        size=np.array([[1.7, 0.8] / np.float64(ahead), [1.7, 0.8] / np.float64(ahead - 8.0)]),
        score=np.ones(2),
        whole=np.ones(2, bool),
        leads=np.ones(2, bool),
    )
    fit = fit_views(cameras, np.arange(2), np.arange(2))
    return cameras, replace(fit, covariance=np.diag([0.01, 0.01, sigma_ahead**2]))


@pytest.mark.parametrize(("sigma_ahead", "same"), [(0.5, False), (6.0, True)])
def test_a_place_of_unsure_depth_is_the_face_that_hides_it(sigma_ahead, same):
    cameras, known = fit_at(130.0, 0.3)
    _, unsure = fit_at(110.0, sigma_ahead)
    # On the rays of the known face, nearer.
    unsure = replace(unsure, point=known.point * (110.0 / 130.0))
    assert bool(same_face(cameras, unsure, known)) == same


@pytest.mark.parametrize(("width", "same"), [(1.6, True), (1.0, False)])
def test_half_a_face_is_as_wide_as_the_face_and_a_plaque_under_a_diamond_is_not(width, same):
    cameras, known = fit_at(60.0, 0.1)
    _, other = fit_at(60.0, 0.1)
    # three tenths of it lie in the box of the known face
    below = known.point + np.array([0.0, (0.8 + 0.5) / 2 - 0.3 * 0.5, 0.0])
    other = replace(other, point=below, metric=np.array([width, 0.5]))
    assert bool(same_face(cameras, other, known)) == same


@pytest.mark.parametrize(("alike", "passes"), [(1, False), (2, True)])
def test_few_boxes_stand_where_two_look_alike_though_their_outline_is_of_no_known_shape(
    alike, passes
):
    _, pair = fit_at(130.0, 0.3)
    three = replace(pair, rows=np.arange(3), used=np.ones(3, bool))
    assert stands(three, alike, None, 3, SURE) == passes


class Shown:
    """What `stands` looks at of a measured panel."""

    def __init__(self, residual_px):
        self.residual_px = residual_px


def test_two_boxes_stand_where_as_many_pictures_as_are_asked_for_show_one_panel():
    _, pair = fit_at(130.0, 0.3)
    assert not stands(pair, 3, None, 3, SURE)
    assert not stands(pair, 2, Shown(0.1), 3, SURE)
    assert stands(pair, 3, Shown(0.9), 3, SURE)
    assert stands(pair, 2, Shown(0.1), 2, SURE)


def test_two_pictures_must_meet_nearer_than_three():
    _, pair = fit_at(130.0, 0.3)
    assert not stands(pair, 2, Shown(0.9), 2, SURE)
    assert stands(pair, 3, Shown(0.9), 2, SURE)


def test_two_pictures_of_what_may_be_no_sign_say_nothing_of_standing_still():
    _, pair = fit_at(130.0, 0.3)
    assert not stands(pair, 2, Shown(0.1), 2, SURE - 0.1)
    assert stands(pair, 3, Shown(0.1), 2, SURE - 0.1)


def test_three_views_of_what_is_certainly_a_panel_need_not_look_alike():
    _, pair = fit_at(130.0, 0.3)
    three = replace(pair, rows=np.arange(3))
    assert stands(three, 1, None, 2, CERTAIN)
    assert not stands(three, 1, None, 2, CERTAIN - 0.1)
    assert not stands(three, 1, None, 4, CERTAIN)
    assert not stands(pair, 1, None, 2, CERTAIN)


def constant_judge(value):
    one = np.full((1, 1), -1, np.int32)
    return TreeModel(
        features=FEATURES,
        bias=value,
        feature=np.zeros((1, 1), np.int32),
        split=np.zeros((1, 1), np.float32),
        left=one,
        right=one,
        value=np.zeros((1, 1), np.float32),
        threshold=0.0,
        provenance="test",
    )


FAR = tuple(range(8))


def test_a_sign_and_its_plaque_are_two_though_far_views_show_them_as_one(panel, drive):
    sign = panel(3.5, 2.0, 120.0, wide=0.9, tall=0.9, hidden_in=FAR)
    plaque = panel(3.5, 1.39, 120.0, wide=0.6, tall=0.3, hidden_in=FAR)
    both = panel(3.5, 1.845, 120.0, wide=0.9, tall=1.21, score=4.5)
    heights = sorted(p.height_m for p in places_of(run(drive([sign, plaque, both], 20))))
    assert heights == pytest.approx([0.3 * BORDER, 0.9 * BORDER], rel=0.03)


def test_halves_that_are_no_faces_to_the_judge_leave_the_face_whole(panel, drive):
    upper = panel(3.5, 2.1, 120.0, wide=0.9, tall=0.45, score=-3.5, hidden_in=FAR)
    lower = panel(3.5, 1.65, 120.0, wide=0.9, tall=0.45, score=-3.5, hidden_in=FAR)
    face = panel(3.5, 1.875, 120.0, wide=0.9, tall=0.9, score=4.5)
    (place,) = places_of(run(drive([upper, lower, face], 20)))
    assert place.height_m == pytest.approx(0.9 * BORDER, rel=0.03)


def test_a_face_under_a_box_that_shows_half_of_a_known_one_is_found_in_the_rest(panel, drive):
    plate = panel(3.5, 2.3, 120.0, wide=0.6, tall=0.4, score=5.0)
    shield = panel(3.5, 1.8, 120.0, wide=0.6, tall=0.6, score=2.5)
    double = panel(3.5, 1.94, 120.0, wide=0.6, tall=0.78, score=3.0)
    surest = TreeModel(
        FEATURES,
        0.0,
        np.full((1, 3), FEATURES.index("score_mean"), np.int32),
        np.array([[4, 0, 0]], np.float32),
        np.array([[1, -1, -1]], np.int32),
        np.array([[2, -1, -1]], np.int32),
        np.array([[0, 1, 3]], np.float32),
        0.0,
        "made up: the plate is surer than the rest",
    )
    places = places_of(run(drive([plate, shield, double], 20), judge=surest))
    heights = {round(p.height_m / BORDER, 2): p.verdict for p in places}
    assert heights == {0.4: "sign", 0.78: "duplicate", 0.6: "sign"}
