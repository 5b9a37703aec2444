from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping.tracker import track
from wayside.stages.report.match import match_by_descriptors

REPORT = TrackSettings(fewest_views=2)


def run(frames):
    return list(match_by_descriptors(iter(frames), REPORT))


def landmarks_of(tracked):
    return [place for item in tracked for place in item.landmarks]


def test_a_panel_is_chained_by_its_key_points_and_placed_by_two_views(panel, drive):
    (place,) = landmarks_of(run(drive([panel(3.5, 1.2, 90.0)], 14)))
    np.testing.assert_allclose(
        place.best_pose.to_world(place.position), [3.5, -1.2, 90.0], atol=0.02
    )
    assert place.verdict == "sign"
    assert len(place.views) > 5


def test_a_landmark_is_the_midpoint_of_its_two_nearest_rays(panel, drive):
    frames = drive([panel(3.5, 1.2, 60.0)], 7)
    # rays that pass each other: the last view is moved by two pixels
    last = frames[-1].detections
    moved = replace(last.candidates, ideal=last.candidates.ideal + np.array([0.0, 2.0]))
    frames[-1] = replace(frames[-1], detections=replace(last, candidates=moved))
    tracked = run(frames)
    (place,) = landmarks_of(tracked)
    views, camera = place.views[-2:], frames[0].frame.camera
    poses = [tracked[view.frame].motion.pose for view in views]
    rays = [((v.u_px - camera.cx) / camera.fx, (v.v_px - camera.cy) / camera.fy) for v in views]
    q1, q2 = (p.rotation @ np.array([*r, 1.0]) for p, r in zip(poses, rays, strict=True))
    c1, c2 = (pose.centre for pose in poses)
    q3 = np.cross(q1, q2)  # (7.1)
    g1, _, g3 = np.linalg.solve(np.stack([q1, -q2, q3], axis=1), c2 - c1)  # (7.2), (7.3)
    point = c1 + g1 * q1 + g3 / 2 * q3  # (7.4)
    np.testing.assert_allclose(place.best_pose.to_world(place.position), point, atol=1e-6)
    local = [pose.to_camera(point) for pose in poses]
    gaps = [
        camera.fx * (p[:2] / p[2] - np.array(r)) for p, r in zip(local, rays, strict=True)
    ]  # (7.6)
    e = float(np.square(gaps).sum())  # (7.5)
    assert e > 1
    assert 2 * place.residual_px**2 == pytest.approx(e, rel=1e-6)


def test_confidence_and_facing_are_unknown_and_a_trajectory_is_kept(panel, drive):
    (place,) = landmarks_of(run(drive([panel(3.5, 1.2, 90.0)], 14)))
    assert np.isnan([place.score, place.facing_deg, place.sigma_facing_deg]).all()
    assert place.trajectory.shape == (len(place.views) - 1, 2, 4)
    assert np.isfinite(place.trajectory).all()


def test_two_views_suffice(panel, drive):
    (place,) = landmarks_of(run(drive([panel(3.5, 1.2, 90.0, only_in=(6, 7))], 14)))
    assert len(place.views) == 2


def test_a_chain_ends_where_the_next_frame_does_not_show_it(panel, drive):
    tracked = run(drive([panel(3.5, 1.2, 90.0, hidden_in=(5,))], 14))
    assert len(landmarks_of(tracked)) == 2


def test_without_key_points_nothing_is_matched(panel, drive):
    frames = drive([panel(3.5, 1.2, 90.0)], 14)
    blank = frames[0].detections.features
    blank = replace(
        blank,
        sign_points=np.zeros((0, 2), np.float32),
        sign_descriptors=np.zeros((0, 128), np.float32),
        sign_rows=np.zeros(0, np.int32),
    )
    tracked = run([replace(f, detections=replace(f.detections, features=blank)) for f in frames])
    assert landmarks_of(tracked) == []
    assert {VERDICTS[v] for item in tracked for v in item.candidates.verdict} == {"unmatched"}


def test_what_does_not_fit_one_point_is_refused_by_its_residual(panel, drive):
    # A panel that hops up and down has key points that match, but rays that pass each other.
    low, high = panel(3.5, 1.2, 60.0), panel(3.5, 2.2, 60.0)
    even, odd = drive([low], 7), drive([high], 7)
    mixed = [(even if i % 2 else odd)[i] for i in range(7)]
    assert {place.verdict for place in landmarks_of(run(mixed))} == {"residual"}


def test_frames_come_out_once_in_order(panel, drive):
    frames = drive([panel(3.5, 1.2, 90.0), panel(-4.0, 1.0, 150.0)], 30, unused=(3, 4, 29))
    assert [item.frame.index for item in run(frames)] == list(range(30))


@pytest.mark.parametrize("follow", [track, match_by_descriptors])
def test_both_ways_of_matching_agree_on_a_clear_panel(panel, drive, follow):
    frames = drive([panel(3.5, 1.2, 90.0)], 14)
    (place,) = landmarks_of(list(follow(iter(frames), REPORT)))
    assert place.station_m == pytest.approx(90.0, abs=0.05)
