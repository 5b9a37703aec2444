"""Which places are in view of a camera, and what images tell of the distance of what shows there."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from wayside.schemas.frame import Camera
from wayside.schemas.settings.merging import ChangeSettings, MergeSettings
from wayside.stages.geometry import distort_points, ideal_points
from wayside.stages.inventory import (
    PanelPlaces,
    PlaceImage,
    gone_probability,
    measure_occlusion,
    views_of,
)

CAMERA = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
NORTH = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.mark.parametrize(
    ("place", "bearing_deg", "count"),
    [
        ((4, 30, 2), 180, 1),  # 35 px high, its face to the camera
        ((4, 90, 2), 180, 0),  # 12 px
        ((4, -30, 2), 180, 0),  # behind
        ((25, 30, 2), 180, 0),  # beside the image
        ((4, 30, 2), 0, 0),  # from behind
        ((4, 30, 2), np.nan, 1),  # facing unknown
        ((16.9, 30, 2), 180, 0),  # cut by the border of the image
    ],
)
def test_a_place_is_in_view_where_its_panel_would_show_whole_large_and_from_the_front(
    place, bearing_deg, count
):
    bearing = np.radians([bearing_deg])
    places = PanelPlaces(np.array([place], float), bearing, np.array([[0.75, 0.75]]))
    height, box = views_of(places, np.array([[0.0, 0, 2]]), NORTH[None], CAMERA, 25.0)
    assert height[0].tolist() == pytest.approx([35.0 * count])
    if count:
        assert box[0, 0].tolist() == pytest.approx([968.67, 582.0, 1003.67, 617.0], abs=0.01)


def test_a_panel_is_gone_the_surer_the_more_drives_looked_and_the_surer_it_was_one():
    settings = MergeSettings(missed=0.1, change_per_year=0.08)
    found = [gone_probability(1.0, 1.0, looks, 0, settings) for looks in range(4)]
    assert found == pytest.approx([0.08 / (0.08 + 0.92 * 0.1**looks) for looks in range(4)])
    for looks in range(4):
        unsure = gone_probability(0.9, 1.0, looks, 0, settings)
        assert gone_probability(0.9, 1.0, looks, 1, settings) < unsure < found[looks]
        assert gone_probability(1.0, 0.0, looks, 0, settings) == 0


LENSES = (
    Camera(800, 600, 700.0, 700.0, 399.5, 299.5),
    Camera(800, 600, 700.0, 710.0, 410.0, 290.0, (-0.25, 0.08, 0.001, -0.001, 0.0)),
)
PLACE = np.array([4.0, -1.0, 40.0])  # right, down, ahead of the first camera
STEP_M = 8.0


@cache
def slopes_of(camera):
    """Right and down by ahead of the ray of each pixel, (pixels, 2)."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    ideal = ideal_points(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    return (ideal - (camera.cx, camera.cy)) / (camera.fx, camera.fy)


def image_of(camera, along_m, depth_m, seed=3):
    """What a camera sees that has driven so far, of a textured wall at a distance from the first one."""
    rng = np.random.default_rng(seed)
    wall = cv2.resize(rng.uniform(0, 255, (200, 200)).astype(np.float32), (1600, 1600))
    # the wall is 1600 pixels wide, as wide as the view
    at = slopes_of(camera) * (depth_m - along_m) / depth_m * 900 + 800
    maps = at.reshape(camera.height, camera.width, 2).astype(np.float32)
    grey = cv2.remap(wall, maps[..., 0].copy(), maps[..., 1].copy(), cv2.INTER_LINEAR)
    return PlaceImage(grey.astype(np.uint8), np.eye(3), np.array([0, 0, along_m]) - PLACE)


def test_noise_and_one_image_tell_nothing():
    noise = np.random.default_rng(1).integers(0, 256, (3, 600, 800)).astype(np.uint8)
    noisy = [
        replace(image_of(LENSES[0], k * STEP_M, 300.0), grey=grey) for k, grey in enumerate(noise)
    ]
    for images in (noisy, [image_of(LENSES[0], 0, 300.0)], []):
        assert measure_occlusion(images, LENSES[0], (0.9, 0.9), ChangeSettings()) == (0, 0)


@pytest.mark.parametrize("camera", LENSES)
@pytest.mark.parametrize(
    ("depth_m", "past", "hidden"), [(28.0, 0, 3), (40.0, 0, 3), (70.0, 3, 0), (300.0, 3, 0)]
)
def test_a_wall_hides_what_stands_behind_it_and_shows_what_stands_before_it(
    camera, depth_m, past, hidden
):
    images = [image_of(camera, k * STEP_M, depth_m) for k in range(3)]
    assert measure_occlusion(images, camera, (0.9, 0.9), ChangeSettings()) == (past, hidden)


def test_a_place_that_is_told_by_no_texture_takes_a_larger_window():
    camera = LENSES[0]
    images = [image_of(camera, k * STEP_M, 300.0) for k in range(3)]
    for image in images:  # a sky of one colour where the panel was, and a little beyond
        ahead = -image.centre[2]
        u, v = distort_points(camera, np.array([[399.5, 299.5]]) + 700 * PLACE[None, :2] / ahead)[0]
        half = round(700 * 0.6 / ahead)
        image.grey[round(v) - half : round(v) + half, round(u) - half : round(u) + half] = 128
    assert measure_occlusion(images, camera, (0.9, 0.9), ChangeSettings())[0] == 3
