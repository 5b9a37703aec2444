"""Packed argmin against plain numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wayside.stages.segmentation.label_images import (
    DIFFERENCES,
    difference_histogram,
    difference_image,
    label_both_passes,
    mean_of_labels,
)


def label_colors(rgb, centers):
    """Labels and rounded distances: these by two tables, one for their low byte, one for their high byte."""
    values = np.arange(DIFFERENCES)
    labels, low = label_both_passes(rgb, centers, (values & 255).astype(np.uint8))
    _, high = label_both_passes(rgb, centers, (values >> 8).astype(np.uint8))
    return labels, low.astype(int) + 256 * high.astype(int)


def plain(rgb, centers):
    gap = rgb.astype(np.int64)[..., None, :] - np.asarray(centers, np.int64)
    squared = (gap**2).sum(axis=-1)
    return squared.argmin(axis=-1), np.floor(np.sqrt(squared.min(axis=-1)) + 0.5)


colors = st.integers(0, 255)
images = st.tuples(st.integers(1, 7), st.integers(1, 19)).flatmap(
    lambda size: arrays(np.uint8, (*size, 3), elements=colors)
)
palettes = st.sampled_from([1, 3, 15, 16, 17, 31, 33, 256]).flatmap(
    lambda k: arrays(np.uint8, (k, 3), elements=colors)
)


@given(images, palettes)
def test_labels_and_differences_are_those_of_a_plain_argmin(rgb, centers):
    labels, differences = label_colors(rgb, centers)
    wanted_labels, wanted_differences = plain(rgb, centers)
    np.testing.assert_array_equal(labels, wanted_labels)
    np.testing.assert_array_equal(differences, wanted_differences)


def test_the_extreme_colours_of_the_cube_stay_exact():
    corners = np.array(np.meshgrid([0, 255], [0, 255], [0, 255])).reshape(3, -1).T
    rgb = np.ascontiguousarray(corners, np.uint8)[None]
    for center in corners:
        _, differences = label_colors(rgb, center[None])
        np.testing.assert_array_equal(differences, plain(rgb, center[None])[1])
    assert label_colors(rgb, np.array([[0, 0, 0]]))[1].max() == DIFFERENCES - 1


def test_a_tie_goes_to_the_lower_label():
    rgb = np.full((2, 5, 3), 100, np.uint8)
    centers = np.array([[90, 100, 100], [110, 100, 100], [100, 90, 100], [100, 100, 110]])
    assert (label_colors(rgb, centers)[0] == 0).all()
    assert (label_colors(rgb, centers[[3, 3, 1]])[0] == 0).all()


@given(images, palettes)
def test_the_sweep_of_both_passes_looks_differences_up_in_the_class_table(rgb, centers):
    table = (np.arange(DIFFERENCES) * 7 % 11).astype(np.uint8)
    first, second = label_both_passes(rgb, centers, table)
    labels, differences = label_colors(rgb, centers)
    np.testing.assert_array_equal(first, labels)
    np.testing.assert_array_equal(second, table[differences])


@given(images, palettes)
def test_the_difference_image_is_what_pass_two_divides_into_classes(rgb, centers):
    differences = difference_image(rgb, centers)
    assert differences.dtype == np.uint16
    np.testing.assert_array_equal(differences, plain(rgb, centers)[1])


def test_means_and_histogram_cover_more_colours_than_one_chunk():
    rng = np.random.default_rng(1)
    sample = rng.integers(0, 256, (5000, 3), dtype=np.uint8)
    centers = rng.integers(0, 256, (9, 3))
    labels, differences = plain(sample, centers)
    means = mean_of_labels(sample, centers)
    for j in range(9):
        np.testing.assert_allclose(means[j], sample[labels == j].mean(axis=0))
    counts = difference_histogram(sample, centers)
    np.testing.assert_array_equal(
        counts, np.bincount(differences.astype(int), minlength=DIFFERENCES)
    )


def test_a_centre_without_colours_stays_where_it_is():
    sample = np.full((10, 3), 7, np.uint8)
    means = mean_of_labels(sample, np.array([[7, 7, 7], [200, 1, 2]]))
    np.testing.assert_array_equal(means, [[7, 7, 7], [200, 1, 2]])


@pytest.mark.parametrize(
    ("rgb", "message"),
    [
        (np.zeros((4, 8, 3), np.uint8)[:, ::2], "C-contiguous"),
        (np.zeros((4, 8, 3), np.float32), "uint8"),
        (np.zeros((4, 8), np.uint8), "any x any x 3"),
    ],
)
def test_images_of_another_layout_type_or_shape_are_refused(rgb, message):
    with pytest.raises(ValueError, match=message):
        label_colors(rgb, np.zeros((2, 3)))


@pytest.mark.parametrize(
    "centers", [np.zeros((257, 3)), np.zeros((0, 3)), np.full((2, 3), 0.5), np.full((2, 3), 256)]
)
def test_centres_that_cannot_be_packed_are_refused(centers):
    with pytest.raises(ValueError, match=r"centres: .*instead of|centres: not whole"):
        label_colors(np.zeros((1, 1, 3), np.uint8), centers)
