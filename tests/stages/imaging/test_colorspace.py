"""Spaces for mean colours."""

import numpy as np
import pytest

from wayside.stages.imaging.colorspace import SPACES, to_space

COLORS = np.array([[0, 0, 0], [255, 255, 255], [200, 20, 3], [0, 255, 0]], np.float32)


def test_rgb_is_left_as_it_is():
    np.testing.assert_array_equal(to_space(COLORS, "rgb"), COLORS)


@pytest.mark.parametrize("space", SPACES)
def test_every_colour_has_finite_coordinates(space):
    values = to_space(COLORS, space)
    assert values.shape == (4, 3)
    assert np.isfinite(values).all()
    assert to_space(np.zeros((0, 3)), space).shape == (0, 3)


def test_exposure_moves_a_bright_colour_along_brightness_only():
    bright, half = to_space(np.array([[220.0, 160, 90], [110.0, 80, 45]]), "log_chromaticity")
    assert bright[0] - half[0] == pytest.approx(np.log(2), abs=0.03)
    np.testing.assert_allclose(bright[1:], half[1:], atol=0.04)


def test_grey_has_no_chromaticity():
    grey = np.repeat(np.array([[0.0], [3], [128], [255]]), 3, axis=1)
    np.testing.assert_allclose(to_space(grey, "log_chromaticity")[:, 1:], 0, atol=1e-12)


def test_unknown_spaces_and_shapes_are_refused():
    with pytest.raises(ValueError, match="wanted one of rgb, log_chromaticity"):
        to_space(COLORS, "lab")
    with pytest.raises(ValueError, match="wanted shape"):
        to_space(COLORS[0], "rgb")
