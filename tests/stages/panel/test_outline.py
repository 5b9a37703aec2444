import dataclasses

import cv2
import numpy as np
import pytest

from wayside.stages.panel.outline import (
    FaceOutline,
    Outline,
    fit_face_outline,
    outline_candidates,
    settle_sides,
)
from wayside.stages.panel.outline_edges import gradients_of
from wayside.stages.panel.outline_shapes import OUTLINE_SHAPES, box_round, segments_of

from ..made_frames import OUTLINE_MODEL

ROWS, COLUMNS, SCALE = 110, 120, 8
ANGLES = (np.arange(8) + 0.5) * np.pi / 4
CORNERS = {
    "rectangle": [(-1, -1), (1, -1), (1, 1), (-1, 1)],
    "diamond": [(0, -1), (1, 0), (0, 1), (-1, 0)],
    "octagon": np.column_stack([np.cos(ANGLES), np.sin(ANGLES)]) / np.cos(np.pi / 8),
}


def polygon(shape, middle, half, rotation=0.0):
    c, s = np.cos(rotation), np.sin(rotation)
    corners = np.array(CORNERS[shape]) * half
    return corners @ np.array([[c, s], [-s, c]]) + middle


def painted(layers, seed):
    """A view: polygons over a background of its own, drawn large and shrunk, with the blur of a lens."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 200, (6, 7, 3)).astype(np.uint8)
    size = (COLUMNS * SCALE * 2, ROWS * SCALE * 2)
    image = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    left, top = rng.integers(0, size[0] // 2), rng.integers(0, size[1] // 2)
    image = image[top : top + ROWS * SCALE, left : left + COLUMNS * SCALE].copy()
    for corners, color in layers:
        at = np.round(((corners + 0.5) * SCALE - 0.5) * 16).astype(np.int32)
        cv2.fillPoly(image, [at], color, cv2.LINE_AA, 4)
    small = cv2.resize(image, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small.astype(np.float32), (0, 0), 0.6)


def views_of(shape, middle, half, rotation=0.0, rim=2.0, behind=()):
    """Three views of a yellow face with a black line inside a yellow rim, each before another background.

    behind: polygons and colours between the background and the face.
    """
    apothem = np.sqrt(2) if shape == "diamond" else 1.0
    insets = (0, rim, 2 * rim) if rim else (0,)
    halves = [np.asarray(half) - inset * apothem for inset in insets]
    colors = (240, 180, 20), (20, 20, 20), (240, 180, 20)
    face = [(polygon(shape, middle, h, rotation), c) for h, c in zip(halves, colors, strict=False)]
    layers = [*behind, *face]
    return np.stack([painted(layers, seed) for seed in range(3)])


def size_of(box):
    return box[2:] - box[:2]


def around(middle, half):
    return np.concatenate([np.asarray(middle) - half, np.asarray(middle) + half])


@pytest.mark.parametrize("shape", OUTLINE_SHAPES)
def test_segments_lie_on_the_outline_and_face_outwards(shape):
    box = np.array([20.0, 30.0, 80.0, 70.0])
    segments = segments_of(shape, box)
    middles = (segments.begin + segments.end) / 2
    assert ((middles - [50, 50]) * segments.normal).sum(axis=1).min() > 0
    along = ((segments.end - segments.begin) * segments.normal).sum(axis=1)
    np.testing.assert_allclose(along, 0, atol=1e-9)
    assert np.abs(middles - 50).max() < 31
    np.testing.assert_allclose(box_round(shape, box, 0.0), box, atol=1e-9)


@pytest.mark.parametrize("shape", ["rectangle", "diamond", "octagon", "pennant"])
def test_offsets_change_as_the_jacobian_says(shape):
    box, rotation, small = np.array([20.0, 30.0, 80.0, 70.0]), 0.05, 1e-4
    segments = segments_of(shape, box, rotation)
    middles = (segments.begin + segments.end) / 2
    for k in range(5):
        there = segments_of(shape, box + small * np.eye(5)[k, :4], rotation + small * (k == 4))
        moved = ((there.begin + there.end) / 2 - middles) / small
        rate = (moved * segments.normal).sum(axis=1)
        tolerance = 0.12 if k == 4 else 0.03  # a rotation is about the box before
        np.testing.assert_allclose(rate, segments.jacobian[:, k], atol=tolerance)


@pytest.mark.parametrize("seed", range(12))
def test_no_outline_of_a_narrow_face_is_less_than_a_sample_wide(seed):
    rng = np.random.default_rng(seed)
    middle, half = np.array([60.0, 54.0]) + rng.uniform(-1, 1, 2), rng.uniform(0.6, 3, 2)
    views = views_of(str(rng.choice(list(CORNERS))), middle, half, rim=0)
    edges, box = gradients_of(views), around(middle, half * rng.uniform(0.5, 1.2, 2))
    for outline in outline_candidates(views, edges, box)[0]:
        assert size_of(outline.box).min() >= 1


@pytest.mark.parametrize(
    ("shape", "half", "rotation_deg"),
    [
        ("rectangle", (32.4, 24.2), 0.0),
        ("rectangle", (30.0, 22.0), 4.0),
        ("diamond", (33.0, 33.0), 0.0),
        ("octagon", (30.2, 30.2), 0.0),
    ],
)
def test_the_outer_edge_of_the_rim_is_found_from_the_inner_field(shape, half, rotation_deg):
    middle, half = np.array([60.3, 54.7]), np.array(half)
    start = around(middle + 1.0, half * 0.92)
    views = views_of(shape, middle, half, np.radians(rotation_deg))
    face = fit_face_outline(views, start, OUTLINE_MODEL)
    assert face is not None
    assert face.shape == shape or {face.shape, shape} == {"octagon", "circle"}
    assert not rotation_deg or np.degrees(face.rotation) == pytest.approx(rotation_deg, abs=1.2)
    np.testing.assert_allclose(size_of(face.box), 2 * half, rtol=0.025)
    np.testing.assert_allclose((face.box[:2] + face.box[2:]) / 2, middle, atol=0.6)


def test_a_side_with_another_edge_beside_it_is_known_worse_than_the_others():
    middle, half = np.array([60.0, 54.0]), np.array([30.0, 22.0])
    shelf = (polygon("rectangle", middle + np.array([0, 1.5]), half), (120, 90, 20))
    alone, beside = (
        settle_sides(
            gradients_of(views_of("rectangle", middle, half, rim=0, behind=behind)),
            Outline("rectangle", around(middle, half), 1.0),
        )[1]
        for behind in ((), (shelf,))
    )
    assert beside[3] > 1.8 * alone[3]
    assert beside[3] > 1.8 * beside[:3].max()
    np.testing.assert_allclose(beside[:3], alone[:3], rtol=0.1)


def test_the_errors_of_size_and_centre_are_those_of_the_sides():
    covariance = np.diag([0.0, 0.0, 0.0, 4.0])
    face = FaceOutline("rectangle", np.array([10.0, 10.0, 50.0, 40.0]), 0.0, 1.0, covariance)
    np.testing.assert_allclose(face.size_sigma, [0, 2])
    np.testing.assert_allclose(face.centre_sigma, [0, 1])
    shifted = face._replace(covariance=np.full((4, 4), 4.0))
    np.testing.assert_allclose(shifted.size_sigma, [0, 0])
    np.testing.assert_allclose(shifted.centre_sigma, [2, 2])


def test_the_other_outlines_that_a_face_may_have_count_in_its_errors():
    middle, half = np.array([60.0, 54.0]), np.array([30.0, 22.0])
    views = views_of("rectangle", middle, half)
    undecided = dataclasses.replace(OUTLINE_MODEL, weights=0.0 * OUTLINE_MODEL.weights)
    start = around(middle, half * 0.95)
    decided, either = (
        fit_face_outline(views, start, model) for model in (OUTLINE_MODEL, undecided)
    )
    assert (either.size_sigma > 2 * decided.size_sigma).all()


def test_no_face_has_an_outline_on_an_even_wall():
    views = np.full((2, ROWS, COLUMNS, 3), 120, np.float32)
    face = fit_face_outline(views, np.array([40.0, 40.0, 80.0, 70.0]), OUTLINE_MODEL)
    assert face is None or face.strength < 0.1


def test_arrays_of_another_type_or_shape_are_refused():
    views, box = np.zeros((1, 10, 10, 3), np.float32), np.zeros(4)
    with pytest.raises(ValueError, match="views"):
        gradients_of(views.astype(np.uint8))
    with pytest.raises(ValueError, match="gradients"):
        outline_candidates(views, views, box)
    with pytest.raises(ValueError, match="gradients"):
        settle_sides(views, Outline("rectangle", box, 1.0))
    with pytest.raises(ValueError, match="shape"):
        outline_candidates(views, gradients_of(views), box[:3])
