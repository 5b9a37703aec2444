"""The code of a sign by colour, shape, size and face, and the system of a drive."""

from dataclasses import replace
from unittest.mock import ANY

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.settings import CodeSettings
from wayside.schemas.sign_catalogue import CATALOGUE, INCH_M, SERIES, SYSTEMS
from wayside.schemas.signs import Sign
from wayside.stages.sign_codes import OTHER_FACE, assign_codes

from ...made_landmarks import made_landmark

FACES = (
    OTHER_FACE,
    *sorted({f for signs in CATALOGUE.values() for one in signs for f in one.faces}),
)
US = CodeSettings(system="us")


def sure(names, name, wrong=0.01):
    others = np.full(len(names), wrong / (len(names) - 1))
    others[names.index(name)] = 1 - wrong
    return tuple(np.log(others).tolist())


def sign(color, shape, width_in, height_in, sigma_in=0.3, **changes):
    known = {
        "color_log_probability": () if color is None else sure(COLORS, color),
        "shape_log_probability": () if shape is None else sure(SHAPES, shape),
    }
    landmark = made_landmark(color=color, shape=shape, **{**known, **changes})
    size = (width_in * INCH_M, height_in * INCH_M, sigma_in * INCH_M, sigma_in * INCH_M)
    where = (np.zeros(3), np.eye(3), np.zeros(3), np.eye(3))
    return Sign(1, 1, landmark, "sign", 0.9, *where, 12.0, 3.0, 2.0, 1.6, *size, None)


def code(one, settings=US, classes=()):
    (coded,) = assign_codes(iter([one]), settings=settings, classes=classes)
    return coded.code


@pytest.mark.parametrize(
    ("system", "color", "shape", "size_in", "wanted", "nominal"),
    [
        ("us", "red", "octagon", (36, 36), "R1-1", (36, 36)),
        ("us", "red", "triangle", (36, 31.2), "R1-2", (36, 36)),
        ("us", "white", "crossbuck", (40.3, 40.3), "R15-1", (48, 9)),
        ("us", "fluorescent_yellow_green", "pentagon", (36, 36), "S1-1", (36, 36)),
        ("us", "yellow", "pennant", (44.5, 36), "W14-3", (48, 36)),
        ("us", "yellow", "circle", (36, 36), "W10-1", (36, 36)),
        ("us", "yellow", "diamond", (42.4, 42.4), "W", (30, 30)),
        ("us", "orange", "diamond", (67.9, 67.9), "TTC", (48, 48)),
        ("us", "green", "rectangle", (150, 90), "E", None),
        ("us", "green", "rectangle", (10, 27), "D10", (10, 27)),
        ("us", "blue", "shield", (24, 24), "M1-1", (24, 24)),
        ("us", "yellow", "rectangle", (12, 36), "OM3", (12, 36)),
        ("us", "black", "rectangle", (30, 30), "R", (30, 30)),
        ("vienna", "red", "octagon", (35.4, 35.4), "B2a", ANY),
        ("vienna", "yellow", "diamond", (27.8, 27.8), "B3", ANY),
        ("vienna", "red", "circle", (23.6, 23.6), "C1a", ANY),
        ("vienna", "white", "circle", (23.6, 23.6), "C", ANY),
        ("vienna", "white", "rectangle", (11.8, 39.4), "A29", ANY),
    ],
)
def test_what_colour_shape_and_size_tell_is_stated(system, color, shape, size_in, wanted, nominal):
    found = code(sign(color, shape, *size_in), CodeSettings(system=system))
    assert (found.system, found.code, found.nominal_in) == (system, wanted, nominal)
    assert found.probability >= US.settled


def test_a_face_that_fits_two_series_has_no_code_and_the_category_that_both_are_of():
    # a blue disc orders a direction, or forbids to stop
    for settings, *look, category in (
        (CodeSettings(system="vienna"), "blue", "circle", 23.6, 23.6, "regulatory"),
        (CodeSettings(), "red", "octagon", 29.5, 29.5, "regulatory"),  # of either system
        (US, None, "rectangle", 25, 40, 8.0, None),
    ):
        (found,) = assign_codes(iter([sign(*look)]), settings=settings)
        assert (found.code, found.category) == (None, category)


@pytest.mark.parametrize("size", [(33, 33, 3.0), (41, 41, 0.3), (np.nan, np.nan)])
def test_a_size_that_is_unknown_or_no_standard_leaves_the_code_to_colour_and_shape(size):
    found = code(sign("red", "octagon", *size))
    assert (found.code, found.nominal_in) == ("R1-1", None)


def test_named_classes_do_without_probabilities():
    plain = sign("red", "octagon", 36, 36, color_log_probability=(), shape_log_probability=())
    assert code(plain).code == "R1-1"


def test_no_sign_has_no_code():
    assert list(assign_codes(iter([]), settings=CodeSettings())) == []


def test_the_drive_settles_the_system_of_a_stop_sign():
    stop = sign("red", "octagon", 29.5, 29.5)
    alone = list(assign_codes(iter([stop]), settings=CodeSettings()))
    assert alone[0].code is None
    assert 0.1 < alone[0].us_probability < 0.9
    for other, system in (
        (sign("yellow", "diamond", 50.9, 50.9), "us"),
        (sign("white", "circle", 23.6, 23.6), "vienna"),
    ):
        coded = list(assign_codes(iter([stop, other, other]), settings=CodeSettings()))
        assert {one.code.system for one in coded} == {system}


def test_the_face_settles_what_size_and_colour_do_not():
    seen = sign(
        "white", "rectangle", 24, 30, face_log_probability=sure(FACES, "R2-1 45", wrong=1e-3)
    )
    found = code(seen, replace(US, settled=0.7), FACES)
    assert (found.code, found.legend) == ("R2-1", "45")
    unsure = replace(seen, landmark=replace(seen.landmark, face_log_probability=()))
    assert (code(unsure).code, code(unsure).legend) == ("R", None)


@given(
    st.sampled_from([None, *COLORS]),
    st.sampled_from([None, *SHAPES]),
    st.floats(4, 200),
    st.floats(4, 200),
    st.floats(0.0, 20),
    st.sampled_from(["auto", *SYSTEMS]),
)
def test_what_is_stated_is_catalogued_and_probable(color, shape, width, height, sigma, system):
    settings = CodeSettings(system=system)
    found = code(sign(color, shape, width, height, sigma), settings)
    if found is None:
        return
    assert settings.settled <= found.probability <= 1 + 1e-9
    assert found.code in {one.code for one in CATALOGUE[found.system]} | {*SERIES[found.system]}
    if found.nominal_in is not None:
        assert width * 0.4 < found.nominal_in[0] * 1.5


def test_every_code_of_the_catalogue_has_a_known_series_colour_and_shape():
    for system, signs in CATALOGUE.items():
        for one in signs:
            assert one.series in SERIES[system]
            assert {*one.colors} <= {*COLORS}, one.code
            assert {*one.shapes} <= {*SHAPES}, one.code
            assert bool(one.sizes) != (one.limits is not None), one.code
