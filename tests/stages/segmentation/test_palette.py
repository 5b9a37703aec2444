"""The palette against OpenCV's K-means on every pixel."""

import cv2
import numpy as np
import pytest

from wayside.schemas.settings import SegmentSettings
from wayside.stages.segmentation.palette import palette, sample_colors
from wayside.stages.segmentation.two_pass import SAMPLE_PX


def k(clusters):
    """Settings of so many clusters."""
    return SegmentSettings(clusters=clusters)


def scene(height=240, width=320, seed=0):
    """Sky, road, trees and a few small bright things, with noise."""
    rng = np.random.default_rng(seed)
    rgb = np.empty((height, width, 3))
    rgb[: height // 2] = [150, 180, 220]
    rgb[height // 2 :] = [90, 90, 95]
    rgb[height // 3 : height // 2, : width // 2] = [40, 70, 30]
    rgb[height // 2 :] += np.linspace(-30, 30, width)[:, None]
    for _ in range(12):
        y, x = rng.integers(0, height - 20), rng.integers(0, width - 20)
        rgb[y : y + 20, x : x + 20] = rng.integers(0, 256, 3)
    return np.clip(rgb + rng.normal(0, 5, rgb.shape), 0, 255).astype(np.uint8)


def inertia(rgb, centers):
    squared = ((rgb[:, :, None].astype(float) - centers) ** 2).sum(axis=-1)
    return squared.min(axis=-1).mean()


@pytest.mark.parametrize("seed", range(4))
def test_the_palette_explains_an_image_nearly_as_well_as_full_kmeans(seed):
    rgb = scene(seed=seed)
    cv2.setRNGSeed(seed)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 50, 0.1)
    reference = cv2.kmeans(
        rgb.reshape(-1, 3).astype(np.float32), 16, None, criteria, 3, cv2.KMEANS_PP_CENTERS
    )[2]
    ours = palette(sample_colors(rgb, SAMPLE_PX), k(16))
    assert inertia(rgb, ours) <= 1.2 * inertia(rgb, np.clip(np.rint(reference), 0, 255))


def test_an_image_of_few_colours_gets_exactly_these():
    wanted = np.array([[10, 10, 10], [200, 30, 40], [30, 160, 60], [250, 250, 250]], np.uint8)
    rgb = wanted[np.random.default_rng(2).integers(0, 4, (90, 130))]
    np.testing.assert_array_equal(
        np.unique(palette(sample_colors(rgb, SAMPLE_PX), k(8)), axis=0), np.unique(wanted, axis=0)
    )


@pytest.mark.parametrize("clusters", range(2, 17))
def test_every_k_gives_that_many_centres_darkest_first(clusters):
    centers = palette(sample_colors(scene(), SAMPLE_PX), k(clusters))
    assert centers.shape == (clusters, 3)
    assert (np.diff(centers.sum(axis=1, dtype=int)) >= 0).all()


def test_more_clusters_leave_less_unexplained():
    rgb = scene()
    sample = sample_colors(rgb, SAMPLE_PX)
    assert inertia(rgb, palette(sample, k(16))) < inertia(rgb, palette(sample, k(4)))


def test_bins_stand_at_the_mean_of_the_sample():
    rgb = scene()
    sample = sample_colors(rgb, SAMPLE_PX)
    np.testing.assert_allclose(
        (sample.mean * sample.weight).sum(axis=1) / sample.weight.sum(),
        sample.pixels.mean(axis=0),
        rtol=1e-5,
    )


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 2), (7, 1), (3, 5)])
def test_tiny_images_have_a_palette(size):
    rgb = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
    assert palette(sample_colors(rgb, SAMPLE_PX), k(16)).shape == (16, 3)


def test_an_empty_image_or_a_k_out_of_range_is_refused():
    with pytest.raises(ValueError, match="has no pixel"):
        sample_colors(np.zeros((0, 5, 3), np.uint8), SAMPLE_PX)
    sample = sample_colors(scene(), SAMPLE_PX)
    for clusters in (1, 257):
        with pytest.raises(ValueError, match=r"clusters: .* outside 2 to 256"):
            palette(sample, k(clusters))
