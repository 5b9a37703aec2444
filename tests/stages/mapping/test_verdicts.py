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
SURE, CERTAIN = SETTINGS.sure_log_odds, SETTINGS.certain_log_odds
NEWEST = Pose(np.eye(3), np.array([0.0, 0.0, 8.0]))
"""The later of the two cameras."""
NO_PANEL = np.inf


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


def stands(fit, registered, panel_px, fewest, log_odds):
    return stands_still(fit, registered, panel_px, log_odds, fewest, SETTINGS)


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


@pytest.mark.parametrize(("registered", "passes"), [(1, False), (2, True)])
def test_few_boxes_stand_where_two_images_register_though_their_outline_is_of_no_known_shape(
    fit_at, registered, passes
):
    three = replace(fit_at(130.0), rows=np.arange(3), used=np.ones(3, bool))
    assert stands(three, registered, NO_PANEL, 3, SURE) == passes


def test_two_boxes_stand_where_as_many_images_as_are_asked_for_show_one_panel(fit_at):
    pair = fit_at(130.0)
    assert not stands(pair, 3, NO_PANEL, 3, SURE)
    assert not stands(pair, 2, 0.1, 3, SURE)
    assert stands(pair, 3, 0.9, 3, SURE)
    assert stands(pair, 2, 0.1, 2, SURE)


def test_two_images_must_meet_nearer_than_three(fit_at):
    pair = fit_at(130.0)
    assert not stands(pair, 2, 0.9, 2, SURE)
    assert stands(pair, 3, 0.9, 2, SURE)


def test_two_images_of_what_may_be_no_sign_do_not_show_that_it_stands(fit_at):
    pair = fit_at(130.0)
    assert not stands(pair, 2, 0.1, 2, SURE - 0.1)
    assert stands(pair, 3, 0.1, 2, SURE - 0.1)


def test_three_views_of_what_is_certainly_a_panel_need_not_register(fit_at):
    pair = fit_at(130.0)
    three = replace(pair, rows=np.arange(3))
    assert stands(three, 1, NO_PANEL, 2, CERTAIN)
    assert not stands(three, 1, NO_PANEL, 2, CERTAIN - 0.1)
    assert not stands(three, 1, NO_PANEL, 4, CERTAIN)
    assert not stands(pair, 1, NO_PANEL, 2, CERTAIN)


def test_candidates_without_a_landmark_are_named_by_their_pairs():
    paired = np.array([[False, False], [True, False], [False, True], [True, True]])
    names = [VERDICTS[code] for code in unassigned_verdicts(paired)]
    assert names == ["unmatched", "few_views", "few_views", "moving"]
