"""What boxes on and about faces teach the classifier."""

import numpy as np

from wayside.pipeline.learning.samples import NEITHER, OFF, ON, face_labels

SIGN, PLAQUE = [100, 100, 140, 140], [105, 141, 135, 156]


def labels(boxes, faces=(SIGN, PLAQUE), is_example=None):
    is_example = [True] * len(faces) if is_example is None else is_example
    return face_labels(
        np.array(boxes, np.float32), np.array(faces, np.float64), np.array(is_example)
    ).tolist()


def test_a_tight_box_is_on_and_a_far_one_off():
    assert labels([SIGN, [101, 101, 139, 140], [300, 100, 340, 140]]) == [ON, ON, OFF]


def test_beside_a_tight_box_a_loose_one_is_no_example():
    loose = [90, 100, 145, 150]
    assert labels([SIGN, loose], [SIGN]) == [ON, NEITHER]


def test_without_a_tight_box_a_loose_one_is_on():
    assert labels([[90, 100, 145, 150]], [SIGN]) == [ON]


def test_a_part_of_a_face_is_off_where_the_whole_is_found():
    half = [100, 100, 140, 119]
    assert labels([SIGN, half], [SIGN]) == [ON, OFF]
    assert labels([half], [SIGN]) == [NEITHER]


def test_a_box_around_two_faces_is_never_on():
    both = [100, 100, 140, 156]
    tall_plaque = [100, 141, 140, 171]
    assert labels([SIGN, both]) == [ON, OFF]
    assert labels([SIGN, [100, 100, 140, 171]], [SIGN, tall_plaque])[1] == OFF


def test_a_face_inside_another_is_no_second_face():
    board, route = [100, 100, 300, 200], [120, 120, 150, 150]
    assert labels([board], [board, route]) == [ON]


def test_faces_too_small_to_teach_make_no_examples_of_what_is_near_them():
    assert labels([SIGN, [100, 100, 140, 119], [300, 100, 340, 140]], [SIGN], [False]) == [
        NEITHER,
        NEITHER,
        OFF,
    ]
