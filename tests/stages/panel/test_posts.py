"""A white panel on posts before a background of its own in each image."""

import cv2
import numpy as np
import pytest

from wayside.pipeline.models.model_folder import ModelFolder
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.models import LinearModel
from wayside.schemas.roadside import Posts
from wayside.stages.panel import POST_FEATURES, measure_posts, register_views
from wayside.stages.panel.posts import KINDS
from wayside.stages.panel.rectification import PanelPlane, PosedImage, usable_views

from ..made_frames import OUTLINE_MODEL, paint

CAMERA = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
RIGHT, UP, AHEAD = 4.0, 1.0, 14.0
"""Of the middle of the panel, from the nearest camera, 2 m above the road."""
ROAD_M = 2.0
PLANE = PanelPlane.across(
    np.array([RIGHT, -UP, AHEAD]), np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
)
MODEL = ModelFolder().read("post.json", LinearModel)
SLANT = AHEAD / np.hypot(AHEAD, RIGHT)
"""The same width is seen so much narrower across the line of sight."""


def polygon(left, top, right, bottom, color, lean=0.0):
    """Right and down of the middle of the panel; `lean` to the right a metre downwards."""
    shift = lean * (bottom - top)
    ends = [(left, top), (right, top), (right + shift, bottom), (left + shift, bottom)]
    return np.array([(RIGHT + x, -UP + y, AHEAD) for x, y in ends]), color


def registered(size, polygons):
    """Three views, the farthest first, of a panel of this width and height with these polygons below."""
    wide, tall = np.array(size) / 2
    face = [polygon(-wide, -tall, wide, tall, (225, 225, 225))]
    face += [polygon(-0.6 * wide, -0.6 * tall, 0.2 * wide, 0.5 * tall, (20, 20, 20))]
    images = []
    for number, behind in enumerate((16.0, 8.0, 0.0)):
        coarse = np.random.default_rng(number).integers(70, 150, (60, 80, 3)).astype(np.uint8)
        image = cv2.resize(coarse, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_CUBIC)
        pose = Pose(np.eye(3), np.array([0.0, 0.0, -behind]))
        for one in (*polygons, face):
            paint(image, pose, CAMERA, one)
        images.append(PosedImage(number, pose, CAMERA, image))
    usable = usable_views(PLANE, np.array(size), images)
    return register_views(PLANE, np.array(size), usable, np.arange(3), OUTLINE_MODEL)


def measured(size, polygons, model=MODEL):
    views = registered(size, polygons)
    return measure_posts(views, views.box, ROAD_M + UP - size[1] / 2, model)


@pytest.mark.parametrize(
    ("size", "places", "width", "lean"),
    [
        ((0.75, 0.9), [0.0], 0.06, 0.0),
        ((0.75, 0.9), [0.03], 0.3, 0.0),
        ((0.9, 0.9), [0.0], 0.1, 0.06),
        ((2.2, 1.2), [-0.65, 0.65], 0.09, 0.0),
        ((3.0, 1.2), [-0.9, 0.0, 0.9], 0.12, -0.03),
    ],
)
def test_the_posts_of_a_panel_are_counted_and_measured(size, places, width, lean):
    below = size[1] / 2
    posts = [
        [polygon(x - width / 2, below, x + width / 2, 3.0, (40, 40, 44), lean)] for x in places
    ]
    found = measured(size, posts)
    assert (found.number, found.views) == (len(places), 2)
    assert found.width_m == pytest.approx(width * SLANT, rel=0.1)
    assert 0 < found.sigma_width_m < 0.2 * width


def test_a_trunk_far_from_the_middle_is_no_post_and_nothing_is_measured_where_none_is_seen():
    size = (0.75, 0.9)
    views = registered(size, [[polygon(0.35, 0.0, 0.5, 3.0, (30, 30, 30))]])
    assert measure_posts(views, views.box, 1.8, MODEL) == Posts()
    assert measure_posts(views, views.box, 0.4, MODEL) == Posts()  # low


def test_a_panel_over_the_road_hangs_from_a_gantry():
    views = registered((0.75, 0.9), [])
    assert measure_posts(views, views.box, 5.2, MODEL) == Posts("gantry")


@pytest.mark.parametrize(
    ("weight", "kinds", "found"),
    [(9, ["wood"], ("wood", 1)), (0, [], ("unknown", 1)), (-9, KINDS, ("unknown", 0))],
)
def test_posts_like_several_kinds_are_of_unknown_kind_and_unlikely_ones_hidden(
    weight, kinds, found
):
    weights = [weight * (name.removesuffix(": constant") in kinds) for name in POST_FEATURES]
    model = LinearModel(POST_FEATURES, np.array(weights, float), "made by hand")
    seen = measured((0.6, 0.9), [[polygon(-0.05, 0.45, 0.05, 3.0, (40, 40, 44))]], model)
    assert (seen.kind, seen.number) == found
    assert seen.probability > 0.9 or seen.kind == "unknown"
