import numpy as np
import pytest

from wayside.stages.detection.contrast_maps import MAPS, face_maps, neighbourhood
from wayside.stages.imaging import halved

COLORS = {
    "red": (190, 30, 40),
    "blue": (30, 60, 170),
    "green": (10, 120, 60),
    "yellow": (240, 190, 20),
    "lighter": (230, 230, 230),
    "darker": (20, 20, 20),
}


def picture(color):
    rgb = np.full((240, 320, 3), 110, np.uint8)
    rgb[100:130, 150:180] = color
    return rgb


@pytest.mark.parametrize("name", MAPS)
def test_a_patch_of_a_colour_stands_out_in_the_map_of_that_colour(name):
    values = face_maps(picture(COLORS[name]))[MAPS.index(name)]
    inside = values[102:128, 152:178]
    outside = np.delete(
        values.reshape(-1), np.flatnonzero(np.pad(np.ones((34, 34)), ((98, 108), (148, 138))))
    )
    assert inside.min() > outside.max() + 40


def test_an_even_picture_has_nothing_in_any_map():
    assert face_maps(np.full((90, 130, 3), (90, 140, 60), np.uint8)).max() <= 1


def test_the_chromatic_maps_hardly_change_when_the_light_halves():
    bright, dim = picture((200, 40, 40)), picture((200, 40, 40)) // 2
    values = [int(face_maps(p)[0][110, 160]) for p in (bright, dim)]
    assert values[1] > 0.6 * values[0]


def test_the_mean_of_the_neighbourhood_of_an_even_picture_is_itself():
    rgb = np.full((67, 91, 3), (10, 200, 90), np.uint8)
    assert (neighbourhood(rgb) == rgb).all()


def test_a_halved_picture_has_means_of_four_pixels():
    rgb = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    four = rgb[:4, :6].astype(float).reshape(2, 2, 3, 2, 3).mean(axis=(1, 3))
    assert np.abs(halved(rgb).astype(float) - four).max() <= 0.5


@pytest.mark.parametrize("shape", [(0, 8, 3), (8, 0, 3), (1, 9, 3)])
def test_pictures_too_small_to_halve_become_empty(shape):
    assert halved(np.zeros(shape, np.uint8)).size == 0


def test_an_empty_band_has_empty_maps():
    assert face_maps(np.zeros((0, 64, 3), np.uint8)).shape == (len(MAPS), 0, 64)
