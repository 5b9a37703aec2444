"""Panels painted into the images of a drive, measured by the tracker."""

import cv2
import numpy as np
import pytest

from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping.landmark import BORDER
from wayside.stages.mapping.panel import PanelModels
from wayside.stages.mapping.tracker import track

from ..made_frames import OUTLINE_MODEL, Panel, drive, landmarks_of, paint, with_image

RIGHT, UP, ALONG, WIDE, TALL = 4.2, 1.1, 120.0, 0.75, 0.9
BLACK, WHITE = (25, 25, 25), (230, 228, 220)
FACE = [
    ((-0.375, -0.45, 0.375, 0.45), WHITE),
    ((-0.362, -0.437, 0.362, 0.437), BLACK),
    ((-0.344, -0.419, 0.344, 0.419), WHITE),
    ((-0.2, -0.33, 0.22, -0.18), BLACK),
    ((-0.2, -0.08, 0.1, 0.07), BLACK),
    ((-0.2, 0.17, 0.2, 0.32), BLACK),
]
"""Rectangles: left, top, right and bottom from the middle, metres."""


def image_of(moved, angle):
    """A white panel with a black line inside its rim and a legend, turned clockwise from above.

    The background is another in each frame.
    """
    camera = moved.frame.camera
    coarse = np.random.default_rng(moved.frame.index).integers(40, 190, (30, 40, 3))
    size = (camera.width, camera.height)
    image = cv2.resize(coarse.astype(np.uint8), size, interpolation=cv2.INTER_CUBIC)
    across = np.array([np.cos(angle), 0, -np.sin(angle)])
    polygons = []
    for (left, top, right, bottom), color in FACE:
        ends = (left, top), (right, top), (right, bottom), (left, bottom)
        corners = [[RIGHT, -UP + down, ALONG] + x * across for x, down in ends]
        polygons.append((np.array(corners), color))
    paint(image, moved.motion.pose, camera, polygons)
    return image


def landmark_of(frames):
    """The one landmark that tracking finds."""
    models = PanelModels(OUTLINE_MODEL)
    (landmark,) = landmarks_of(track(iter(frames), TrackSettings(), panel=models))
    return landmark


@pytest.fixture
def frames():
    """Boxes take the inner field for the panel: 6 % too narrow and too low."""
    return drive([Panel(RIGHT, UP, ALONG, wide=0.94 * WIDE, tall=0.94 * TALL)], 16)


@pytest.mark.parametrize("angle_deg", [-20.0, -12.0, 0.0, 12.0, 20.0])
def test_size_position_and_angle_are_those_of_the_panel(frames, angle_deg):
    landmark = landmark_of([with_image(m, image_of(m, np.radians(angle_deg))) for m in frames])
    assert abs(landmark.facing_deg - angle_deg) < 2.5 * landmark.sigma_facing_deg
    assert abs(landmark.width_m - WIDE) < 2.5 * landmark.sigma_width_m
    assert abs(landmark.height_m - TALL) < 2.5 * landmark.sigma_height_m
    assert landmark.sigma_width_m < 0.15 * WIDE
    if angle_deg:
        assert landmark.facing_deg * angle_deg > 0
        assert landmark.sigma_facing_deg < 7.0
    else:
        assert landmark.facing_deg == pytest.approx(0.0, abs=4.0)
        np.testing.assert_allclose([landmark.width_m, landmark.height_m], [WIDE, TALL], rtol=0.02)
        centre = landmark.best_pose.to_world(landmark.position)
        np.testing.assert_allclose(centre, [RIGHT, -UP, ALONG], atol=0.03)


def test_without_images_the_boxes_are_used(frames):
    landmark = landmark_of(frames)
    assert landmark.width_m == pytest.approx(0.94 * WIDE * BORDER, rel=0.01)
    assert np.isnan([landmark.facing_deg, landmark.sigma_facing_deg]).all()


def test_images_without_a_panel_change_little(frames):
    noise = np.random.default_rng(1).integers(0, 255, (1200, 1600, 3)).astype(np.uint8)
    landmark = landmark_of([with_image(m, noise) for m in frames])
    centre = landmark.best_pose.to_world(landmark.position)
    assert np.abs(centre - [RIGHT, -UP, ALONG]).max() < 1.0
