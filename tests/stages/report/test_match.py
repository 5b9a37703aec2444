"""Descriptors of candidates, matched from frame to frame, and the midpoint of two rays."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from wayside.schemas.detections import Features
from wayside.schemas.frame import THINNED
from wayside.schemas.settings import TrackSettings
from wayside.stages.report.match import FARTHEST, describe_regions, extract_sift, match_segments
from wayside.stages.report.trajectory import trajectory_of

from ..made_frames import (
    Panel,
    detections_of,
    drive,
    landmarks_of,
    made_regions,
    texture,
    verdicts_of,
)


def with_sift(item):
    (found,) = extract_sift(iter([item]))
    return found.features


def test_the_open_candidates_are_described_and_no_other():
    boxes = [(300, 200, 360, 260), (100, 100, 160, 180)]
    item = detections_of(texture(), boxes, ["color", "open"])
    wanted = describe_regions(item.image.grey, item.candidates.regions.select([1]))
    np.testing.assert_array_equal(with_sift(item).sign_descriptors, wanted)


def test_an_image_without_pixels_passes_without_descriptors():
    assert len(with_sift(detections_of(None, status=THINNED)).sign_descriptors) == 0


def apart(grey, box, other_grey, other_box, rgb=(9, 9, 9), area_px=90):
    """Distance of the descriptors of two regions."""
    first = describe_regions(grey, made_regions([box]))
    second = describe_regions(other_grey, made_regions([other_box], rgb, area_px))
    return float(np.linalg.norm(first - second))


ALIKE = 0.39
"""Largest distance of the descriptors of one thing in these tests."""


@pytest.mark.parametrize("scale", [0.5, 0.75, 1.5])
@pytest.mark.parametrize("box", [(200, 150, 240, 180), (60, 60, 260, 300), (4, 8, 22, 40)])
def test_a_region_is_described_alike_at_another_distance_and_brightness(scale, box):
    grey = texture()
    other = cv2.resize(grey // 2 + 60, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    area = round(90 * scale**2)
    assert apart(grey, box, other, np.multiply(box, scale), area_px=area) < ALIKE


def test_another_texture_shape_or_colour_is_described_otherwise():
    grey, box = texture(), (200, 150, 240, 180)
    assert apart(grey, box, grey, (230, 150, 270, 180)) > ALIKE
    assert apart(grey, box, grey, box, area_px=900) > ALIKE
    assert apart(grey, box, grey, box, rgb=(200, 30, 30)) > ALIKE


def test_the_gradients_of_an_edge_stand_in_the_cells_and_the_direction_of_the_edge():
    grey = np.zeros((100, 100), np.uint8)
    grey[:, 50:] = 200  # brighter to the right
    found = describe_regions(grey, made_regions([(40, 40, 60, 60)]))[0, :128].reshape(4, 4, 8)
    assert found.argmax(axis=2)[:, 1:3].tolist() == [[0, 0]] * 4
    assert found[:, 1:3, 3:6].max() == 0


def run(frames):
    return list(match_segments(iter(frames), TrackSettings(fewest_views=2)))


def test_a_panel_is_placed_by_the_views_that_show_it():
    (place,) = landmarks_of(run(drive([Panel(3.5, 1.2, 90.0)], 14)))
    np.testing.assert_allclose(
        place.best_pose.to_world(place.position), [3.5, -1.2, 90.0], atol=0.02
    )
    assert place.verdict == "sign"
    assert len(place.views) > 5
    assert np.isnan([place.score, place.facing_deg, place.sigma_facing_deg]).all()
    assert trajectory_of(*place.trace).shape == (len(place.views) - 1, 2, 4)


def test_a_frame_that_does_not_show_a_panel_does_not_end_its_views():
    (place,) = landmarks_of(run(drive([Panel(3.5, 1.2, 90.0, hidden_in=(5,))], 14)))
    assert len(place.views) > 7


def test_without_descriptors_nothing_is_matched():
    frames = [
        replace(f, detections=replace(f.detections, features=Features.empty()))
        for f in drive([Panel(3.5, 1.2, 90.0)], 14)
    ]
    tracked = run(frames)
    assert landmarks_of(tracked) == []
    assert set(verdicts_of(tracked)) == {"unmatched"}


def test_what_leaves_its_epipolar_line_is_not_matched():
    low, high = Panel(3.5, 1.2, 60.0), Panel(3.5, 2.2, 60.0)
    assert landmarks_of(run([drive([low], 2)[0], drive([high], 2)[1]])) == []


def test_segments_whose_sizes_contradict_their_depths_are_not_matched():
    wide, narrow = drive([Panel(3.5, 1.2, 60.0)], 2), drive([Panel(3.5, 1.2, 60.0, wide=0.4)], 2)
    assert landmarks_of(run([wide[0], narrow[1]])) == []
    assert landmarks_of(run([narrow[0], wide[1]])) == []
    assert len(landmarks_of(run(narrow))) == 1


def test_what_looks_otherwise_in_each_image_is_not_matched():
    frames = drive([Panel(3.5, 1.2, 60.0)], 7)
    for i, frame in enumerate(frames):
        codes = np.full((1, 132), i * FARTHEST, np.float32)
        features = replace(frame.detections.features, sign_descriptors=codes)
        frames[i] = replace(frame, detections=replace(frame.detections, features=features))
    assert landmarks_of(run(frames)) == []


def test_segments_rarer_seen_have_less_evidence():
    few, many = (landmarks_of(run(drive([Panel(3.5, 1.2, 60.0)], images))) for images in (3, 6))
    assert dict(few[0].evidence)["views"] < dict(many[0].evidence)["views"]
