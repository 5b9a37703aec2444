import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.stages.geometry.boxes import (
    box_areas,
    covered_fractions,
    iou_matrix,
    non_maximum_suppression,
)

boxes = st.lists(
    st.tuples(st.floats(-50, 400), st.floats(-50, 300), st.floats(1, 300), st.floats(1, 300)),
    max_size=60,
)


def as_boxes(rows):
    table = np.array(rows, np.float32).reshape(-1, 4)
    table[:, 2:] += table[:, :2]
    return table


@settings(max_examples=80)
@given(boxes, st.sampled_from([0.3, 0.4, 0.7, 0.9]))
def test_kept_boxes_are_those_of_the_plain_comparison_of_all_pairs(rows, same):
    box = as_boxes(rows)
    overlap = iou_matrix(box, box)
    if np.isclose(overlap, same, atol=1e-4).any():
        return
    kept = []
    for i in range(len(box)):
        if not (overlap[i, kept] > same).any():
            kept.append(i)
    assert non_maximum_suppression(box, same).tolist() == kept


@settings(max_examples=80)
@given(boxes)
def test_a_covered_fraction_is_one_in_the_box_itself_and_never_more(rows):
    box = as_boxes(rows).astype(np.float64)
    covered = covered_fractions(box, box)
    assert np.diag(covered) == pytest.approx(np.ones(len(box)))
    assert ((covered >= 0) & (covered <= 1 + 1e-9)).all()


def test_a_box_half_inside_another_is_covered_by_half():
    box = np.array([[0, 0, 4, 4], [2, 0, 10, 8]], np.float64)
    assert covered_fractions(box, box) == pytest.approx(np.array([[1, 0.5], [0.125, 1]]))


def test_a_box_without_sides_has_no_area():
    assert box_areas(np.array([[0, 0, 4, 5], [4, 5, 0, 0]], np.float32)).tolist() == [20, 0]
