"""A warning sign before another background in each image: only the face correlates."""

import cv2
import numpy as np
import pytest

from wayside.schemas.frame import Camera, Pose
from wayside.stages.panel.outline import FaceOutline
from wayside.stages.panel.rectification import PanelPlane, PosedImage, RectifiedView, usable_views
from wayside.stages.panel.registration import (
    FEWEST_SAMPLES,
    align_view,
    inside_outline,
    register_views,
)

from ..made_frames import OUTLINE_MODEL, drive, paint

MIDDLE = np.array([4.2, -1.1, 44.0])
SIDE = 0.9
METRIC = np.array([SIDE, SIDE])
SIGN = [
    ([(0, -1), (1, 0), (0, 1), (-1, 0)], (210, 170, 30)),
    ([(-0.1, 0.5), (-0.1, -0.1), (0.1, -0.1), (0.1, 0.5)], (20, 20, 20)),
    ([(-0.35, -0.05), (0.0, -0.5), (0.3, -0.1)], (20, 20, 20)),
]
"""A yellow diamond with a black arrow; half sides right and down of the middle."""
HIDING = [
    ([(-2, -2), (2, -2), (2, 2), (-2, 2)], (60, 70, 150)),
    ([(-0.7, -0.5), (0.6, -0.6), (0.1, 0.7)], (200, 200, 210)),
]


def image_of(moved, shown):
    """These polygons where the sign stands, before a background of the frame's own."""
    camera = moved.frame.camera
    coarse = np.random.default_rng(moved.frame.index).integers(20, 235, (60, 80, 3))
    size = (camera.width, camera.height)
    image = cv2.resize(coarse.astype(np.uint8), size, interpolation=cv2.INTER_CUBIC)
    placed = [(MIDDLE + np.c_[np.array(p) * SIDE / 2, np.zeros(len(p))], c) for p, c in shown]
    paint(image, moved.motion.pose, camera, placed)
    return image


def images_of(hidden=()):
    """The first four images, with the sign hidden in some."""
    shown = [HIDING if k in hidden else SIGN for k in range(4)]
    return [
        PosedImage(k, m.motion.pose, m.frame.camera, image_of(m, shown[k]))
        for k, m in enumerate(drive([], 4))
    ]


def registered(images, detected):
    """Numbers of the frames that are registered, the template first."""
    plane = PanelPlane.across(MIDDLE, np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0]))
    usable = usable_views(plane, METRIC, images)
    found = register_views(plane, METRIC, usable, np.array(detected), OUTLINE_MODEL)
    return [view.image.frame for view, _ in found.views]


def test_views_are_registered_by_the_face_alone_where_half_of_the_box_is_background():
    assert registered(images_of(), [0, 1, 2, 3]) == [3, 2, 1, 0]


def test_what_hides_the_panel_in_the_nearest_images_is_not_taken_for_it():
    images = images_of(hidden=(2, 3))
    assert registered(images, [0, 1]) == [1, 0]
    assert registered(images, [0, 1, 2, 3])[:2] == [3, 2]


def test_the_weight_keeps_from_the_edge_of_the_face_by_the_margin():
    face = FaceOutline("diamond", np.array([10.0, 10.0, 50.0, 50.0]), 0.0, 1.0, np.eye(4))
    near, far = inside_outline(face, (60, 60), 1.0), inside_outline(face, (60, 60), 2.4)
    assert near.shape == (60, 60)
    assert near[30, 13:48].all()
    assert near[:11].sum() == near[:, 50:].sum() == near[12:16, 12:16].sum() == 0
    assert far.sum() < near.sum()
    assert far[30, 17:44].all()
    assert inside_outline(face, (60, 60), 30.0).sum() == 0


@pytest.mark.parametrize("left", [0, FEWEST_SAMPLES - 1])
def test_views_of_which_hardly_anything_is_left_to_compare_are_not_registered(left):
    grey = np.random.default_rng(4).normal(120, 30, (60, 60))
    rgb = np.repeat(grey[..., None], 3, axis=2)
    pose = Pose(np.eye(3), np.zeros(3))
    image = PosedImage(0, pose, Camera(60, 60, 50.0, 50.0, 29.5, 29.5), rgb.astype(np.uint8))
    view = RectifiedView(image, 20.0, image.rgb, grey.astype(np.float32))
    weight = np.zeros((60, 60), np.float32)
    weight.flat[:left] = 1.0
    assert align_view(view, view, weight) is None
    assert align_view(view, view, np.ones_like(weight)) is not None
