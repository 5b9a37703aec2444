import numpy as np
import pytest

from wayside.stages.detection.contrast_maps import (
    MAPS,
    contrast_maps,
    foreground_means,
    neighbourhood,
)
from wayside.stages.imaging import halved

COLORS = {
    "red": (190, 30, 40),
    "blue": (30, 60, 170),
    "green": (10, 120, 60),
    "yellow": (240, 190, 20),
    "lighter": (230, 230, 230),
    "darker": (20, 20, 20),
}


def maps_of(rgb):
    return contrast_maps(rgb, dark_level=64, neighbourhood_px=104)


def image(color):
    rgb = np.full((240, 320, 3), 110, np.uint8)
    rgb[100:130, 150:180] = color
    return rgb


@pytest.mark.parametrize("name", MAPS)
def test_a_patch_of_a_colour_stands_out_in_the_map_of_that_colour(name):
    values = maps_of(image(COLORS[name]))[MAPS.index(name)]
    inside = values[102:128, 152:178]
    outside = np.delete(
        values.reshape(-1), np.flatnonzero(np.pad(np.ones((34, 34)), ((98, 108), (148, 138))))
    )
    assert inside.min() > outside.max() + 40


def test_an_even_image_has_nothing_in_any_map():
    assert maps_of(np.full((90, 130, 3), (90, 140, 60), np.uint8)).max() <= 1


def test_the_chromatic_maps_hardly_change_when_the_light_halves():
    bright, dim = image((200, 40, 40)), image((200, 40, 40)) // 2
    values = [int(maps_of(p)[0][110, 160]) for p in (bright, dim)]
    assert values[1] > 0.6 * values[0]


def test_the_mean_of_the_neighbourhood_of_an_even_image_is_itself():
    rgb = np.full((67, 91, 3), (10, 200, 90), np.uint8)
    assert (neighbourhood(rgb, 104) == rgb).all()


def test_a_halved_image_has_means_of_four_pixels():
    rgb = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    four = rgb[:4, :6].astype(float).reshape(2, 2, 3, 2, 3).mean(axis=(1, 3))
    assert np.abs(halved(rgb).astype(float) - four).max() <= 0.5


@pytest.mark.parametrize("shape", [(0, 8, 3), (8, 0, 3), (1, 9, 3)])
def test_images_too_small_to_halve_become_empty(shape):
    assert halved(np.zeros(shape, np.uint8)).size == 0


def test_an_empty_band_has_empty_maps():
    assert maps_of(np.zeros((0, 64, 3), np.uint8)).shape == (len(MAPS), 0, 64)


def test_the_mean_colour_is_that_of_the_bright_part_of_the_map():
    rgb = np.zeros((20, 30, 3), np.uint8)
    rgb[:, :15] = (200, 30, 20)
    values = np.zeros((20, 30), np.uint8)
    values[:, :15] = 180
    assert foreground_means(rgb, values, np.array([[5, 2, 25, 18]], np.float32), 24).tolist() == [
        [200, 30, 20]
    ]


def test_no_boxes_have_no_mean_colours():
    rgb, values = np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.uint8)
    assert foreground_means(rgb, values, np.zeros((0, 4), np.float32), 24).shape == (0, 3)
