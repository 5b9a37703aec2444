"""SIFT points on candidates, matched from frame to frame, and the midpoint of two rays."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from wayside.schemas.detections import Features
from wayside.schemas.frame import THINNED
from wayside.schemas.settings import TrackSettings
from wayside.stages.report.match import (
    extract_sift,
    match_by_descriptors,
    match_points,
    vote_regions,
)

from ..made_frames import landmarks_of, verdicts_of, with_candidates


def with_sift(item):
    (found,) = extract_sift(iter([item]))
    return found


def test_sift_is_found_inside_the_open_candidates_only(texture, detections_of):
    boxes = [(100, 100, 160, 160), (300, 200, 360, 260)]
    found = with_sift(detections_of(texture(), boxes, ["open", "color"]))
    features = found.features
    assert len(features.sign_points) > 3
    assert features.sign_descriptors.shape == (len(features.sign_points), 128)
    assert (features.sign_rows == 0).all()
    assert np.abs(features.sign_points - 130).max() < 30 + 16


def test_a_point_belongs_to_the_smallest_candidate_around_it_and_to_no_other(
    texture, detections_of
):
    boxes = [(100, 100, 200, 200), (120, 120, 180, 180)]
    features = with_sift(detections_of(texture(), boxes, ["open", "open"])).features
    # SIFT gives a place with two main directions twice, with different descriptors
    told_apart = np.hstack([features.sign_points, features.sign_descriptors])
    assert len(np.unique(told_apart, axis=0)) == len(features.sign_points)
    inner = ((features.sign_points > 120) & (features.sign_points < 179)).all(axis=1)
    assert (features.sign_rows[inner] == 1).all()
    assert (features.sign_rows == 0).any()


def test_an_image_without_pixels_passes_without_points(detections_of):
    found = with_sift(detections_of(None, status=THINNED))
    assert len(found.features.sign_points) == 0


def test_matches_are_those_of_a_brute_force_matcher_with_ratio_test():
    rng = np.random.default_rng(3)
    first = rng.random((60, 128)).astype(np.float32)
    second = np.concatenate([first[20:] + rng.normal(0, 0.05, (40, 128)), rng.random((30, 128))])
    second = second.astype(np.float32)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    forward = matcher.knnMatch(first, second, k=2)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(second, first)}
    wanted = [
        (a.queryIdx, a.trainIdx)
        for a, b in forward
        if a.distance < 0.8 * b.distance and back[a.trainIdx] == a.queryIdx
    ]
    assert [tuple(pair) for pair in match_points(first, second, 0.8)] == wanted
    assert len(wanted) == 40


def test_too_few_descriptors_match_nothing():
    none, one = np.zeros((0, 128), np.float32), np.ones((1, 128), np.float32)
    assert match_points(none, one, 0.8).shape == (0, 2)
    assert match_points(one, one, 0.8).shape == (0, 2)


def test_the_majority_of_points_decides_on_regions():
    pairs = np.array([[0, 0], [1, 1], [2, 2], [3, 3]])
    first = np.array([7, 7, 8, 7], np.int32)
    second = np.array([1, 1, 1, 2], np.int32)
    assert vote_regions(pairs, first, second).tolist() == [[7, 1]]


REPORT = TrackSettings(fewest_views=2)


def run(frames):
    return list(match_by_descriptors(iter(frames), REPORT))


def test_a_panel_is_chained_by_its_key_points_and_placed_by_two_views(panel, drive):
    (place,) = landmarks_of(run(drive([panel(3.5, 1.2, 90.0)], 14)))
    np.testing.assert_allclose(
        place.best_pose.to_world(place.position), [3.5, -1.2, 90.0], atol=0.02
    )
    assert place.verdict == "sign"
    assert len(place.views) > 5
    assert np.isnan([place.score, place.facing_deg, place.sigma_facing_deg]).all()
    assert place.trajectory.shape == (len(place.views) - 1, 2, 4)


def test_a_landmark_is_the_midpoint_of_its_two_nearest_rays(panel, drive):
    frames = drive([panel(3.5, 1.2, 60.0)], 7)
    # rays that pass each other: the last view is moved by two pixels
    ideal = frames[-1].detections.candidates.ideal
    frames[-1] = with_candidates(frames[-1], ideal=ideal + np.array([0.0, 2.0]))
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
    local = np.array([pose.to_camera(point) for pose in poses])
    gaps = camera.fx * (local[:, :2] / local[:, 2:] - rays)  # (7.6)
    e = float(np.square(gaps).sum())  # (7.5)
    assert e > 1
    assert 2 * place.residual_px**2 == pytest.approx(e, rel=1e-6)


def test_a_chain_ends_where_the_next_frame_does_not_show_it(panel, drive):
    tracked = run(drive([panel(3.5, 1.2, 90.0, hidden_in=(5,))], 14))
    assert len(landmarks_of(tracked)) == 2


def test_without_key_points_nothing_is_matched(panel, drive):
    frames = [
        replace(f, detections=replace(f.detections, features=Features.empty()))
        for f in drive([panel(3.5, 1.2, 90.0)], 14)
    ]
    tracked = run(frames)
    assert landmarks_of(tracked) == []
    assert set(verdicts_of(tracked)) == {"unmatched"}


def test_what_does_not_fit_one_point_is_refused_by_its_residual(panel, drive):
    # A panel that hops up and down has key points that match, but rays that pass each other.
    low, high = panel(3.5, 1.2, 60.0), panel(3.5, 2.2, 60.0)
    even, odd = drive([low], 7), drive([high], 7)
    mixed = [(even if i % 2 else odd)[i] for i in range(7)]
    assert {place.verdict for place in landmarks_of(run(mixed))} == {"residual"}
