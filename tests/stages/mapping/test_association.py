from dataclasses import replace

import numpy as np
import pytest

from wayside.stages.mapping.association import EMPTY, Gates, Sightings, associate, link

GATES = Gates()


def window(boxes, spacing=8.0, focal=1400.0):
    """Frames straight ahead; boxes[f] lists (right, down, depth, width, height, score) in that camera's frame."""
    n = len(boxes)
    flat = np.array([b for frame in boxes for b in frame], float).reshape(-1, 6)
    return Sightings(
        rotation=np.repeat(np.eye(3)[None], n, axis=0),
        centre=np.array([[0.0, 0.0, spacing * k] for k in range(n)]),
        focal=np.full(n, focal),
        bounds=np.repeat([[-0.57, -0.43, 0.57, 0.43]], n, axis=0),
        first=np.cumsum([0, *map(len, boxes)]).astype(np.int64),
        ray=np.ascontiguousarray(flat[:, :2] / flat[:, 2:3]),
        size=np.ascontiguousarray(flat[:, 3:5] / flat[:, 2:3]),
        score=np.ascontiguousarray(flat[:, 5]),
        whole=np.ones(len(flat), bool),
        leads=np.ones(len(flat), bool),
    )


def standing(right, down, along, wide, tall, frames, score=1.0):
    return [[(right, down, along - 8.0 * k, wide, tall, score)] for k in range(frames)]


def test_a_link_lies_where_the_rays_meet():
    s = window(standing(3.5, -1.0, 60.0, 0.7, 0.9, 3))
    links = link(s, 0, 2, GATES)
    np.testing.assert_allclose(links.point, [[3.5, -1.0, 60.0]], atol=1e-9)
    np.testing.assert_allclose(links.size, [[0.7, 0.9]], atol=1e-9)
    assert (links.older.tolist(), links.newer.tolist()) == ([0], [2])


@pytest.mark.parametrize(
    ("right", "down", "wide", "tall"),
    [(40.0, -1.0, 0.7, 0.7), (3.5, 6.5, 0.7, 0.7), (3.5, -14.0, 0.7, 0.7), (3.5, -1, 0.1, 0.1)],
)
def test_implausible_places_and_sizes_are_not_linked(right, down, wide, tall):
    s = window(standing(right, down, 60.0, wide, tall, 2))
    assert len(link(s, 0, 1, GATES).point) == 0


def test_the_smallest_plaques_are_linked():
    assert len(link(window(standing(3.5, -1.0, 40.0, 0.16, 0.13, 2)), 0, 1, GATES).point) == 1


def test_rays_that_pass_each_other_are_not_linked():
    boxes = standing(3.5, -1.0, 40.0, 0.7, 0.7, 2)
    boxes[1] = [(3.5, -1.4, 32.0, 0.7, 0.7, 1.0)]
    assert len(link(window(boxes), 0, 1, GATES).point) == 0


def test_sizes_that_do_not_grow_as_they_must_are_not_linked():
    boxes = standing(3.5, -1.0, 40.0, 0.7, 0.7, 2)
    boxes[1] = [(3.5, -1.0, 32.0, 0.7, 1.0, 1.0)]
    assert len(link(window(boxes), 0, 1, GATES).point) == 0


def test_those_that_may_not_lead_propose_nothing_but_join():
    s = replace(window(standing(3.5, -1.0, 60.0, 0.7, 0.7, 3)), leads=np.array([False, True, True]))
    assert len(link(s, 0, 1, GATES).point) == 0
    links = link(s, 1, 2, GATES)
    found = associate(s, links.point, links.size, np.ones(3, bool), GATES)
    assert found.row.tolist() == [[0, 1, 2]]


def test_taken_candidates_are_left_alone_and_missed():
    s = window(standing(3.5, -1.0, 60.0, 0.7, 0.7, 3))
    place = np.array([[3.5, -1.0, 60.0]]), np.array([[0.7, 0.7]])
    all_free = associate(s, *place, np.ones(3, bool), GATES)
    found = associate(s, *place, np.array([True, False, True]), GATES)
    assert found.row.tolist() == [[0, -1, 2]]
    assert found.state[0, 1] == EMPTY
    assert all_free.total[0] - found.total[0] == pytest.approx(1.0 + GATES.value_shift + GATES.miss)
    assert found.views().tolist() == [2]


def test_of_two_boxes_at_the_place_the_better_scored_is_taken():
    boxes = standing(3.5, -1.0, 60.0, 0.7, 0.7, 2)
    boxes[0].append((3.5, -1.0, 60.0, 0.71, 0.71, 3.0))
    s = window(boxes)
    found = associate(s, [[3.5, -1.0, 60.0]], [[0.7, 0.7]], np.ones(3, bool), GATES)
    assert found.row.tolist() == [[1, 2]]


def test_a_place_out_of_the_picture_is_not_expected():
    s = window([[], [], [], []])
    found = associate(s, [[6.0, -1.0, 30.0]], [[0.7, 0.7]], np.zeros(0, bool), GATES)
    assert found.state.tolist() == [[EMPTY, EMPTY, EMPTY, 0]]


def test_shapes_that_kernels_would_run_over_are_refused():
    s = window(standing(3.5, -1.0, 60.0, 0.7, 0.7, 3))
    with pytest.raises(ValueError, match="wanted"):
        associate(s, np.zeros((1, 3)), np.zeros((1, 2)), np.ones(2, bool), GATES)
    with pytest.raises(ValueError, match="frames below 3"):
        link(s, 0, 3, GATES)
    with pytest.raises(ValueError, match="score"):
        replace(s, score=np.zeros(2))
    with pytest.raises(ValueError, match="first"):
        replace(s, first=np.array([0, 2, 1, 3]))
