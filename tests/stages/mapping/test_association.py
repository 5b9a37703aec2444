from dataclasses import replace

import numpy as np
import pytest

from wayside.stages.mapping.association import MISS_COST, MISSED, VALUE_SHIFT, associate
from wayside.stages.mapping.hypotheses import pair_hypotheses


def test_candidates_that_are_no_seeds_join_but_make_no_hypothesis(gap_px, window, standing):
    s = replace(
        window(standing([(3.5, -1.0, 60.0, 0.7, 0.7, 1.0)], 3)), seeds=np.array([False, True, True])
    )
    assert len(pair_hypotheses(s, 0, 1, gap_px).point) == 0
    pairs = pair_hypotheses(s, 1, 2, gap_px)
    found = associate(s, pairs.point, pairs.size, np.ones(3, bool), gap_px)
    assert found.row.tolist() == [[0, 1, 2]]


def test_assigned_candidates_are_not_associated_and_missed(gap_px, window, standing):
    s = window(standing([(3.5, -1.0, 60.0, 0.7, 0.7, 1.0)], 3))
    landmark = np.array([[3.5, -1.0, 60.0]]), np.array([[0.7, 0.7]])
    all_free = associate(s, *landmark, np.ones(3, bool), gap_px)
    found = associate(s, *landmark, np.array([True, False, True]), gap_px)
    assert found.row.tolist() == [[0, -1, 2]]
    assert found.state[0, 1] == MISSED
    assert all_free.value[0] - found.value[0] == pytest.approx(1.0 + VALUE_SHIFT + MISS_COST)
    assert found.views().tolist() == [2]


def test_of_two_boxes_at_the_point_the_better_scored_is_associated(gap_px, window, standing):
    boxes = standing([(3.5, -1.0, 60.0, 0.7, 0.7, 1.0)], 2)
    boxes[0].append((3.5, -1.0, 60.0, 0.71, 0.71, 3.0))
    s = window(boxes)
    found = associate(s, [[3.5, -1.0, 60.0]], [[0.7, 0.7]], np.ones(3, bool), gap_px)
    assert found.row.tolist() == [[1, 2]]


def test_a_point_outside_the_image_is_not_expected(gap_px, window):
    s = window([[], [], [], []])
    found = associate(s, [[6.0, -1.0, 30.0]], [[0.7, 0.7]], np.zeros(0, bool), gap_px)
    assert found.state.tolist() == [[MISSED, MISSED, MISSED, 0]]


def test_shapes_that_kernels_would_run_over_are_refused(gap_px, window, standing):
    s = window(standing([(3.5, -1.0, 60.0, 0.7, 0.7, 1.0)], 3))
    with pytest.raises(ValueError, match="usable have shapes"):
        associate(s, np.zeros((1, 3)), np.zeros((1, 2)), np.ones(2, bool), gap_px)
    with pytest.raises(ValueError, match="not below 3"):
        pair_hypotheses(s, 0, 3, gap_px)
    with pytest.raises(ValueError, match="score"):
        replace(s, score=np.zeros(2))
    with pytest.raises(ValueError, match="first"):
        replace(s, first=np.array([0, 2, 1, 3]))
