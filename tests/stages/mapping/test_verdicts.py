from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.schemas.frame import Pose
from wayside.schemas.settings import LandmarkSettings, VerdictSettings
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.landmark_fit import fit_views
from wayside.stages.mapping.verdicts import (
    SeenBox,
    in_swept_volume,
    same_face,
    same_face_in_images,
    unassigned_verdicts,
)

SETTINGS = VerdictSettings()
NEWEST = Pose(np.eye(3), np.array([0.0, 0.0, 8.0]))
"""The later of the two cameras."""


@pytest.fixture
def fit_at(window, standing):
    """A landmark 6 m to the right, 1.7 x 0.8 m, seen from two cameras at the origin and 8 m on."""

    def make(ahead, sigma_ahead=0.3):
        candidates = window(standing([(6.0, -1.0, ahead, 1.7, 0.8, 1.0)], 2))
        fit = fit_views(candidates, np.arange(2), np.arange(2), LandmarkSettings())
        return replace(fit, covariance=np.diag([0.01, 0.01, sigma_ahead**2]))

    return make


@pytest.mark.parametrize(("sigma_ahead", "same"), [(0.5, False), (6.0, True)])
def test_a_landmark_of_unsure_depth_is_the_face_that_hides_it(fit_at, sigma_ahead, same):
    known = fit_at(130.0)
    # on the rays of the known face, nearer
    unsure = replace(fit_at(110.0, sigma_ahead), point=known.point * (110.0 / 130.0))
    assert same_face(unsure, known, NEWEST, SETTINGS) == same


def test_a_landmark_covers_itself_and_nothing_from_behind(fit_at):
    fit = fit_at(60.0)
    assert same_face(fit, fit, NEWEST, SETTINGS)
    beyond = Pose(np.eye(3), np.array([0.0, 0.0, 70.0]))
    assert not same_face(fit, fit, beyond, SETTINGS)


@pytest.mark.parametrize(
    ("right", "above", "swept"), [(0.5, 1.0, True), (6.0, 1.0, False), (0.5, 5.0, False)]
)
def test_nothing_stands_where_the_vehicle_drove(fit_at, right, above, swept):
    assert in_swept_volume(fit_at(60.0), FrenetOffset(60.0, right, above), SETTINGS) == swept


def views(boxes, predicted):
    return {k: SeenBox(np.array(box, float), k in predicted) for k, box in boxes.items()}


@pytest.mark.parametrize(
    ("predicted", "aside", "one_face"),
    [
        ((1, 2, 3), (), True),
        ((1, 2, 3), (4,), True),
        ((1, 2, 3), (2, 3), False),  # aside in half of the images
        ((1, 2), (), False),  # image 3 shows them apart
    ],
)
def test_two_landmarks_are_one_face_where_one_is_predicted_on_the_other(predicted, aside, one_face):
    own = views({k: [10, 10, 30, 30] for k in range(5)}, predicted=(4,))
    far = {k: [11, 10, 31, 30] if k not in aside else [40, 10, 60, 30] for k in range(1, 5)}
    other = views(far, predicted)
    assert same_face_in_images(own, other, 0.4) == same_face_in_images(other, own, 0.4) == one_face


def test_one_view_that_is_predicted_on_another_face_is_not_enough():
    one = views({k: [10, 10, 30, 30] for k in range(1, 6)}, predicted=(1,))
    other = views({0: [10, 10, 30, 30], 1: [10, 10, 30, 30]}, predicted=())
    assert not same_face_in_images(one, other, 0.4)


def test_landmarks_without_a_common_image_are_not_one_face_by_their_views():
    assert not same_face_in_images(
        views({1: [0, 0, 9, 9]}, ()), views({2: [0, 0, 9, 9]}, (2,)), 0.4
    )


def test_candidates_without_a_landmark_are_named_by_their_pairs():
    paired = np.array([[False, False], [True, False], [False, True], [True, True], [True, True]])
    standing = np.array([False, False, False, False, True])
    names = [VERDICTS[code] for code in unassigned_verdicts(paired, standing)]
    assert names == ["unmatched", "few_views", "few_views", "moving", "far_view"]
