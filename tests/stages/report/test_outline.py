"""Outlines against scipy's labels, OpenCV's contours and known figures."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from wayside.schemas.settings import RegionOutlineSettings
from wayside.stages.report.outline import (
    SAMPLES,
    _outline_in_box,
    _resample,
    _trace_box,
    region_sequences,
    traced_sequences,
)

SETTINGS = RegionOutlineSettings()


def region_outline(rgb, box, mean_rgb):
    """The outline (n, 2) before it is resampled; None where there is none."""
    points = np.empty((SETTINGS.longest_edges, 2))
    color = np.asarray(mean_rgb, np.float32)
    n = _outline_in_box(rgb, box, color, SETTINGS.margin, SETTINGS.longest_side_px, points)
    return points[:n] if n else None


def trace_region(labels, box):
    """The outline (n, 2) before it is resampled; None where there is none."""
    points = np.empty((SETTINGS.longest_edges, 2))
    n = _trace_box(labels, box, points)
    return points[:n].copy() if n else None


def resample_outline(outline, samples=SAMPLES):
    sequence = np.full(samples, complex(np.nan, np.nan))
    _resample(outline, sequence)
    return sequence


def box_of(slices):
    ys, xs = slices
    return np.array([xs.start, ys.start, xs.stop, ys.stop])


@settings(deadline=None)
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


def face(corners, color=(200, 170, 40), size=(120, 160), noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    rgb = np.empty((*size, 3))
    rgb[: size[0] // 2], rgb[size[0] // 2 :] = (150, 180, 220), (60, 80, 50)
    picture = rgb.astype(np.uint8)
    cv2.fillPoly(picture, [np.array(corners, np.int32)], color)
    return np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8)


DIAMOND = [[80, 30], [110, 60], [80, 90], [50, 60]]


@pytest.mark.parametrize("noise", [0, 8])
def test_a_face_before_a_mixed_background_is_outlined(noise):
    rgb = face(DIAMOND, noise=noise)
    outline = region_outline(rgb, np.array([50, 30, 111, 91]), np.array([200, 170, 40]))
    filled = np.zeros(rgb.shape[:2], np.uint8)
    cv2.fillPoly(filled, [np.rint(outline).astype(np.int32)], 1)
    wanted = np.zeros_like(filled)
    cv2.fillPoly(wanted, [np.array(DIAMOND, np.int32)], 1)
    assert (filled & wanted).sum() / (filled | wanted).sum() > 0.93


def test_a_legend_inside_a_face_is_filled():
    rgb = face(DIAMOND)
    rgb[50:70, 70:90] = 20
    outline = region_outline(rgb, np.array([50, 30, 111, 91]), np.array([200, 170, 40]))
    assert outline[:, 0].min() == pytest.approx(49.5, abs=1)
    assert cv2.contourArea(outline.astype(np.float32)) == pytest.approx(1800, rel=0.06)


def test_a_large_face_is_looked_at_in_steps_and_stands_where_it_is():
    rgb = face([[100, 80], [500, 80], [500, 380], [100, 380]], size=(480, 640))
    outline = region_outline(rgb, np.array([100, 80, 501, 381]), np.array([200, 170, 40]))
    assert len(outline) < 500
    np.testing.assert_allclose(outline.min(axis=0), [100, 80], atol=5)
    np.testing.assert_allclose(outline.max(axis=0), [500, 380], atol=5)


def test_boxes_at_the_border_are_cut_and_those_outside_have_no_outline():
    rgb = face([[-10, 20], [30, 20], [30, 50], [-10, 50]])
    outline = region_outline(rgb, np.array([-10, 20, 31, 51]), np.array([200, 170, 40]))
    np.testing.assert_allclose(outline.max(axis=0), [30.5, 50.5], atol=1)
    for box in ([500, 0, 520, 10], [-30, 0, 0, 10], [5, 5, 5, 9]):
        assert region_outline(rgb, np.array(box), np.array([200, 170, 40])) is None


def test_many_outlines_at_once_are_those_one_by_one():
    rgb = face(DIAMOND, noise=5)
    boxes = np.array([[50, 30, 111, 91], [500, 0, 520, 10], [60, 40, 90, 80]])
    colors = np.array([[200, 170, 40]] * 3)
    sequences = region_sequences(rgb, boxes, colors, SETTINGS)
    assert sequences.shape == (3, SAMPLES)
    assert np.isnan(sequences[1]).all()
    for i in (0, 2):
        outline = region_outline(rgb, boxes[i], colors[i])
        np.testing.assert_array_equal(sequences[i], resample_outline(outline))
    labels = (rgb[..., 2] < 70).astype(np.uint8)
    parts, _ = ndimage.label(labels)
    traced = traced_sequences(
        labels, np.array([box_of(s) for s in ndimage.find_objects(parts)]), SETTINGS
    )
    assert np.isfinite(traced).all()


def test_no_rows_give_no_outlines():
    rgb = face(DIAMOND)
    assert region_sequences(rgb, np.zeros((0, 4)), np.zeros((0, 3)), SETTINGS).shape == (0, SAMPLES)


def test_resampled_points_lie_at_equal_steps_on_the_outline():
    sequence = resample_outline(np.array([[0, 0], [0, 8], [8, 8], [8, 0.0]]), samples=16)
    np.testing.assert_allclose(np.abs(np.diff(sequence, append=sequence[:1])), 2)
    assert np.linalg.norm(sequence.mean() - (4 + 4j)) < 1e-12


def test_other_layouts_are_refused():
    rgb, box = face(DIAMOND), np.array([[1, 1, 9, 9]])
    with pytest.raises(ValueError, match="C-contiguous"):
        region_sequences(rgb[:, ::2], box, np.zeros((1, 3)), SETTINGS)
    with pytest.raises(ValueError, match="labels: wanted"):
        traced_sequences(rgb, box, SETTINGS)
    with pytest.raises(ValueError, match="mean_rgb: wanted"):
        region_sequences(rgb, box, np.zeros((1, 4)), SETTINGS)
