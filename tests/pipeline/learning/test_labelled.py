import numpy as np
import pytest

from wayside.pipeline.labels.read import FrameLabels
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON, labelled_faces
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, UNSURE, Label, LabelledImage

FACE = (100.0, 100.0, 140.0, 140.0)
AWAY = (400.0, 100.0, 440.0, 140.0)


def label(kind, box, frame=0, **more):
    return Label(LabelledImage(frame=frame), kind, box, **more)


def faces(*labels, complete=(0, 1, 2)):
    by_frame = {}
    for one in labels:
        by_frame.setdefault(one.image.frame, []).append(one)
    return labelled_faces(FrameLabels(by_frame, frozenset(complete), {}))


def label_of(known, box, frame=0):
    return int(known.label_regions(frame, np.array([box], np.float32))[0][0])


def test_a_region_on_a_face_has_its_class_and_one_elsewhere_is_no_sign():
    known = faces(label(SIGN, FACE, color="green", shape="circle"))
    labels, face = known.label_regions(0, np.array([(101, 99, 141, 139), AWAY], np.float32))
    assert labels.tolist() == [ON, OFF]
    assert face.tolist() == [0, -1]
    assert known.color[face[0]] == "green"


SMALL = (100.0, 100.0, 104.0, 104.0)


@pytest.mark.parametrize(
    ("one", "box", "expected"),
    [
        pytest.param(label(SIGN, FACE), (105, 105, 112, 112), NEITHER, id="a letter"),
        pytest.param(label(SIGN, FACE), (90, 90, 160, 160), NEITHER, id="a looser box"),
        pytest.param(label(SIGN, FACE), (0, 0, 800, 300), OFF, id="far larger than the face in it"),
        pytest.param(label(SIGN, FACE, wanted=False), FACE, NEITHER, id="not wanted"),
        pytest.param(label(SIGN, FACE, visible=0.1), FACE, NEITHER, id="hidden"),
        pytest.param(label(SIGN, SMALL), SMALL, NEITHER, id="small"),
        pytest.param(label(UNSURE, FACE), FACE, NEITHER, id="unsure"),
    ],
)
def test_a_face_shown_badly_or_that_does_not_count_is_no_example_of_a_sign(one, box, expected):
    assert label_of(faces(one), box) == expected


def test_where_not_all_is_labelled_only_what_is_said_to_be_no_sign_is_none():
    known = faces(label(NOT_A_SIGN, AWAY), label(BACK, (0.0, 0.0, 40.0, 40.0)), complete=())
    assert label_of(known, AWAY) == OFF
    assert label_of(known, (0, 0, 40, 40)) == OFF
    assert label_of(known, FACE) == NEITHER
    assert label_of(known, AWAY, frame=1) == NEITHER


PART = (105, 105, 130, 130)  # triangulates to the panel


@pytest.mark.parametrize(
    ("labelled", "views", "expected"),
    [
        ((0, 1, 2), [(0, FACE), (1, PART), (2, AWAY)], ON),
        ((0, 1, 2), [(0, FACE), (1, AWAY), (2, AWAY)], NEITHER),
        ((0, 1, 2), [(0, AWAY), (1, AWAY), (2, AWAY)], OFF),
        ((0,), [(4, FACE), (5, FACE)], NEITHER),
        ((0,), [(0, FACE), (5, AWAY)], ON),
    ],
)
def test_a_landmark_is_a_sign_where_most_of_its_latest_labelled_views_show_one(
    labelled, views, expected
):
    complete = labelled if len(labelled) > 1 else ()
    known = faces(*(label(SIGN, FACE, frame) for frame in labelled), complete=complete)
    assert known.label_views(views) == expected
