"""Which class drawings and crops teach the face classifier."""

from pathlib import Path

import pytest

from training.face_classes import (
    DRAWN,
    GTSRB,
    TAUGHT,
    TESTED,
    VALIDATED,
    class_of_drawing,
    drawings,
)
from wayside.schemas.sign_catalogue import CATALOGUE
from wayside.stages.sign_codes import OTHER_FACE

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
CATALOGUED = {face for signs in CATALOGUE.values() for one in signs for face in one.faces}


def drawing(kind, color="white", shape="circle", **more):
    return {"kind": kind, "color": color, "shape": shape, **more}


@pytest.mark.parametrize(
    ("entry", "wanted"),
    [
        (drawing("stop", "red", "octagon", code="R1-1", props={}), "stop"),
        (drawing("limit", shape="rectangle", code="R2-1", props={"speed": 45}), "R2-1 45"),
        (drawing("maximum speed limit 50"), "C14 50"),
        (drawing("maximum speed limit 50", shape="rectangle"), "R2-1 50"),
        (drawing("curve left", shape="triangle"), "A1a"),
        (drawing("curve left", "yellow", "diamond"), None),
        (drawing("camel crossing", "yellow", "diamond"), OTHER_FACE),
        (drawing("no horn"), OTHER_FACE),
    ],
)
def test_a_drawing_teaches_its_code_or_nothing_where_it_may_be_another(entry, wanted):
    assert class_of_drawing(entry) == wanted


def test_every_class_that_is_taught_is_in_the_catalogue():
    assert {*GTSRB, *DRAWN.values()} <= CATALOGUED
    assert len(GTSRB) == 43


def test_no_track_both_teaches_and_measures():
    parts = [*TAUGHT, *VALIDATED, *TESTED]
    assert sorted(parts) == list(range(9))


@pytest.mark.skipif(not (REAL / "faces").is_dir(), reason="drawings of others are not here")
def test_every_face_of_the_catalogue_has_a_drawing():
    drawn = {one.name for one in drawings(REAL)}
    without = {"A19", "C14 60", "C14 70"}  # crops alone, or on a yellow ground
    assert CATALOGUED - drawn - without == set()
    assert drawn <= CATALOGUED | {OTHER_FACE}
