import numpy as np
import pytest

from wayside.stages.mapping.association import (
    MISS_COST,
    VALUE_SHIFT,
    Association,
    Hypotheses,
    associate_free,
    pair_hypotheses,
)

from .made_windows import GAP_PX, standing, window

PANEL = (3.5, -1.0, 60.0, 0.7, 0.7, 1.0)


def associate(s, landmark, free, gap_px):
    found = Association(np.empty((1, len(s.rotation)), np.int32), np.empty(1, int), np.empty(1))
    associate_free(s, landmark.point, landmark.size, free, gap_px, found)
    return found


def paired(boxes):
    """Hypotheses of the first and the last of some frames, and the rows of each."""
    return pair_hypotheses(window(boxes), range(1), len(boxes) - 1, GAP_PX)


def hypothesis(point=PANEL[:3]):
    return Hypotheses(np.array([point]), np.array([[0.7, 0.7]]), np.zeros(1, bool))


def test_a_hypothesis_lies_where_the_rays_meet():
    rows, found = paired(standing([(3.5, -1.0, 60.0, 0.7, 0.9, 1.0)], 3))
    np.testing.assert_allclose(found.point, [[3.5, -1.0, 60.0]], atol=1e-9)
    np.testing.assert_allclose(found.size, [[0.7, 0.9]], atol=1e-9)
    assert rows.tolist() == [[0, 2]]


@pytest.mark.parametrize(
    ("first", "second", "count"),
    [
        ((60.0, -1.0, 60.0, 0.7, 0.7), (60.0, -1.0, 52.0, 0.7, 0.7), 0),  # implausible places
        ((3.5, 6.5, 60.0, 0.7, 0.7), (3.5, 6.5, 52.0, 0.7, 0.7), 0),
        ((3.5, -18.0, 60.0, 0.7, 0.7), (3.5, -18.0, 52.0, 0.7, 0.7), 0),
        ((3.5, -1.0, 60.0, 0.1, 0.1), (3.5, -1.0, 52.0, 0.1, 0.1), 0),  # and sizes
        ((3.5, -1.0, 40.0, 0.16, 0.13), (3.5, -1.0, 32.0, 0.16, 0.13), 1),  # smallest plaques
        ((3.5, -1.0, 40.0, 0.7, 0.7), (3.5, -1.4, 32.0, 0.7, 0.7), 0),  # rays that pass by
        ((3.5, -1.0, 40.0, 0.7, 0.7), (3.5, -1.0, 32.0, 0.7, 1.0), 0),  # growth of no panel
    ],
)
def test_only_plausible_panels_make_hypotheses(first, second, count):
    assert len(paired([[(*first, 1.0)], [(*second, 1.0)]])[0]) == count


def test_a_face_and_a_back_make_no_hypothesis():
    s = window(standing([PANEL], 2))
    s.table["back"] = False, True
    assert len(pair_hypotheses(s, range(1), 1, GAP_PX)[0]) == 0


def test_candidates_that_are_no_seeds_join_but_make_no_hypothesis():
    s = window(standing([PANEL], 3))
    s.table["seed"] = False, True, True
    assert len(pair_hypotheses(s, range(1), 1, GAP_PX)[0]) == 0
    _, found = pair_hypotheses(s, range(1, 2), 2, GAP_PX)
    assert associate(s, found, np.ones(3, bool), GAP_PX).row.tolist() == [[0, 1, 2]]


def test_assigned_candidates_are_not_associated_and_missed():
    s, landmark = window(standing([PANEL], 3)), hypothesis()
    all_free = associate(s, landmark, np.ones(3, bool), GAP_PX)
    found = associate(s, landmark, np.array([True, False, True]), GAP_PX)
    assert found.row.tolist() == [[0, -1, 2]]
    assert found.missed.tolist() == [1]
    assert all_free.value[0] - found.value[0] == pytest.approx(1.0 + VALUE_SHIFT + MISS_COST)


def test_of_two_boxes_at_the_point_the_better_scored_is_associated():
    boxes = standing([PANEL], 2)
    boxes[0].append((3.5, -1.0, 60.0, 0.71, 0.71, 3.0))
    found = associate(window(boxes), hypothesis(), np.ones(3, bool), GAP_PX)
    assert found.row.tolist() == [[1, 2]]


def test_a_point_outside_the_image_is_not_expected():
    landmark = hypothesis([6.0, -1.0, 30.0])
    found = associate(window([[], [], [], []]), landmark, np.zeros(0, bool), GAP_PX)
    assert found.missed.tolist() == [3]
