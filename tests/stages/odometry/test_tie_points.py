import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Camera
from wayside.schemas.settings import FeatureSettings
from wayside.stages.odometry.features import tie_corners
from wayside.stages.odometry.tie_points import (
    GroundPlane,
    KeypointImage,
    PairMotion,
    register_road,
    register_ties,
)

CAMERA = Camera(900, 700, 800.0, 800.0, 449.5, 349.5)
HEIGHT, BASELINE = 1.6, 6.0


def ground_image(rotation, centre):
    """A road of random blocks under a sky of random blocks, seen by a camera 1.6 m above it."""
    v, u = np.mgrid[0:700, 0:900].astype(float)
    rays = np.stack([(u - 449.5) / 800, (v - 349.5) / 800, np.ones_like(u)], axis=-1) @ rotation.T
    generator = np.random.default_rng(5)
    road, sky = (generator.uniform(30, 225, (400, 400)).astype(np.float32) for _ in range(2))
    below = rays[..., 1] > 0.02
    depth = HEIGHT / np.where(below, rays[..., 1], 1.0)
    x = (rays[..., 0] * depth + centre[0]) / 0.35 + 200
    z = (rays[..., 2] * depth + centre[2]) / 0.7 + 10

    def shown(blocks, u, v):
        maps = u.astype(np.float32), v.astype(np.float32)
        return cv2.remap(blocks, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)

    above = (rays[..., :2] / rays[..., 2:] * 25 + 200).transpose(2, 0, 1)
    grey = np.where(below, shown(road, x, z), 0.5 * shown(sky, *above) + 60)
    return np.clip(grey, 0, 255).astype(np.uint8)


def view(grey):
    return KeypointImage.of_corners(CAMERA, grey, *tie_corners(grey, FeatureSettings()))


@pytest.fixture(scope="module")
def pair():
    rotation = Rotation.from_euler("yx", [0.8, 0.2], degrees=True).as_matrix()
    direction = np.array([0.01, 0.0, 1.0]) / np.linalg.norm([0.01, 0.0, 1.0])
    before = view(ground_image(np.eye(3), np.zeros(3)))
    return before, view(ground_image(rotation, BASELINE * direction)), rotation, direction


def off_px(tied, rotation, direction):
    """Distance of the ties on the road from where they belong."""
    rays = np.c_[(tied.previous - (449.5, 349.5)) / 800, np.ones(len(tied.previous))]
    low = rays[:, 1] > 0.05
    points = rays[low] * (HEIGHT / rays[low, 1])[:, None]
    local = (points - BASELINE * direction) @ rotation
    expected = local[:, :2] / local[:, 2:] * 800 + (449.5, 349.5)
    return np.linalg.norm(tied.current[low] - expected, axis=1)


def test_knowing_the_road_ties_more_of_it_and_places_it_better(pair):
    _, _, rotation, direction = pair
    ground = GroundPlane(np.array([0.0, 1.0, 0.0]), HEIGHT, BASELINE)
    plain = register_ties(PairMotion(*pair))
    warped = register_ties(PairMotion(*pair, ground))
    more = register_road(PairMotion(*pair, ground), ground, warped)
    assert len(more.rows) > 1.25 * len(warped.rows)
    assert (more.rows[len(warped.rows) :] == -1).all()
    off_plain, off_warped = (off_px(t, rotation, direction) for t in (plain, warped))
    assert np.median(off_warped) <= np.median(off_plain)
    # the image is painted without smoothing far texture, which costs some of the exactness
    assert np.median(off_px(more, rotation, direction)) < 0.4


def test_a_match_is_registered_once(pair):
    first = register_ties(PairMotion(*pair))
    second = register_ties(PairMotion(*pair), last=first)
    np.testing.assert_array_equal(first.rows, second.rows)
    np.testing.assert_array_equal(first.current, second.current)
