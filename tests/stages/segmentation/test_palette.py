"""The palette against OpenCV's K-means on every pixel, and the nearest centre of each pixel against plain numpy."""

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wayside.stages.segmentation.palette import DIFFERENCES, nearest_centers, palette, sample_colors
from wayside.stages.segmentation.two_pass import SAMPLE_PX


def palette_of(rgb, clusters=16):
    return palette(sample_colors(rgb, SAMPLE_PX), clusters)


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


def plain(rgb, centers):
    """Nearest centres and rounded distances."""
    gap = rgb.astype(np.int64)[..., None, :] - np.asarray(centers, np.int64)
    squared = (gap**2).sum(axis=-1)
    return squared.argmin(axis=-1), np.floor(np.sqrt(squared.min(axis=-1)) + 0.5).astype(int)


def inertia(rgb, centers):
    return ((rgb[:, :, None].astype(float) - centers) ** 2).sum(axis=-1).min(axis=-1).mean()


@pytest.mark.parametrize("seed", range(4))
def test_the_palette_explains_an_image_nearly_as_well_as_full_kmeans(seed):
    rgb = scene(seed=seed)
    cv2.setRNGSeed(seed)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 50, 0.1)
    reference = cv2.kmeans(
        rgb.reshape(-1, 3).astype(np.float32), 16, None, criteria, 3, cv2.KMEANS_PP_CENTERS
    )[2]
    assert inertia(rgb, palette_of(rgb)) <= 1.2 * inertia(rgb, np.clip(np.rint(reference), 0, 255))


def test_an_image_of_few_colours_gets_exactly_these():
    wanted = np.array([[10, 10, 10], [200, 30, 40], [30, 160, 60], [250, 250, 250]], np.uint8)
    rgb = wanted[np.random.default_rng(2).integers(0, 4, (90, 130))]
    np.testing.assert_array_equal(np.unique(palette_of(rgb, 8), axis=0), np.unique(wanted, axis=0))


def test_more_clusters_leave_less_unexplained_and_stand_darkest_first():
    rgb = scene()
    found = [palette_of(rgb, clusters) for clusters in (2, 4, 9, 16, 40)]
    assert [len(one) for one in found] == [2, 4, 9, 16, 40]
    assert all((np.diff(one.sum(axis=1, dtype=int)) >= 0).all() for one in found)
    assert (np.diff([inertia(rgb, one) for one in found]) < 0).all()


def test_an_empty_image_or_a_k_out_of_range_is_refused():
    with pytest.raises(ValueError, match="has no pixel"):
        palette_of(np.zeros((0, 5, 3), np.uint8))
    for clusters in (1, 257):
        with pytest.raises(ValueError, match=r"clusters: .* outside 2 to 256"):
            palette_of(scene(), clusters)


colors = st.integers(0, 255)
images = st.tuples(st.integers(1, 7), st.integers(1, 19)).flatmap(
    lambda size: arrays(np.uint8, (*size, 3), elements=colors)
)
palettes = st.sampled_from([1, 3, 15, 16, 17, 31, 33, 256]).flatmap(
    lambda k: arrays(np.uint8, (k, 3), elements=colors)
)


@given(images, palettes)
@example(np.array([[[0] * 3, [255] * 3]], np.uint8), np.zeros((1, 3), np.uint8))  # the farthest
@example(scene(), scene()[::9, 7])  # more colours than one chunk
def test_labels_differences_and_their_classes_are_those_of_a_plain_argmin(rgb, centers):
    table = (np.arange(DIFFERENCES) * 7 % 11).astype(np.uint8)
    labels, classes = nearest_centers(rgb, centers, table)
    wanted_labels, wanted_differences = plain(rgb, centers)
    np.testing.assert_array_equal(labels, wanted_labels)
    np.testing.assert_array_equal(classes, table[wanted_differences])
    np.testing.assert_array_equal(nearest_centers(rgb, centers)[1], wanted_differences)


ONE_PIXEL, TWO_CENTRES = np.zeros((1, 1, 3), np.uint8), np.zeros((2, 3))


@pytest.mark.parametrize(
    ("rgb", "centers", "message"),
    [
        (np.zeros((4, 8, 3), np.uint8)[:, ::2], TWO_CENTRES, "C-contiguous"),
        (np.zeros((4, 8, 3), np.float32), TWO_CENTRES, "uint8"),
        (np.zeros((4, 8), np.uint8), TWO_CENTRES, "instead of 4 x 3"),
        (ONE_PIXEL, np.zeros((257, 3)), "centres: .*instead of"),
        (ONE_PIXEL, np.zeros((0, 3)), "centres: .*instead of"),
        (ONE_PIXEL, np.full((2, 3), 0.5), "centres: not whole"),
        (ONE_PIXEL, np.full((2, 3), 256), "centres: not whole"),
    ],
)
def test_other_arrays_are_refused(rgb, centers, message):
    with pytest.raises(ValueError, match=message):
        nearest_centers(rgb, centers)
