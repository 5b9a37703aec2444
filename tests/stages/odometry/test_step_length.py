"""Lengths of steps: means of what is stated and what points tell, and which of both is believed against the other."""

from dataclasses import replace
from itertools import accumulate
from math import inf, isfinite, log, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.motion import StepPrior
from wayside.schemas.settings import MotionSettings
from wayside.stages.odometry.motion_prior import SPACING_SCATTER, MotionPrior
from wayside.stages.odometry.step_length import StepLength, step_length

SPACING, SETTINGS = 8.0, MotionSettings()
AHEAD = np.array([0.0, 0.0, 1.0])


def expected(length_m, sigma_m, source, spacing_m=nan):
    prior = StepPrior(np.eye(3), inf, AHEAD, np.zeros(2), True, length_m, sigma_m)
    return MotionPrior(prior, (np.eye(3), AHEAD), np.eye(3), 1.0, source, spacing_m)


def spaced(last, carried=(nan, nan)):
    """A step of stated spacing, as it is expected after the last one."""
    share = last.length_in_spacings
    held = SPACING, SETTINGS.spacing_sigma_m, "straight"
    if isfinite(share):
        held = share * SPACING, SPACING_SCATTER * SPACING, "points"
    return step_length(last, carried, expected(*held, SPACING), SETTINGS)


def lengths(true_m, ratio_errors=None):
    """Each step of a drive of stated spacing; points give the ratio of two steps, ratio_errors the log of its error."""
    errors = np.zeros(len(true_m)) if ratio_errors is None else ratio_errors
    last, found = StepLength(), []
    for k, true in enumerate(true_m):
        carried = nan if k == 0 else last.length_m * true / true_m[k - 1] * np.exp(errors[k])
        last = spaced(last, (carried, 0.002 * carried))
        found.append(last)
    return found


def values(found):
    return [one.length_m for one in found]


def test_points_that_agree_with_a_stated_spacing_make_it_surer():
    found = lengths([SPACING] * 30)
    assert values(found) == [SPACING] * 30
    assert found[-1].sigma_m < found[0].sigma_m == SETTINGS.spacing_sigma_m
    assert not any(isfinite(one.length_in_spacings) for one in found)


@pytest.mark.parametrize("change", [0.96, 0.99, 1.04])
def test_lengths_follow_the_points_where_a_vehicle_brakes_or_speeds_up(change):
    true = [SPACING] * 8 + list(accumulate([SPACING] + [change] * 20, lambda a, b: a * b))
    found = lengths(true)
    assert all(isfinite(one.length_in_spacings) for one in found[-10:])
    np.testing.assert_allclose(values(found), true, rtol=0.05)
    followed = [(f, t) for f, t in zip(found, true, strict=True) if isfinite(f.length_in_spacings)]
    assert all(abs(f.length_m - t) < 4 * f.sigma_m for f, t in followed)


@given(st.integers(0, 10**6), st.floats(0.001, 0.02))
def test_errors_of_points_that_come_and_go_leave_the_spacing(seed, scatter):
    """An error of a depth enters the ratio to the step before with one sign and that to the next with the other."""
    depth = np.random.default_rng(seed).normal(0, scatter, 81)
    found = values(lengths([SPACING] * 80, np.diff(depth)))
    assert np.median(found) == pytest.approx(SPACING, rel=0.01)
    assert np.abs(np.array(found[-1:]) / SPACING - 1).max() < 0.2


@pytest.mark.parametrize("factor", [1.3, 2, 3])
def test_a_single_step_of_another_length_is_taken_from_the_points(factor):
    true = [SPACING] * 4 + [factor * SPACING] + [SPACING] * 4
    assert values(lengths(true)) == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("carried", [nan, 0.0, -3.0], ids=["none", "zero", "behind"])
def test_points_that_tell_no_length_leave_the_spacing(carried):
    assert spaced(lengths([SPACING] * 4)[-1], (carried, 0.1)).length_m == SPACING


def test_without_points_the_length_stays_in_stated_spacings():
    last = lengths([SPACING] * 3 + [SPACING * 0.94**k for k in range(1, 12)])[-1]
    blind = spaced(last)
    assert blind.length_m == pytest.approx(last.length_m)
    assert blind.length_in_spacings == last.length_in_spacings
    assert blind.sigma_m > last.sigma_m


def test_the_stated_spacing_stays_the_mean_in_the_long_run():
    """Errors of ratios add up without end; the spacing bounds their sum."""
    found = lengths([SPACING] * 2000, np.random.default_rng(3).normal(0, 0.01, 2000))
    assert max(abs(log(length / SPACING)) for length in values(found)) < 0.6


def test_points_are_believed_against_a_fix_that_jumps_but_not_for_ever():
    jump = expected(22.0, 0.3, "fixes")
    last, found = StepLength(8.0, 0.1), []
    for _ in range(3):
        last = replace(step_length(last, (8.0, 0.02), jump, SETTINGS), sigma_m=0.1)
        found.append(last.length_m)
    assert found == [8.0, 8.0, 22.0]
    agreeing = step_length(last, (8.0, 0.02), expected(8.0, 0.3, "fixes"), SETTINGS)
    assert agreeing.length_m == pytest.approx(8.0, abs=0.05)
    assert step_length(agreeing, (8.0, 0.02), jump, SETTINGS).length_m == 8.0


@pytest.mark.parametrize(
    ("source", "against_points"), [("fixes", None), ("poses", 9.0), ("speed", 8.2)]
)
def test_agreeing_lengths_are_averaged_and_poses_believed_before_points_before_the_last_speed(
    source, against_points
):
    agreeing, other = (
        step_length(StepLength(8.0, 0.04), (8.2, 0.01), expected(*known, source), SETTINGS)
        for known in ((8.0, 0.2), (9.0, 0.05))
    )
    assert 8.15 < agreeing.length_m < 8.2
    assert agreeing.sigma_m < 0.07
    if against_points is not None:
        assert other.length_m == pytest.approx(against_points)
