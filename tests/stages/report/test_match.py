"""Descriptors of candidates, matched from frame to frame, and the midpoint of two rays."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from wayside.schemas.detections import Features
from wayside.schemas.frame import THINNED
from wayside.schemas.settings import TrackSettings
from wayside.stages.report.match import (
    FARTHEST,
    describe_regions,
    extract_sift,
    match_by_descriptors,
)

from ..made_frames import landmarks_of, made_regions, verdicts_of, with_candidates


def with_sift(item):
    (found,) = extract_sift(iter([item]))
    return found.features


def test_the_open_candidates_are_described_and_no_other(texture, detections_of):
    boxes = [(300, 200, 360, 260), (100, 100, 160, 180)]
    features = with_sift(detections_of(texture(), boxes, ["color", "open"]))
    assert features.sign_rows.tolist() == [1]
    assert features.sign_points.tolist() == [[129.5, 139.5]]
    assert features.sign_descriptors.shape == (1, 132)


def test_an_image_without_pixels_passes_without_descriptors(detections_of):
    assert len(with_sift(detections_of(None, status=THINNED)).sign_points) == 0


def apart(grey, box, other_grey, other_box, rgb=(9, 9, 9), area_px=90):
    """Distance of the descriptors of two regions."""
    first = describe_regions(grey, made_regions([box]))
    second = describe_regions(other_grey, made_regions([other_box], rgb, area_px))
    return float(np.linalg.norm(first - second))


@pytest.mark.parametrize("scale", [0.5, 0.75, 1.5])
@pytest.mark.parametrize("box", [(200, 150, 240, 180), (60, 60, 260, 300), (4, 8, 22, 40)])
def test_a_region_is_described_alike_at_another_distance_and_brightness(texture, scale, box):
    grey = texture()
    other = cv2.resize(grey // 2 + 60, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    area = round(90 * scale**2)
    assert apart(grey, box, other, np.multiply(box, scale), area_px=area) < FARTHEST


def test_another_texture_shape_or_colour_is_described_otherwise(texture):
    grey, box = texture(), (200, 150, 240, 180)
    assert apart(grey, box, grey, (230, 150, 270, 180)) > FARTHEST
    assert apart(grey, box, grey, box, area_px=900) > FARTHEST
    assert apart(grey, box, grey, box, rgb=(200, 30, 30)) > FARTHEST


def test_the_gradients_of_an_edge_stand_in_the_cells_and_the_direction_of_the_edge():
    grey = np.zeros((100, 100), np.uint8)
    grey[:, 50:] = 200  # brighter to the right
    found = describe_regions(grey, made_regions([(40, 40, 60, 60)]))[0, :128].reshape(4, 4, 8)
    assert found.argmax(axis=2)[:, 1:3].tolist() == [[0, 0]] * 4
    assert found[:, 1:3, 3:6].max() == 0


REPORT = TrackSettings(fewest_views=2)


def run(frames):
    return list(match_by_descriptors(iter(frames), REPORT))


def test_a_panel_is_chained_by_its_descriptors_and_placed_by_two_views(panel, drive):
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


def test_without_descriptors_nothing_is_matched(panel, drive):
    frames = [
        replace(f, detections=replace(f.detections, features=Features.empty()))
        for f in drive([panel(3.5, 1.2, 90.0)], 14)
    ]
    tracked = run(frames)
    assert landmarks_of(tracked) == []
    assert set(verdicts_of(tracked)) == {"unmatched"}


def test_what_leaves_its_epipolar_line_is_not_matched(panel, drive):
    low, high = panel(3.5, 1.2, 60.0), panel(3.5, 2.2, 60.0)  # hops up and down
    even, odd = drive([low], 7), drive([high], 7)
    tracked = run([(even if i % 2 else odd)[i] for i in range(7)])
    assert landmarks_of(tracked) == []


def test_what_shrinks_while_the_camera_comes_nearer_is_not_matched(panel, drive):
    wide, narrow = drive([panel(3.5, 1.2, 60.0)], 2), drive([panel(3.5, 1.2, 60.0, wide=0.5)], 2)
    assert landmarks_of(run([wide[0], narrow[1]])) == []
    assert len(landmarks_of(run([narrow[0], narrow[1]]))) == 1


def test_of_two_that_fit_the_more_alike_is_matched(panel, drive):
    frames = drive([panel(3.5, 1.2, 60.0), panel(3.5, 1.2, 60.0)], 2)
    codes = np.tile(frames[0].detections.features.sign_descriptors[0], (2, 1))
    codes[1, 0] += FARTHEST / 2
    for i, frame in enumerate(frames):
        features = replace(frame.detections.features, sign_descriptors=codes[:: 1 - 2 * i].copy())
        frames[i] = replace(frame, detections=replace(frame.detections, features=features))
    places = landmarks_of(run(frames))
    assert [[view.row for view in place.views] for place in places] == [[0, 1], [1, 0]]
