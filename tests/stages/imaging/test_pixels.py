"""The space in which colours are compared, and the white balance by the road: what it has of colour is of the light."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.frame import USED, Camera, Frame
from wayside.schemas.settings import BalanceSettings
from wayside.stages.imaging import decode
from wayside.stages.imaging.pixels import (
    LARGEST_CAST,
    TOLERANCE,
    balanced,
    colorfulness,
    log_chromaticity,
    road_chromaticity,
)


def test_exposure_moves_a_bright_colour_along_brightness_only():
    bright, half = log_chromaticity(np.array([[220.0, 160, 90], [110.0, 80, 45]]))
    assert bright[0] - half[0] == pytest.approx(np.log(2), abs=0.03)
    np.testing.assert_allclose(bright[1:], half[1:], atol=0.04)


def test_grey_has_no_chromaticity():
    grey = np.repeat(np.array([[0.0], [3], [128], [255]]), 3, axis=1)
    np.testing.assert_allclose(log_chromaticity(grey)[:, 1:], 0, atol=1e-12)


def test_other_shapes_are_refused():
    with pytest.raises(ValueError, match=r"colours: shape .* instead of"):
        log_chromaticity(np.zeros(3))


def test_colour_is_measured_against_contrast_whatever_cast_noise_and_fog():
    random = np.random.default_rng(2)
    scene = np.kron(random.integers(0, 256, (12, 20, 3)), np.ones((30, 30, 1)))
    grey = scene.mean(axis=2, keepdims=True).repeat(3, axis=2)
    noise = random.normal(0, 5, scene.shape)

    def seen(image):
        return colorfulness(np.clip(np.rint(image), 0, 255).astype(np.uint8))

    assert seen(grey) == pytest.approx(0, abs=1e-9)
    assert seen(0.8 * grey * [1.1, 1.0, 1.15] + noise) < 0.07
    assert seen(scene) > 0.3
    assert seen(0.1 * scene + 180 + noise) > 0.3
    assert seen(np.full((9, 9, 3), 70)) == 0


CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 100.0)
SIGN = 60, 80, 100, 140  # rows and columns


def scene(gains=(1.0, 1.0, 1.0), road=(110, 110, 110)):
    """A white sign before a green wood above a road, in some light."""
    rgb = np.full((240, 320, 3), (60, 110, 50), np.float64)
    rgb[130:] = road
    rgb[130::7] *= 0.6  # shade
    rgb[SIGN[0] : SIGN[1], SIGN[2] : SIGN[3]] = (170, 170, 170)
    return np.clip(np.rint(rgb * gains), 0, 255).astype(np.uint8)


def sign_of(rgb):
    return rgb[SIGN[0] + 5, SIGN[2] + 5].astype(float)


@given(st.floats(0.8, 1.25), st.floats(0.8, 1.25))
def test_of_a_cast_nothing_is_left_and_less_is_no_cast(red, blue):
    cast = scene((red, 1.0, blue))
    strength = np.linalg.norm(road_chromaticity(cast, CAMERA))
    rgb = balanced(cast, CAMERA)
    if strength <= TOLERANCE:
        assert rgb is cast
    else:
        beyond = max(0.0, strength - LARGEST_CAST)
        r, g, b = sign_of(rgb)
        assert np.linalg.norm(np.log([r / g, b / g])) < beyond + 0.04


def test_a_road_of_earth_colours_the_image_no_more_than_is_said():
    rgb = scene(road=(160, 100, 40))
    gains = np.log(sign_of(balanced(rgb, CAMERA)) / sign_of(rgb))
    assert np.linalg.norm(gains) == pytest.approx(LARGEST_CAST, abs=0.01)
    assert gains[0] < 0 < gains[2]


def test_an_image_that_shows_no_road_stays_as_it_is():
    rgb = scene((1.3, 1.0, 0.7))
    assert balanced(rgb, replace(CAMERA, cy=400.0)) is rgb


def test_colours_are_balanced_on_the_way_and_grey_levels_are_not():
    warm = scene((1.2, 1.0, 0.8))
    data = cv2.imencode(".png", warm[..., ::-1])[1].tobytes()
    frame = Frame(0, 0, None, USED, "png", data, CAMERA, 320, 240)
    settings = None, BalanceSettings(), BalanceSettings(on=False)
    recorded, found, off = (next(decode(iter([frame]), one)) for one in settings)
    for image, wanted in ((recorded, warm), (off, warm), (found, balanced(warm, CAMERA))):
        np.testing.assert_array_equal(image.rgb, wanted)
        np.testing.assert_array_equal(image.grey, recorded.grey)
    assert not (found.rgb == warm).all()
