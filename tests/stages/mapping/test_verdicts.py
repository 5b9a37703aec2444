from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.verdicts import FaceBoxes, in_swept_volume, same_face
from wayside.stages.mapping.window import unassigned_verdicts

from .made_windows import fitted, standing, window


@pytest.mark.parametrize(
    ("right", "above", "swept"), [(0.5, 1.0, True), (6.0, 1.0, False), (0.5, 5.0, False)]
)
def test_nothing_stands_where_the_vehicle_drove(right, above, swept):
    candidates = window(standing([(6.0, -1.0, 60.0, 1.7, 0.8, 1.0)], 2))
    fit = replace(fitted(candidates), covariance=np.diag([0.01, 0.01, 0.09]))
    assert in_swept_volume(fit, FrenetOffset(60.0, right, above)) == swept


FACE, HALF, BESIDE = [0.0, 0.0, 0.2, 0.2], [0.0, 0.0, 0.2, 0.1], [0.17, 0.0, 0.37, 0.2]
"""A face, its upper half, and a panel that touches it, boxed with an error of 15 %."""


def views(boxes, predicted=(), unseen=()):
    """Boxes by number of ten images; in the others the landmark is nowhere."""
    found = FaceBoxes.none(10)
    for k, box in boxes.items():
        found.box[k] = box
        found.seen[k], found.measured[k] = k not in unseen, k not in (*predicted, *unseen)
    return found


@pytest.mark.parametrize(("box", "one_face"), [(FACE, True), (HALF, True), (BESIDE, False)])
def test_two_landmarks_are_one_face_where_most_of_the_smaller_lies_in_the_other(box, one_face):
    one, other = views(dict.fromkeys(range(5), FACE)), views(dict.fromkeys(range(2, 9), box))
    assert same_face(one, other) == same_face(other, one) == one_face


@pytest.mark.parametrize(
    ("predicted", "aside", "one_face"),
    [
        ((1, 2, 3), (), True),
        ((1, 2, 3), (2, 3), False),  # aside in two images of three that tell
        ((1, 2, 3), (4,), True),  # image 4 has a candidate of neither
        ((1,), (2, 3), False),  # one behind another: where both are seen they are apart
    ],
)
def test_a_face_that_the_motion_has_placed_twice_is_predicted_on_itself(predicted, aside, one_face):
    own = views(dict.fromkeys(range(5), FACE), predicted=(4,))
    far = {k: BESIDE if k in aside else FACE for k in range(1, 5)}
    other = views(far, (*predicted, 4))
    assert same_face(own, other) == same_face(other, own) == one_face


def test_near_images_tell_more_than_far_ones():
    far = {k: [0.0, 0.0, 0.02, 0.02] for k in range(4)}
    assert not same_face(views(far | {4: FACE}), views(far | {4: BESIDE}))


def test_one_view_that_is_predicted_on_another_face_is_not_enough():
    one = views({0: BESIDE, 1: FACE, 2: FACE}, predicted=(1,))
    assert not same_face(one, views({0: FACE, 1: FACE, 2: BESIDE}, unseen=(0, 2)))


def test_landmarks_that_no_image_shows_together_are_compared_where_they_must_be():
    far = views(dict.fromkeys(range(8), FACE), unseen=range(4, 8))
    for box, one_face in ((HALF, True), (BESIDE, False)):
        assert same_face(far, views(dict.fromkeys(range(8), box), unseen=range(4))) == one_face


def test_a_panel_that_is_passed_is_none_that_is_seen_afterwards():
    passed = views(dict.fromkeys(range(4), FACE))
    assert not same_face(passed, views(dict.fromkeys(range(9), FACE), unseen=range(4)))


def test_candidates_without_a_landmark_are_named_by_their_pairs():
    paired = np.array([[False, False], [True, False], [False, True], [True, True], [True, True]])
    standing = np.array([False, False, False, False, True])
    names = [VERDICTS[code] for code in unassigned_verdicts(paired, standing)]
    assert names == ["unmatched", "few_views", "few_views", "moving", "far_view"]
