from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.schemas.frame import Pose
from wayside.schemas.settings import AdjustmentSettings, LandmarkSettings, VerdictSettings
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.landmark_fit import fit_views
from wayside.stages.mapping.verdicts import (
    in_swept_volume,
    same_face,
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
        fit = fit_views(
            candidates, np.arange(2), np.arange(2), LandmarkSettings(), AdjustmentSettings()
        )
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


def test_candidates_without_a_landmark_are_named_by_their_pairs():
    paired = np.array([[False, False], [True, False], [False, True], [True, True]])
    names = [VERDICTS[code] for code in unassigned_verdicts(paired)]
    assert names == ["unmatched", "few_views", "few_views", "moving"]
