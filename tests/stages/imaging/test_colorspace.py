"""The colour space of the features."""

import numpy as np
import pytest

from wayside.stages.imaging.colorspace import colorfulness, log_chromaticity

COLORS = np.array([[0, 0, 0], [255, 255, 255], [200, 20, 3], [0, 255, 0]], np.float32)


def test_every_colour_has_finite_coordinates():
    values = log_chromaticity(COLORS)
    assert values.shape == (4, 3)
    assert np.isfinite(values).all()
    assert log_chromaticity(np.zeros((0, 3))).shape == (0, 3)


def test_exposure_moves_a_bright_colour_along_brightness_only():
    bright, half = log_chromaticity(np.array([[220.0, 160, 90], [110.0, 80, 45]]))
    assert bright[0] - half[0] == pytest.approx(np.log(2), abs=0.03)
    np.testing.assert_allclose(bright[1:], half[1:], atol=0.04)


def test_grey_has_no_chromaticity():
    grey = np.repeat(np.array([[0.0], [3], [128], [255]]), 3, axis=1)
    np.testing.assert_allclose(log_chromaticity(grey)[:, 1:], 0, atol=1e-12)


def test_other_shapes_are_refused():
    with pytest.raises(ValueError, match=r"colours: shape .* instead of"):
        log_chromaticity(COLORS[0])


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
