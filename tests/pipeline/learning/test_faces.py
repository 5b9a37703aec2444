"""Outlines of faces by their boxes, as samples of shapes."""

import cv2
import numpy as np
import pytest

from wayside.pipeline.learning.faces import box_outline


def points(outline):
    return np.column_stack([outline.real, outline.imag])


def face(corners, color=(200, 170, 40), size=(120, 160), noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    rgb = np.empty((*size, 3))
    rgb[: size[0] // 2], rgb[size[0] // 2 :] = (150, 180, 220), (60, 80, 50)
    image = rgb.astype(np.uint8)
    cv2.fillPoly(image, [np.array(corners, np.int32)], color)
    return np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


DIAMOND = [[80, 30], [110, 60], [80, 90], [50, 60]]


@pytest.mark.parametrize("noise", [0, 8])
def test_a_face_before_a_mixed_background_is_outlined(noise):
    rgb = face(DIAMOND, noise=noise)
    outline = box_outline(rgb, np.array([50, 30, 111, 91]), np.array([200, 170, 40]))
    filled = np.zeros(rgb.shape[:2], np.uint8)
    cv2.fillPoly(filled, [np.rint(points(outline)).astype(np.int32)], 1)
    wanted = np.zeros_like(filled)
    cv2.fillPoly(wanted, [np.array(DIAMOND, np.int32)], 1)
    assert (filled & wanted).sum() / (filled | wanted).sum() > 0.93


def test_a_legend_inside_a_face_is_filled():
    rgb = face(DIAMOND)
    rgb[50:70, 70:90] = 20
    outline = box_outline(rgb, np.array([50, 30, 111, 91]), np.array([200, 170, 40]))
    assert outline.real.min() == pytest.approx(49.5, abs=1)
    assert cv2.contourArea(points(outline).astype(np.float32)) == pytest.approx(1800, rel=0.06)


def test_a_large_face_is_looked_at_in_steps_and_stands_where_it_is():
    rgb = face([[100, 80], [500, 80], [500, 380], [100, 380]], size=(480, 640))
    outline = box_outline(rgb, np.array([100, 80, 501, 381]), np.array([200, 170, 40]))
    np.testing.assert_allclose(points(outline).min(axis=0), [100, 80], atol=5)
    np.testing.assert_allclose(points(outline).max(axis=0), [500, 380], atol=5)


def test_boxes_at_the_border_are_cut_and_those_outside_have_no_outline():
    rgb = face([[-10, 20], [30, 20], [30, 50], [-10, 50]])
    outline = box_outline(rgb, np.array([-10, 20, 31, 51]), np.array([200, 170, 40]))
    np.testing.assert_allclose(points(outline).max(axis=0), [30.5, 50.5], atol=1)
    for box in ([500, 0, 520, 10], [-30, 0, 0, 10], [5, 5, 5, 9]):
        assert np.isnan(box_outline(rgb, np.array(box), np.array([200, 170, 40]))).all()
