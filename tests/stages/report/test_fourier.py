"""Fourier descriptors do not change with place, size, direction and start."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.stages.report.outline import TERMS, fourier_descriptors, resample_outline


def shape_features(outline):
    """Features of one outline given by its corners."""
    return fourier_descriptors(resample_outline(np.asarray(outline, np.float64))[None])[0]


def polygon(corners, turn=0.0, radius=20.0):
    angle = turn + np.arange(corners) * 2 * np.pi / corners
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


HOUSE = np.array([[0.0, 30], [0, 12], [15, 0], [30, 12], [30, 30]])


def turned(outline, angle):
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return outline @ rotation.T


@given(
    st.sampled_from([HOUSE, polygon(3), polygon(4), polygon(8), HOUSE * [3, 1]]),
    st.floats(0, 2 * np.pi),
    st.floats(0.1, 50),
    st.integers(0, 7),
    st.booleans(),
)
def test_descriptors_are_free_of_scale_rotation_place_and_start(
    outline, angle, scale, start, backwards
):
    moved = turned(np.roll(outline, start, axis=0), angle) * scale + [300, -40]
    if backwards:
        moved = moved[::-1]
    # A start between the samples of the other shifts them by part of a step, hence not exactly.
    np.testing.assert_allclose(shape_features(moved), shape_features(outline), atol=4e-3)


def test_regular_polygons_have_the_upper_terms_of_theory():
    # Term 1 - n of a regular n-gon is 1 / (n - 1)^2 of the first, up to the samples' own aliasing.
    for corners, at in ((3, -2), (4, -3), (5, -4)):
        features = shape_features(polygon(corners))
        assert features[TERMS.index(at)] == pytest.approx(1 / (corners - 1) ** 2, rel=0.05)
        others = [f for f, k in zip(features, TERMS, strict=True) if k != at]
        np.testing.assert_allclose(others, 0, atol=5e-3)


def test_the_descriptors_confuse_a_diamond_with_a_square():
    square, diamond = polygon(4, np.pi / 4), polygon(4)
    np.testing.assert_allclose(shape_features(square), shape_features(diamond), atol=1e-6)


def test_an_outline_without_length_has_no_finite_features_and_no_warning():
    features = shape_features(np.ones((5, 2)))
    assert features.shape == (len(TERMS),)
    assert not np.isfinite(features).any()
