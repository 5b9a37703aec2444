from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import VERDICTS
from wayside.schemas.frame import Pose
from wayside.schemas.settings import AdjustmentSettings, LandmarkSettings, VerdictSettings
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.landmark_fit import fit_views
from wayside.stages.mapping.verdicts import (
    mutual_cover,
    position_verdict,
    same_face,
    stands_still,
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
    assert mutual_cover(fit, fit, NEWEST) == (1.0, 1.0)
    beyond = Pose(np.eye(3), np.array([0.0, 0.0, 70.0]))
    assert mutual_cover(fit, fit, beyond) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("right", "passes", "known", "verdict"),
    [
        (0.5, False, True, "moving"),
        (6.0, False, True, "place_score"),
        (6.0, True, True, "duplicate"),
        (6.0, True, False, "sign"),
    ],
)
def test_the_first_rule_that_applies_decides(fit_at, right, passes, known, verdict):
    fit = fit_at(60.0)
    reported, offset = [fit] if known else [], FrenetOffset(60.0, right, 1.0)
    found = position_verdict(fit, offset, reported, NEWEST, SETTINGS, passes=passes)
    assert found == verdict


def stands(fit, views, registered, missing, short=0.0):
    """With log odds that make up for so many missing views, less `short`."""
    seen = replace(fit, rows=np.arange(views), used=np.ones(views, bool))
    log_odds = missing * SETTINGS.evidence_log_odds - short
    return stands_still(seen, registered, log_odds, SETTINGS)


@pytest.mark.parametrize(
    ("views", "registered", "missing"),
    [(2, 1, 4), (2, 2, 2), (2, 3, 1), (3, 1, 3), (3, 2, 1), (5, 1, 1), (6, 1, 0), (3, 3, 0)],
)
def test_log_odds_make_up_for_views_and_registered_images_that_are_missing(
    fit_at, views, registered, missing
):
    assert stands(fit_at(130.0), views, registered, missing)
    assert not stands(fit_at(130.0), views, registered, missing, short=0.1)


@pytest.mark.parametrize(("boxes", "passes"), [(2, False), (3, True)])
def test_predicted_views_count_where_three_boxes_agree(fit_at, boxes, passes):
    fit = replace(fit_at(130.0), rows=np.arange(8), used=np.arange(8) < boxes)
    assert stands_still(fit, 1, 0.0, SETTINGS) == passes


def test_candidates_without_a_landmark_are_named_by_their_pairs():
    paired = np.array([[False, False], [True, False], [False, True], [True, True]])
    names = [VERDICTS[code] for code in unassigned_verdicts(paired)]
    assert names == ["unmatched", "few_views", "few_views", "moving"]
