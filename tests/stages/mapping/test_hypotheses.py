import numpy as np
import pytest

from wayside.stages.mapping.hypotheses import pair_hypotheses


def test_a_hypothesis_lies_where_the_rays_meet(gap_px, window, standing):
    s = window(standing([(3.5, -1.0, 60.0, 0.7, 0.9, 1.0)], 3))
    pairs = pair_hypotheses(s, 0, 2, gap_px)
    np.testing.assert_allclose(pairs.point, [[3.5, -1.0, 60.0]], atol=1e-9)
    np.testing.assert_allclose(pairs.size, [[0.7, 0.9]], atol=1e-9)
    assert (pairs.older.tolist(), pairs.newer.tolist()) == ([0], [2])


@pytest.mark.parametrize(
    ("right", "down", "wide", "tall"),
    [(60.0, -1.0, 0.7, 0.7), (3.5, 6.5, 0.7, 0.7), (3.5, -18.0, 0.7, 0.7), (3.5, -1, 0.1, 0.1)],
)
def test_implausible_points_and_sizes_make_no_hypothesis(
    right, down, wide, tall, gap_px, window, standing
):
    s = window(standing([(right, down, 60.0, wide, tall, 1.0)], 2))
    assert len(pair_hypotheses(s, 0, 1, gap_px).point) == 0


def test_the_smallest_plaques_make_hypotheses(gap_px, window, standing):
    assert (
        len(
            pair_hypotheses(
                window(standing([(3.5, -1.0, 40.0, 0.16, 0.13, 1.0)], 2)), 0, 1, gap_px
            ).point
        )
        == 1
    )


def test_rays_that_pass_each_other_make_no_hypothesis(gap_px, window, standing):
    boxes = standing([(3.5, -1.0, 40.0, 0.7, 0.7, 1.0)], 2)
    boxes[1] = [(3.5, -1.4, 32.0, 0.7, 0.7, 1.0)]
    assert len(pair_hypotheses(window(boxes), 0, 1, gap_px).point) == 0


def test_sizes_that_do_not_grow_as_they_must_make_no_hypothesis(gap_px, window, standing):
    boxes = standing([(3.5, -1.0, 40.0, 0.7, 0.7, 1.0)], 2)
    boxes[1] = [(3.5, -1.0, 32.0, 0.7, 1.0, 1.0)]
    assert len(pair_hypotheses(window(boxes), 0, 1, gap_px).point) == 0
