"""A warning sign in front of a background that is another in each picture: what is alike is the face alone."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from wayside.schemas.frame import Image
from wayside.schemas.settings import TrackSettings
from wayside.stages.geometry.path import FrenetOffset
from wayside.stages.mapping.outline_fit import Face
from wayside.stages.mapping.panel import across_path
from wayside.stages.mapping.panel_views import (
    FEWEST_SAMPLES,
    Drawn,
    aligned,
    register_views,
    usable_views,
    within,
)
from wayside.stages.mapping.window import WindowFrame

MIDDLE = np.array([4.2, -1.1, 44.0])
SIDE = 0.9
METRIC = np.array([SIDE, SIDE])
FINER = 4


def drawn(image, pose, camera, corners, color):
    """Fill a polygon (n, 2), metres right and down of the middle, into a picture FINER times as fine."""
    points = MIDDLE + np.column_stack([np.array(corners) * SIDE / 2, np.zeros(len(corners))])
    local = pose.to_camera(points)
    pixels = local[:, :2] / local[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    at = np.round(((pixels + 0.5) * FINER - 0.5) * 16).astype(np.int32)
    cv2.fillPoly(image, [at], color, shift=4)


def picture_of(moved, *, hidden):
    """A yellow diamond with a black arrow, or what stands in front of it: the same wherever it hides the sign."""
    frame, pose = moved.frame, moved.motion.pose
    camera = frame.camera
    rng = np.random.default_rng(frame.index)
    coarse = rng.integers(20, 235, (60, 80, 3)).astype(np.uint8)
    size = (camera.width * FINER, camera.height * FINER)
    image = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    if hidden:
        drawn(image, pose, camera, [(-2, -2), (2, -2), (2, 2), (-2, 2)], (60, 70, 150))
        drawn(image, pose, camera, [(-0.7, -0.5), (0.6, -0.6), (0.1, 0.7)], (200, 200, 210))
    else:
        drawn(image, pose, camera, [(0, -1), (1, 0), (0, 1), (-1, 0)], (210, 170, 30))
        drawn(
            image, pose, camera, [(-0.1, 0.5), (-0.1, -0.1), (0.1, -0.1), (0.1, 0.5)], (20, 20, 20)
        )
        drawn(image, pose, camera, [(-0.35, -0.05), (0.0, -0.5), (0.3, -0.1)], (20, 20, 20))
    return cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


@pytest.fixture
def held_of(drive):
    """The first four frames, with the sign hidden in some."""

    def make(hidden=()):
        frames = []
        for k, moved in enumerate(drive([], 4)):
            picture = Image(moved.frame, picture_of(moved, hidden=k in hidden), None)
            one = replace(
                moved,
                detections=replace(
                    moved.detections,
                    segmentation=replace(moved.detections.segmentation, image=picture),
                ),
            )
            frames.append(WindowFrame.of(one, one.motion, picture.frame.camera, TrackSettings()))
        return frames

    return make


def registered(held, shown):
    plane = across_path(MIDDLE, held, FrenetOffset(MIDDLE[2], MIDDLE[0], -MIDDLE[1]))
    group = register_views(plane, METRIC, usable_views(plane, METRIC, held), np.array(shown), held)
    return [view.frame for view, _ in group.views]


def test_pictures_look_alike_by_the_face_alone_where_half_of_the_box_is_background(held_of):
    assert registered(held_of(), [0, 1, 2, 3]) == [3, 2, 1, 0]


def test_what_hides_the_panel_in_the_nearest_pictures_is_not_taken_for_it(held_of):
    held = held_of(hidden=(2, 3))
    assert registered(held, [0, 1]) == [1, 0]
    assert registered(held, [0, 1, 2, 3])[:2] == [3, 2]


def test_the_weight_keeps_from_the_edge_of_the_face_by_the_margin():
    face = Face("diamond", np.array([10.0, 10.0, 50.0, 50.0]), 0.0, 1.0, np.ones(2))
    near, far = within(face, (60, 60), 1.0), within(face, (60, 60), 2.4)
    assert near.shape == (60, 60)
    assert near[30, 13:48].all()
    assert near[:11].sum() == near[:, 50:].sum() == near[12:16, 12:16].sum() == 0
    assert far.sum() < near.sum()
    assert far[30, 17:44].all()
    assert within(face, (60, 60), 30.0).sum() == 0


@pytest.mark.parametrize("left", [0, FEWEST_SAMPLES - 1])
def test_views_of_which_hardly_anything_is_left_to_compare_are_not_registered(left):
    grey = np.random.default_rng(4).normal(120, 30, (60, 60))
    view = Drawn(0, 20.0, np.repeat(grey[..., None], 3, axis=2).astype(np.float32), grey)
    weight = np.zeros((60, 60))
    weight.flat[:left] = 1.0
    assert aligned(view, view, weight) is None
    assert aligned(view, view, np.ones((60, 60))) is not None
