import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.stages.detection.boxes import (
    distinct_boxes,
    overlap_of,
    patch_means,
    stacked_pairs,
    suppressed_boxes,
)

boxes = st.lists(
    st.tuples(st.floats(-50, 400), st.floats(-50, 300), st.floats(1, 300), st.floats(1, 300)),
    max_size=60,
)


def as_boxes(rows):
    table = np.array(rows, np.float32).reshape(-1, 4)
    table[:, 2:] += table[:, :2]
    return table


@settings(max_examples=80, deadline=None)
@given(boxes, st.sampled_from([0.3, 0.4, 0.7, 0.9]))
def test_kept_boxes_are_those_of_the_plain_comparison_of_all_pairs(rows, same):
    box = as_boxes(rows)
    overlap = overlap_of(box, box)
    if np.isclose(overlap, same, atol=1e-4).any():
        return
    kept = []
    for i in range(len(box)):
        if not (overlap[i, kept] > same).any():
            kept.append(i)
    assert distinct_boxes(box, same).tolist() == kept


def test_many_boxes_of_all_sizes_are_compared_like_by_the_plain_method():
    rng = np.random.default_rng(1)
    box = as_boxes(
        np.column_stack([rng.uniform(0, 700, (1200, 2)), rng.uniform(4, 150, (1200, 2))])
    )
    overlap = overlap_of(box, box)
    kept = []
    for i in range(len(box)):
        if not (overlap[i, kept] > 0.7).any():
            kept.append(i)
    assert distinct_boxes(box, 0.7).tolist() == kept


def test_the_first_of_two_like_boxes_stays():
    box = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [30, 0, 40, 10]], np.float32)
    assert suppressed_boxes(box, 0.5).tolist() == [False, True, False]


def test_overlap_is_one_for_equal_and_zero_for_separate_boxes():
    box = np.array([[0, 0, 4, 4], [10, 10, 12, 12]], np.float64)
    assert overlap_of(box, box) == pytest.approx(np.eye(2))


def test_the_mean_colour_is_that_of_the_bright_part_of_the_map():
    rgb = np.zeros((20, 30, 3), np.uint8)
    rgb[:, :15] = (200, 30, 20)
    values = np.zeros((20, 30), np.uint8)
    values[:, :15] = 180
    assert patch_means(rgb, values, np.array([[5, 2, 25, 18]], np.float32)).tolist() == [
        [200, 30, 20]
    ]


def test_no_boxes_give_empty_tables():
    none = np.zeros((0, 4), np.float32)
    assert len(distinct_boxes(none, 0.5)) == 0
    assert len(suppressed_boxes(none, 0.5)) == 0
    rgb, values = np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.uint8)
    assert patch_means(rgb, values, none).shape == (0, 3)


@settings(max_examples=60, deadline=None)
@given(boxes)
def test_stacked_pairs_are_those_of_the_plain_comparison_of_all_pairs(rows):
    box = as_boxes(np.round(rows).tolist() if rows else rows)
    wanted = set()
    for i in range(len(box)):
        for j in range(i + 1, len(box)):
            a, b = (i, j) if box[i, 1] + box[i, 3] < box[j, 1] + box[j, 3] else (j, i)
            edge = max(0.15 * min(box[i, 2] - box[i, 0], box[j, 2] - box[j, 0]), 1.5)
            tall = min(box[i, 3] - box[i, 1], box[j, 3] - box[j, 1])
            apart = box[b, 1] - box[a, 3]
            near = np.abs(box[i, [0, 2]] - box[j, [0, 2]]).max() <= edge
            if near and -0.35 * tall <= apart <= max(0.35 * tall, 2.0):
                wanted.add(frozenset((i, j)))
    assert {frozenset(pair) for pair in stacked_pairs(box).tolist()} == wanted
