"""Panels rendered into the images of a drive by exact homographies, measured by the tracker."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from wayside.schemas.frame import Image
from wayside.schemas.settings import TrackSettings
from wayside.stages.geometry.path import FrenetOffset
from wayside.stages.mapping.landmark import BORDER, FACING_SIGMA_DEG
from wayside.stages.mapping.panel import across_path
from wayside.stages.mapping.tracker import track
from wayside.stages.mapping.window import WindowFrame

RIGHT, UP, ALONG, WIDE, TALL = 4.2, 1.1, 120.0, 0.75, 0.9
TEXTURE_PX = 400


def texture():
    """A white panel with a black line inside its rim and a legend, TEXTURE_PX a metre."""
    rows, columns = round(TALL * TEXTURE_PX), round(WIDE * TEXTURE_PX)
    image = np.full((rows, columns, 3), (230, 228, 220), np.uint8)
    inset, line = round(0.022 * TEXTURE_PX), round(0.018 * TEXTURE_PX)
    cv2.rectangle(image, (inset, inset), (columns - inset, rows - inset), (25, 25, 25), line)
    for row, text in enumerate(("SPEED", "LIMIT", "55")):
        cv2.putText(image, text, (45, 110 + 100 * row), 0, 2.2, (25, 25, 25), 9, cv2.LINE_AA)
    return image


def image_of(moved, angle):
    """The panel, turned clockwise from above, before a background that is another in each frame."""
    frame, pose = moved.frame, moved.motion.pose
    camera = frame.camera
    rng = np.random.default_rng(frame.index)
    coarse = rng.integers(40, 190, (30, 40, 3)).astype(np.uint8)
    image = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    across = np.array([np.cos(angle), 0, -np.sin(angle)]) * WIDE / 2
    below = np.array([0, TALL / 2, 0])
    middle = np.array([RIGHT, -UP, ALONG])
    corners = pose.to_camera(
        np.array([middle + a * across + b * below for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    )
    if corners[:, 2].min() < 3:
        return image
    pixels = corners[:, :2] / corners[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    face = texture()
    rows, columns = face.shape[:2]
    # drawn four times as large and shrunk, so that edges are soft as a camera's are
    ends = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float32) - 0.5
    left, top = np.floor(pixels.min(axis=0)).astype(int) - 4
    right, bottom = np.ceil(pixels.max(axis=0)).astype(int) + 5
    left, top = max(left, 0), max(top, 0)
    right, bottom = min(right, camera.width), min(bottom, camera.height)
    if right - left < 8 or bottom - top < 8:
        return image
    large = cv2.resize(image[top:bottom, left:right], None, fx=4, fy=4)
    target = ((pixels - (left, top) + 0.5) * 4 - 0.5).astype(np.float32)
    homography = cv2.getPerspectiveTransform(ends, target)
    size = (large.shape[1], large.shape[0])
    drawn = cv2.warpPerspective(face, homography, size, flags=cv2.INTER_AREA)
    cover = (
        cv2.warpPerspective(np.full(face.shape[:2], 255, np.uint8), homography, size)[..., None]
        / 255
    )
    mixed = (cover * drawn + (1 - cover) * large).astype(np.uint8)
    shown = cv2.resize(mixed, (right - left, bottom - top), interpolation=cv2.INTER_AREA)
    image[top:bottom, left:right] = shown
    return image


@pytest.fixture
def landmark_of(panel_method):
    """The one landmark that tracking finds, its panel rotated clockwise from above."""
    return partial(measured, method=panel_method)


def measured(frames, angle=0.0, *, images=True, method):
    if images:
        frames = [
            replace(
                m,
                detections=replace(
                    m.detections,
                    segmentation=replace(
                        m.detections.segmentation, image=Image(m.frame, image_of(m, angle), None)
                    ),
                ),
            )
            for m in frames
        ]
    (landmark,) = [
        p for item in track(iter(frames), TrackSettings(), panel=method) for p in item.landmarks
    ]
    return landmark


@pytest.fixture
def frames(panel, drive):
    """Boxes take the inner field for the panel: 6 % too narrow and too low."""
    return drive([panel(RIGHT, UP, ALONG, wide=0.94 * WIDE, tall=0.94 * TALL)], 16)


def test_size_and_position_are_those_of_the_outer_edge(landmark_of, frames):
    landmark = landmark_of(frames)
    assert landmark.width_m == pytest.approx(WIDE, rel=0.02)
    assert landmark.height_m == pytest.approx(TALL, rel=0.02)
    centre = landmark.best_pose.to_world(landmark.position)
    np.testing.assert_allclose(centre, [RIGHT, -UP, ALONG], atol=0.03)
    assert landmark.facing_deg == pytest.approx(0.0, abs=4.0)


@pytest.mark.parametrize("angle_deg", [-20.0, -12.0, 12.0, 20.0])
def test_a_rotated_panel_is_as_near_as_its_scatter_says(landmark_of, frames, angle_deg):
    landmark = landmark_of(frames, np.radians(angle_deg))
    assert landmark.facing_deg * angle_deg > 0
    assert landmark.sigma_facing_deg < 7.0
    assert abs(landmark.facing_deg - angle_deg) < 2.5 * landmark.sigma_facing_deg
    assert abs(landmark.width_m - WIDE) < 2.5 * landmark.sigma_width_m
    assert abs(landmark.height_m - TALL) < 2.5 * landmark.sigma_height_m
    assert landmark.sigma_width_m < 0.15 * WIDE


def test_without_images_the_boxes_are_used(landmark_of, frames):
    landmark = landmark_of(frames, images=False)
    assert landmark.width_m == pytest.approx(0.94 * WIDE * BORDER, rel=0.01)
    assert landmark.facing_deg == 0.0
    assert landmark.sigma_facing_deg == FACING_SIGMA_DEG


def test_images_without_a_panel_change_little(landmark_of, frames):
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 255, (1200, 1600, 3)).astype(np.uint8)
    blank = [
        replace(
            m,
            detections=replace(
                m.detections,
                segmentation=replace(m.detections.segmentation, image=Image(m.frame, noise, None)),
            ),
        )
        for m in frames
    ]
    landmark = landmark_of(blank, images=False)
    centre = landmark.best_pose.to_world(landmark.position)
    assert np.abs(centre - [RIGHT, -UP, ALONG]).max() < 1.0


def test_the_plane_stands_across_the_path(frames):
    held = [WindowFrame.of(m, m.motion, m.frame.camera) for m in frames[:5]]
    plane = across_path(np.array([3.0, -1.0, 20.0]), held, FrenetOffset(20.0, 3.0, 1.0))
    np.testing.assert_allclose(plane.right, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(plane.down, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(plane.ahead, [0, 0, 1], atol=1e-12)
