"""Crops as another camera takes them: what light does on its way into a file."""

import numpy as np
import pytest

from training import camera_effects
from training.camera_effects import make_noise, through_a_camera

NOISE = make_noise(np.random.default_rng(0))


def shown(rgb, seeds):
    return [through_a_camera(rgb, NOISE, np.random.default_rng(seed)) for seed in range(seeds)]


def test_a_camera_changes_the_pixels_but_not_their_number():
    rgb = np.random.default_rng(1).integers(0, 256, (256, 256, 3)).astype(np.uint8)
    for seen in shown(rgb, 30):
        assert seen.shape == rgb.shape
        assert seen.dtype == np.uint8
        assert (seen != rgb).any()


def test_the_same_seed_gives_the_same_pixels_and_leaves_the_image_as_it_was():
    rgb = np.random.default_rng(1).integers(0, 256, (128, 128, 3)).astype(np.uint8)
    before = rgb.copy()
    one, same = (through_a_camera(rgb, NOISE, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(one, same)
    np.testing.assert_array_equal(rgb, before)


def test_light_that_is_too_bright_runs_over_thin_dark_lines(monkeypatch):
    """The line is as dark as before the lens, and twice as far from the end of the range as the white beside it."""
    monkeypatch.setattr(camera_effects, "TOO_BRIGHT", (1.0, 2.0, 2.4))
    rgb = np.full((64, 64, 3), 200, np.uint8)
    rgb[:, 32] = 30
    rgb[:, :16] = 30
    overexposed = [seen for seen in shown(rgb, 60) if np.median(seen[:, 48]) > 250]
    line = np.array([seen[8:56, 32].mean() for seen in overexposed])
    wide = np.array([seen[8:56, 4].mean() for seen in overexposed])
    assert len(overexposed) > 20
    assert (line > 200).sum() > 5
    assert np.median(wide) < 120


def test_some_images_are_exposed_far_too_little_and_too_much():
    grey = np.full((32, 32, 3), 120, np.uint8)
    means = np.array([seen.mean() for seen in shown(grey, 300)])
    assert np.median(means) == pytest.approx(120, abs=30)
    assert (means < 60).mean() > 0.03
    assert (means > 225).mean() > 0.05
