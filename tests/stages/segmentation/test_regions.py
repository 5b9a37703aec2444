"""Connected regions against SciPy, and one-dimensional K-means against trying everything."""

from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from wayside.schemas.settings import GateSettings
from wayside.stages.segmentation.two_pass import connected_regions, optimal_breaks


def by_scipy(labels, rgb, smallest, largest):
    """Rows (area, box, mean colour), sorted, and the number of all regions."""
    rows, total = [], 0
    for label in np.unique(labels):
        parts, count = ndimage.label(labels == label)
        total += count
        for number, (ys, xs) in enumerate(ndimage.find_objects(parts), start=1):
            inside = parts == number
            area = int(inside.sum())
            if smallest <= area <= largest:
                mean = rgb[inside].mean(axis=0)
                box = (xs.start, ys.start, xs.stop, ys.stop)
                rows.append((area, *box, *np.round(mean, 3)))
    return sorted(rows), total


def assert_as_by_scipy(labels, rgb, smallest, largest):
    found, total = connected_regions(labels, rgb, GateSettings(smallest, largest))
    rows = np.column_stack([found.area_px, found.box, found.rgb.astype(float).round(3)])
    wanted, wanted_total = by_scipy(labels, rgb, smallest, largest)
    assert total == wanted_total
    np.testing.assert_allclose(
        np.array(sorted(rows.tolist())).reshape(-1, 8), np.array(wanted).reshape(-1, 8), atol=2e-3
    )


label_images = st.tuples(st.integers(1, 12), st.integers(1, 14)).flatmap(
    lambda size: arrays(np.uint8, size, elements=st.integers(0, 2))
)


@given(label_images, st.integers(1, 4), st.integers(4, 60))
def test_regions_of_small_images_are_those_of_scipy(labels, smallest, largest):
    rgb = np.random.default_rng(0).integers(0, 256, (*labels.shape, 3), dtype=np.uint8)
    assert_as_by_scipy(labels, rgb, smallest, largest)


@pytest.fixture(scope="module")
def textured():
    rng = np.random.default_rng(7)
    smooth = cv2.GaussianBlur(rng.normal(size=(211, 317)), (0, 0), 2.0)
    labels = np.digitize(smooth, np.quantile(smooth, np.linspace(0, 1, 17)[1:-1])).astype(np.uint8)
    return labels, rng.integers(0, 256, (211, 317, 3), dtype=np.uint8)


def test_regions_of_a_textured_image_and_of_rows_of_it_are_those_of_scipy(textured):
    labels, rgb = textured
    assert_as_by_scipy(labels, rgb, 20, 3000)
    assert_as_by_scipy(labels[50:90], rgb[50:90], 5, 500)


def test_the_teeth_of_a_comb_join_late_and_still_are_one_region():
    comb = np.zeros((41, 41), np.uint8)
    comb[:, ::2] = 1
    comb[-1] = 1  # its teeth meet in the last row only
    assert_as_by_scipy(comb, np.full((41, 41, 3), 9, np.uint8), 1, 2000)


def test_regions_come_in_reading_order():
    labels = np.zeros((6, 9), np.uint8)
    labels[0, 5], labels[1, 2], labels[4, 8] = 1, 1, 1
    found, _ = connected_regions(labels, np.zeros((6, 9, 3), np.uint8), GateSettings(1, 1))
    assert found.box.tolist() == [[5, 0, 6, 1], [2, 1, 3, 2], [8, 4, 9, 5]]


@pytest.mark.parametrize("size", [(0, 5), (5, 0), (0, 0)])
def test_an_image_without_pixels_has_no_regions(size):
    labels, rgb = np.zeros(size, np.uint8), np.zeros((*size, 3), np.uint8)
    found, total = connected_regions(labels, rgb, GateSettings(1, 10))
    assert (len(found), total) == (0, 0)


def test_what_the_kernel_cannot_take_is_refused(textured):
    labels, rgb = textured
    for given_labels, given_rgb, message in (
        (labels[:, ::2], rgb, "C-contiguous"),
        (labels, rgb[:50], r"rgb: .* instead of 211 x 317 x 3"),
        (labels.astype(np.int32), rgb, r"labels: .* instead of any x any uint8"),
    ):
        with pytest.raises(ValueError, match=message):
            connected_regions(given_labels, given_rgb, GateSettings(1, 10))


def spread(counts, breaks):
    total = 0.0
    ends = [*breaks[1:], len(counts)]
    for start, end in zip(breaks, ends, strict=True):
        values, weights = np.arange(start, end), np.asarray(counts[start:end], float)
        if weights.sum() > 0:
            total += (weights * (values - np.average(values, weights=weights)) ** 2).sum()
    return total


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=12), st.integers(1, 4))
def test_no_other_division_into_classes_has_less_spread(counts, classes):
    classes = min(classes, len(counts))
    breaks = optimal_breaks(np.array(counts), classes)
    least = min(
        spread(counts, [0, *inner]) for inner in combinations(range(1, len(counts)), classes - 1)
    )
    assert spread(counts, breaks) == pytest.approx(least, abs=1e-6)


@given(st.lists(st.integers(0, 10**6), min_size=16, max_size=443), st.integers(2, 16))
def test_breaks_rise_from_zero(counts, classes):
    breaks = optimal_breaks(np.array(counts), classes)
    assert len(breaks) == classes
    assert breaks[0] == 0
    assert (np.diff(breaks) >= 0).all()


@pytest.mark.parametrize(
    ("counts", "classes"),
    [(np.ones(3), 4), (np.ones(3), 0), (-np.ones(3), 2), (np.ones((2, 2)), 2)],
)
def test_impossible_questions_are_refused(counts, classes):
    with pytest.raises(ValueError, match=r"outside 1 to the number of values|negative"):
        optimal_breaks(counts, classes)
