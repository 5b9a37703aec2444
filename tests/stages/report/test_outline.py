"""Outlines against scipy's labels, OpenCV's contours and known figures."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from wayside.stages.report.outline import (
    SAMPLES,
    resample_outline,
    trace_region,
    traced_sequences,
)


def box_of(slices):
    ys, xs = slices
    return np.array([xs.start, ys.start, xs.stop, ys.stop])


@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(
        lambda size: arrays(np.uint8, size, elements=st.integers(0, 1))
    )
)
def test_every_region_is_traced_by_its_box_alone(labels):
    for label in np.unique(labels):
        parts, _ = ndimage.label(labels == label)
        for number, slices in enumerate(ndimage.find_objects(parts), start=1):
            outline = trace_region(labels, box_of(slices))
            assert outline is not None
            filled = ndimage.binary_fill_holes(
                np.pad(parts == number, 1), structure=np.ones((3, 3))
            )[1:-1, 1:-1]
            # Each middle of an edge stands between a pixel of the region and one outside it.
            edges = edges_between(filled)
            assert {tuple(p) for p in outline.tolist()} == edges
            assert len(outline) == len(edges)


def edges_between(inside):
    ys, xs = np.nonzero(inside)
    padded = np.pad(inside, 1)
    edges = set()
    for y, x in zip(ys.tolist(), xs.tolist(), strict=True):
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            if not padded[y + 1 + dy, x + 1 + dx]:
                edges.add((x + dx / 2, y + dy / 2))
    return edges


def test_an_outline_runs_clockwise_as_seen():
    labels = np.zeros((9, 9), np.uint8)
    labels[2:5, 3:8] = 1
    u, v = trace_region(labels, np.array([3, 2, 8, 5])).T
    assert (u * np.roll(v, -1) - v * np.roll(u, -1)).sum() > 0


def test_a_box_that_no_region_fills_has_no_outline():
    labels = np.zeros((9, 9), np.uint8)
    labels[2:5, 3:8] = 1
    for box in (
        [3, 2, 7, 5],
        [2, 2, 8, 5],
        [3, 2, 8, 6],
        [-1, 0, 5, 5],
        [4, 4, 4, 6],
        [0, 0, 99, 9],
    ):
        assert trace_region(labels, np.array(box)) is None


def test_holes_do_not_show():
    labels = np.zeros((30, 30), np.uint8)
    labels[5:25, 5:25] = 1
    solid = trace_region(labels, np.array([5, 5, 25, 25]))
    labels[10:20, 10:20] = 2
    np.testing.assert_array_equal(trace_region(labels, np.array([5, 5, 25, 25])), solid)


def test_many_outlines_at_once_are_those_one_by_one():
    labels = np.zeros((40, 60), np.uint8)
    cv2.fillPoly(labels, [np.array([[10, 5], [20, 15], [10, 25], [2, 15]], np.int32)], 1)
    labels[8:20, 30:50] = 2
    parts = [ndimage.find_objects((labels == k).astype(int))[0] for k in (1, 2)]
    boxes = np.array([*(box_of(slices) for slices in parts), [5, 5, 9, 9]])
    sequences = traced_sequences(labels, boxes)
    assert sequences.shape == (3, SAMPLES)
    assert np.isnan(sequences[2]).all()
    for sequence, box in zip(sequences[:2], boxes, strict=False):
        np.testing.assert_array_equal(sequence, resample_outline(trace_region(labels, box)))


def test_no_rows_give_no_outlines():
    assert traced_sequences(np.zeros((9, 9), np.uint8), np.zeros((0, 4))).shape == (
        0,
        SAMPLES,
    )


def test_resampled_points_lie_at_equal_steps_on_the_outline():
    sequence = resample_outline(np.array([[0, 0], [0, 8], [8, 8], [8, 0.0]]), samples=16)
    np.testing.assert_allclose(np.abs(np.diff(sequence, append=sequence[:1])), 2)
    assert np.linalg.norm(sequence.mean() - (4 + 4j)) < 1e-12


def test_other_layouts_are_refused():
    with pytest.raises(ValueError, match=r"labels: .* instead of"):
        traced_sequences(np.zeros((9, 9, 3), np.uint8), np.array([[1, 1, 9, 9]]))
