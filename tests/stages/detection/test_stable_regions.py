import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from wayside.stages.detection.stable_regions import find_stable_regions
from wayside.stages.geometry import iou_matrix

SAME_IOU = 0.8


def swept(values, **given):
    """Stable regions of any size that live one level, unless `given` says otherwise."""
    usual = {"first_level": 1, "step": 1, "min_lifetime": 1, "same_iou": SAME_IOU}
    sizes = {"smallest": (1, 1), "largest": (400, 400), "capacity": 20_000}
    return find_stable_regions(values, **(usual | sizes | given))


def components(values, level):
    """Box and area of every component of `values >= level`, by scipy."""
    labels, count = ndimage.label(values >= level)
    found = []
    for index, (rows, columns) in enumerate(ndimage.find_objects(labels)):
        box = [columns.start, rows.start, columns.stop, rows.stop]
        found.append((box, int((labels == index + 1).sum())))
    assert len(found) == count
    return found


def test_a_bright_patch_on_a_dim_slope_is_found_with_its_box():
    values = np.tile(np.linspace(0, 40, 60).astype(np.uint8), (50, 1))
    values[20:34, 10:30] = 150
    found = swept(values, first_level=5, step=4, min_lifetime=10)
    best = iou_matrix(found.box, np.array([[10, 20, 30, 34]])).max()
    assert best == pytest.approx(1.0)


@settings(max_examples=60)
@given(
    arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 12)), elements=st.integers(0, 7))
)
def test_every_component_of_every_level_is_covered_by_a_reported_box(values):
    found = swept(values, first_level=1, min_lifetime=1)
    for level in range(1, 8):
        for box, _ in components(values, level):
            assert iou_matrix(found.box, np.array([box])).max() >= SAME_IOU - 1e-6


@settings(max_examples=60)
@given(
    arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 12)), elements=st.integers(0, 7))
)
def test_every_reported_region_is_a_component_of_some_level(values):
    found = swept(values, first_level=1, min_lifetime=1)
    known = [one for level in range(1, 8) for one in components(values, level)]
    for box, area, lifetime in zip(found.box, found.area, found.lifetime, strict=True):
        inside = [
            a for b, a in known if iou_matrix(box[None], np.array([b]))[0, 0] >= SAME_IOU - 1e-6
        ]
        assert area in inside
        assert lifetime >= 1


def test_a_coarser_step_meets_the_components_of_its_levels_only():
    rng = np.random.default_rng(4)
    values = ndimage.gaussian_filter(rng.uniform(0, 255, (40, 60)), 3)
    values = np.interp(values, (values.min(), values.max()), (0, 255)).astype(np.uint8)
    found = swept(values, first_level=10, step=20, min_lifetime=1)
    for level in range(10, 256, 20):
        for box, _ in components(values, level):
            assert iou_matrix(found.box, np.array([box])).max() >= SAME_IOU - 1e-6


def test_boxes_outside_the_wanted_sizes_are_left_out():
    values = np.zeros((60, 60), np.uint8)
    values[5:9, 5:9] = 200
    values[20:50, 20:50] = 200
    found = swept(
        values, first_level=50, step=50, min_lifetime=2, smallest=(6, 6), largest=(40, 40)
    )
    assert found.box.tolist() == [[20, 20, 50, 50]]
    assert found.area.tolist() == [900]


def test_the_table_never_outgrows_its_capacity():
    rng = np.random.default_rng(0)
    values = rng.integers(0, 255, (80, 80)).astype(np.uint8)
    assert len(swept(values, first_level=1, min_lifetime=1, capacity=7).box) == 7


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0)])
def test_an_empty_image_has_no_regions(shape):
    assert len(swept(np.zeros(shape, np.uint8), first_level=1).box) == 0


@pytest.mark.parametrize(
    ("values", "first_level", "step"),
    [
        (np.zeros((4, 4), np.float32), 1, 1),
        (np.zeros((4, 4, 3), np.uint8), 1, 1),
        (np.zeros((4, 4), np.uint8), 0, 1),
        (np.zeros((4, 4), np.uint8), 1, 0),
    ],
)
def test_what_the_kernel_cannot_take_is_refused_at_the_door(values, first_level, step):
    with pytest.raises(ValueError, match="must be"):
        swept(values, first_level=first_level, step=step)
