"""Connected regions against scipy, OpenCV and cc3d."""

import cc3d
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from wayside.stages.segmentation.connected_regions import connected_regions


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


def ours(labels, rgb, smallest, largest):
    found = connected_regions(labels, rgb, smallest, largest)
    rows = [
        (int(area), *map(int, box), *np.round(mean.astype(float), 3))
        for area, box, mean in zip(found.area, found.box, found.rgb, strict=True)
    ]
    return sorted(rows), found.total


def assert_same(found, wanted):
    assert found[1] == wanted[1]
    np.testing.assert_allclose(np.array(found[0]), np.array(wanted[0]), atol=2e-3)


label_images = st.tuples(st.integers(1, 12), st.integers(1, 14)).flatmap(
    lambda size: arrays(np.uint8, size, elements=st.integers(0, 2))
)


@given(label_images, st.integers(1, 4), st.integers(4, 60))
def test_regions_of_small_images_are_those_of_scipy(labels, smallest, largest):
    rgb = np.random.default_rng(0).integers(0, 256, (*labels.shape, 3), dtype=np.uint8)
    assert_same(ours(labels, rgb, smallest, largest), by_scipy(labels, rgb, smallest, largest))


@pytest.fixture(scope="module")
def textured():
    rng = np.random.default_rng(7)
    smooth = cv2.GaussianBlur(rng.normal(size=(211, 317)), (0, 0), 2.0)
    labels = np.digitize(smooth, np.quantile(smooth, np.linspace(0, 1, 17)[1:-1])).astype(np.uint8)
    return labels, rng.integers(0, 256, (211, 317, 3), dtype=np.uint8)


def test_regions_of_a_textured_image_are_those_of_opencv(textured):
    labels, rgb = textured
    wanted, total = [], 0
    for label in range(16):
        count, _, stats, _ = cv2.connectedComponentsWithStats(
            (labels == label).astype(np.uint8), connectivity=4
        )
        total += count - 1
        wanted += [
            (int(a), int(x), int(y), int(x + w), int(y + h))
            for x, y, w, h, a in stats[1:]
            if 20 <= a <= 3000
        ]
    found, found_total = ours(labels, rgb, 20, 3000)
    assert [row[:5] for row in found] == sorted(wanted)
    assert found_total == total


def test_the_number_of_regions_is_that_of_cc3d(textured):
    labels, rgb = textured
    count = cc3d.connected_components(labels + 1, connectivity=4, return_N=True)[1]
    assert connected_regions(labels, rgb, 1, labels.size).total == count


def test_spirals_and_combs_join_late_and_still_are_one_region():
    labels = np.zeros((41, 41), np.uint8)
    labels[:, ::2] = 1
    labels[-1] = 1  # a comb: its teeth meet in the last row only
    rgb = np.full((41, 41, 3), 9, np.uint8)
    assert_same(ours(labels, rgb, 1, 2000), by_scipy(labels, rgb, 1, 2000))


def test_the_size_gate_keeps_its_own_limits():
    labels = np.zeros((4, 20), np.uint8)
    labels[0, :5], labels[2, :6] = 1, 2
    rgb = np.zeros((4, 20, 3), np.uint8)
    assert sorted(connected_regions(labels, rgb, 5, 6).area) == [5, 6]
    assert sorted(connected_regions(labels, rgb, 6, 6).area) == [6]


def test_regions_come_in_reading_order():
    labels = np.zeros((6, 9), np.uint8)
    labels[0, 5], labels[1, 2], labels[4, 8] = 1, 1, 1
    found = connected_regions(labels, np.zeros((6, 9, 3), np.uint8), 1, 1)
    assert found.box.tolist() == [[5, 0, 6, 1], [2, 1, 3, 2], [8, 4, 9, 5]]


@pytest.mark.parametrize("size", [(0, 5), (5, 0), (0, 0)])
def test_an_image_without_pixels_has_no_regions(size):
    found = connected_regions(np.zeros(size, np.uint8), np.zeros((*size, 3), np.uint8), 1, 10)
    assert (len(found.area), found.total) == (0, 0)


def test_rows_of_a_larger_image_are_taken_as_they_are(textured):
    labels, rgb = textured
    part = np.ascontiguousarray(labels[50:90]), np.ascontiguousarray(rgb[50:90])
    assert ours(labels[50:90], rgb[50:90], 5, 500) == ours(*part, 5, 500)


def test_what_the_kernels_cannot_take_is_refused(textured):
    labels, rgb = textured
    with pytest.raises(ValueError, match="C-contiguous"):
        connected_regions(labels[:, ::2], np.ascontiguousarray(rgb[:, ::2]), 1, 10)
    with pytest.raises(ValueError, match=r"rgb: .* instead of 211 x 317 x 3"):
        connected_regions(labels, rgb[:50], 1, 10)
    with pytest.raises(ValueError, match=r"labels: .* instead of any x any uint8"):
        connected_regions(labels.astype(np.int32), rgb, 1, 10)
    with pytest.raises(ValueError, match="smallest_px"):
        connected_regions(labels, rgb, 0, 10)
    with pytest.raises(ValueError, match="65536 columns are more than 65535"):
        connected_regions(np.zeros((1, 65536), np.uint8), np.zeros((1, 65536, 3), np.uint8), 1, 9)
