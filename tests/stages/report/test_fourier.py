"""Fourier descriptors do not change with place, size, direction and start; the oriented ones know which way is up."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.stages.report.fourier import SPACES, sequence_features, shape_dimensions
from wayside.stages.report.outline import SAMPLES, _resample


def shape_features(outline, space):
    """Features of one outline given by its corners."""
    sequence = np.full(SAMPLES, complex(np.nan, np.nan))
    _resample(np.asarray(outline, np.float64), sequence)
    return sequence_features(sequence[None], space)[0]


def polygon(corners, turn=0.0, radius=20.0):
    angle = turn + np.arange(corners) * 2 * np.pi / corners
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


HOUSE = np.array([[0.0, 30], [0, 12], [15, 0], [30, 12], [30, 30]])


def turned(outline, angle):
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return outline @ rotation.T


@settings(deadline=None)
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
    np.testing.assert_allclose(
        shape_features(moved, "fourier6"), shape_features(outline, "fourier6"), atol=4e-3
    )


def test_a_dense_outline_from_another_start_has_the_same_oriented_features():
    dense = np.concatenate(
        [
            np.linspace(a, b, 50, endpoint=False)
            for a, b in zip(HOUSE, np.roll(HOUSE, -1, 0), strict=True)
        ]
    )
    for start in (0, 7, 100, 233):
        np.testing.assert_allclose(
            shape_features(np.roll(dense, start, axis=0), "fourier6_oriented"),
            shape_features(HOUSE, "fourier6_oriented"),
            atol=0.02,
        )


def test_regular_polygons_have_the_upper_terms_of_theory():
    # Term 1 - n of a regular n-gon is 1 / (n - 1)^2 of the first, up to the samples' own aliasing.
    names = (-1, 2, -2, 3, -3, -4)
    for corners, at in ((3, -2), (4, -3), (5, -4)):
        features = shape_features(polygon(corners), "fourier6")
        assert features[names.index(at)] == pytest.approx(1 / (corners - 1) ** 2, rel=0.05)
        others = [f for f, k in zip(features, names, strict=True) if k != at]
        np.testing.assert_allclose(others, 0, atol=5e-3)


def test_the_reports_descriptors_confuse_a_diamond_with_a_square_and_the_oriented_ones_do_not():
    square, diamond = polygon(4, np.pi / 4), polygon(4)
    np.testing.assert_allclose(
        shape_features(square, "fourier6"), shape_features(diamond, "fourier6"), atol=1e-6
    )
    upright, standing = (shape_features(o, "fourier6_oriented") for o in (square, diamond))
    assert upright[6] == pytest.approx(-1 / 9, rel=0.05)
    assert standing[6] == pytest.approx(1 / 9, rel=0.05)
    assert (upright[9], standing[9]) == (pytest.approx(1, abs=0.03), pytest.approx(0.5, abs=0.03))


def test_aspect_is_signed_and_an_octagon_is_no_circle():
    wide = shape_features(polygon(4, np.pi / 4) * [2, 1], "fourier6_oriented")
    tall = shape_features(polygon(4, np.pi / 4) * [1, 2], "fourier6_oriented")
    assert wide[8] == pytest.approx(np.log(2), abs=0.05)
    assert tall[8] == pytest.approx(-np.log(2), abs=0.05)
    octagon, circle = (shape_features(polygon(n), "fourier6_oriented")[7] for n in (8, 500))
    assert octagon > 0.015
    assert circle < 1e-3


@pytest.mark.parametrize("space", SPACES)
def test_an_outline_without_length_has_no_finite_features_and_no_warning(space):
    features = shape_features(np.ones((5, 2)), space)
    assert features.shape == (shape_dimensions(space),)
    assert not np.isfinite(features).any()


def test_unknown_spaces_are_refused():
    with pytest.raises(ValueError, match="shape space: wanted one of"):
        shape_features(HOUSE, "moments")
