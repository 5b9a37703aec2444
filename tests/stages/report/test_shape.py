"""Outlines against SciPy's labels and hulls, their Fourier descriptors, and shape classes of drawn faces."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage
from scipy.spatial import ConvexHull

from wayside.schemas.detections import SHAPES, VERDICTS, Candidates, Detections
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import GateSettings, SegmentSettings
from wayside.stages.report.shape import (
    DESCRIPTORS,
    TERMS,
    Outlines,
    classify_shape,
    fourier_descriptors,
    resample_outline,
    trace_region,
)
from wayside.stages.segmentation.two_pass import segment

from ..made_frames import made_image


def shape_features(outline):
    """Features of one outline given by its corners, all of it filled."""
    points = resample_outline(np.asarray(outline) @ [1, 1j])
    return fourier_descriptors(Outlines(points[None], np.ones((1, 2))))[0]


def polygon(corners, turn=0.0, radius=20.0):
    angle = turn + np.arange(corners) * 2 * np.pi / corners
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


HOUSE = np.array([[0.0, 30], [0, 12], [15, 0], [30, 12], [30, 30]])


@given(
    st.sampled_from([HOUSE, polygon(3), polygon(4), polygon(8), HOUSE * [3, 1]]),
    st.tuples(st.floats(0.1, 50), st.floats(0.7, 1.4)),
    st.integers(0, 7),
)
def test_descriptors_ignore_scale_place_and_start_and_know_proportions(outline, scale, start):
    size, wider = scale
    moved = np.roll(outline, start, axis=0) * [size * wider, size] + [300, -40]
    features = shape_features(outline)
    features[2 * len(TERMS)] += np.log(wider)
    # Samples of the other lie between those of one and cut its corners elsewhere, hence not exactly.
    np.testing.assert_allclose(shape_features(moved), features, atol=0.05)


@pytest.mark.parametrize(("corners", "turn"), [(4, 0), (4, np.pi / 4), (8, np.pi / 8)])
def test_upright_polygons_have_the_terms_of_theory(corners, turn):
    # Those of a regular n-gon with a corner at angle a are exp(i (1 - k) a) / k^2, k = 1 - n, 1 + n, 1 - 2n, ...
    k = np.array(TERMS)
    theory = np.where((k - 1) % corners == 0, np.exp(1j * (1 - k) * turn) / k**2, 0)
    real, imaginary = shape_features(polygon(corners, turn))[: 2 * len(TERMS)].reshape(2, -1)
    np.testing.assert_allclose(real + 1j * imaginary, theory, rtol=0.05, atol=5e-3)


@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(
        lambda size: arrays(np.uint8, size, elements=st.integers(0, 1))
    )
)
def test_every_region_is_traced_by_its_box_alone(labels):
    for label in np.unique(labels):
        parts, _ = ndimage.label(labels == label)
        for number, (ys, xs) in enumerate(ndimage.find_objects(parts), start=1):
            box = np.array([xs.start, ys.start, xs.stop, ys.stop])
            outline, filled = trace_region(labels, box)
            middles = [
                (x + dx / 2, y + dy / 2)
                for y, x in np.argwhere(parts == number).tolist()
                for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1))
            ]
            hull = ConvexHull(middles)
            assert {tuple(p) for p in outline.tolist()} >= {middles[i] for i in hull.vertices}
            areas = [(parts == number).sum(), ndimage.binary_fill_holes(parts == number).sum()]
            assert np.array(filled) * hull.volume == pytest.approx(areas, rel=1e-5)


OUTLINES = {
    "diamond": polygon(4, radius=1),
    "octagon": polygon(8, np.pi / 8, radius=1),
    "triangle": polygon(3, -np.pi / 2, radius=1),
    "rectangle": polygon(4, np.pi / 4, radius=1),
}
YELLOW = (220, 180, 30)


def model(distance=4.0):
    """Accepts up to a distance from a class, all other outlines being as likely as each other."""
    spread = np.eye(DESCRIPTORS) * 0.06**2
    classes = tuple(
        GaussianClass(name, shape_features(outline), spread, 1)
        for name, outline in OUTLINES.items()
    )
    least = -(distance**2 + np.linalg.slogdet(2 * np.pi * spread)[1]) / 2
    return GaussianModel("fourier8", classes, "test", threshold=least - np.log(len(classes)))


def drawn(names, radius=24):
    """Faces side by side before a plain background."""
    rgb = np.full((100, 100 * len(names), 3), (90, 120, 150), np.uint8)
    for i, name in enumerate(names):
        corners = OUTLINES[name] * radius + [100 * i + 50, 50]
        cv2.fillPoly(rgb, [np.rint(corners).astype(np.int32)], YELLOW)
    return made_image(rgb)


def candidates_of(image):
    """The faces as candidates of pass one, from left to right."""
    (one,) = segment(iter([image]), SegmentSettings(clusters=2), GateSettings())
    yellow = np.abs(one.regions.rgb - YELLOW).max(axis=1) < 20
    regions = one.regions.select(yellow & (one.regions.source == 0))
    return Detections(one, Candidates.of(regions.select(np.argsort(regions.box[:, 0]))))


def classify(item, **how):
    (result,) = classify_shape(iter([item]), model=model(**how))
    return result.candidates


@pytest.mark.parametrize("radius", [9, 24, 40])
def test_drawn_faces_get_their_shape(radius):
    names = list(OUTLINES)
    candidates = classify(candidates_of(drawn(names, radius)))
    assert [SHAPES[s] for s in candidates.shape] == names
    assert (candidates.verdict == 0).all()


def test_a_shape_far_from_every_class_stops_at_shape():
    candidates = classify(candidates_of(drawn(["octagon"])), distance=1e-4)
    assert VERDICTS[candidates.verdict[0]] == "shape"
    assert candidates.shape_distance[0] > 0


def test_candidates_that_stopped_before_are_left_alone():
    item = candidates_of(drawn(["octagon", "diamond"]))
    stopped = np.array([VERDICTS.index("color"), 0], np.uint8)
    candidates = classify(replace(item, candidates=replace(item.candidates, verdict=stopped)))
    assert candidates.verdict.tolist() == stopped.tolist()
    assert candidates.shape[0] == -1
    assert np.isnan(candidates.shape_distance[0])
