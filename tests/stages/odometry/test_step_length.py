"""Lengths of steps: stated ones that are held, those that points follow, and those of fixes that jump."""

from dataclasses import replace
from itertools import accumulate
from math import inf, isfinite, log, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.motion import StepPrior
from wayside.schemas.settings import MotionSettings
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.step_length import StepLength, step_length

SPACING, SETTINGS = 8.0, MotionSettings()
AHEAD = np.array([0.0, 0.0, 1.0])


def expected(length_m, sigma_m, source, spacing_m=nan):
    prior = StepPrior(np.eye(3), inf, AHEAD, np.zeros(2), True, length_m, sigma_m)
    return MotionPrior(prior, (np.eye(3), AHEAD), np.eye(3), 1.0, source, spacing_m)


def lengths(true_m, ratio_errors=None, spacing_m=SPACING, settings=SETTINGS):
    """Each step of a drive of stated spacing; points give the ratio of two steps, ratio_errors the log of its error."""
    errors = np.zeros(len(true_m)) if ratio_errors is None else ratio_errors
    last, found = StepLength(), []
    for k, true in enumerate(true_m):
        carried = nan if k == 0 else last.length_m * true / true_m[k - 1] * np.exp(errors[k])
        held = expected(spacing_m, settings.spacing_sigma_m, "straight", spacing_m)
        last = step_length(last, (carried, 0.002 * carried), held, settings)
        found.append(last)
    return found


def test_a_stated_spacing_is_held():
    found = lengths([SPACING] * 30)
    assert {one.length_m for one in found} == {SPACING}
    assert {one.sigma_m for one in found} == {SETTINGS.spacing_sigma_m}
    assert not any(isfinite(one.length_in_spacings) for one in found)


@pytest.mark.parametrize("change", [0.96, 1.04])
def test_lengths_follow_the_points_where_a_vehicle_brakes_or_speeds_up(change):
    true = [SPACING] * 8 + [SPACING * change**k for k in range(1, 16)]
    found = lengths(true)
    varies = [isfinite(one.length_in_spacings) for one in found]
    first = varies.index(True)
    assert 9 <= first <= 12, "some steps are too few to tell, ten are not"
    assert all(varies[first:])
    # with what was lost before it was noticed made good
    np.testing.assert_allclose([f.length_m for f in found[first:]], true[first:], rtol=0.05)
    assert all(
        abs(f.length_m - t) < 4 * f.sigma_m
        for f, t in zip(found[first:], true[first:], strict=True)
    )


def test_a_slow_change_is_found_later():
    true = list(accumulate([SPACING] + [0.99] * 40, lambda length, change: length * change))
    found = lengths(true)
    assert isfinite(found[-1].length_in_spacings)
    assert found[-1].length_m == pytest.approx(true[-1], rel=0.05)


@given(st.integers(0, 10**6), st.floats(0.001, 0.05))
def test_errors_of_points_that_come_and_go_do_not_make_a_spacing_vary(seed, scatter):
    """An error of a depth enters the ratio to the step before with one sign and that to the next with the other."""
    depth = np.random.default_rng(seed).normal(0, scatter, 81)
    assert {one.length_m for one in lengths([SPACING] * 80, np.diff(depth))} == {SPACING}


@given(st.integers(0, 10**6))
def test_triggers_that_scatter_do_not_make_a_spacing_vary(seed):
    true = np.random.default_rng(seed).normal(SPACING, 0.1, 80)
    assert {one.length_m for one in lengths(true)} == {SPACING}


def test_one_step_of_another_length_does_not_make_a_spacing_vary():
    true = [SPACING] * 5 + [1.3 * SPACING] + [SPACING] * 5
    assert {one.length_m for one in lengths(true)} == {SPACING}


def test_dropped_triggers_make_a_step_of_several_spacings():
    true = [SPACING] * 4 + [2 * SPACING] + [SPACING] * 4 + [3 * SPACING] + [SPACING]
    assert [one.length_m for one in lengths(true)] == true


def test_triggers_are_not_dropped_in_many_steps_in_a_row():
    """Then points have a wrong scale: so far as they do not go on, the spacing is held."""
    true = [SPACING] * 4 + [2 * SPACING * 1.9**k for k in range(2)]
    assert [one.dropped for one in lengths(true)][-2:] == [1, 2]


@pytest.mark.parametrize("carried", [nan, 0.0, -3.0], ids=["none", "zero", "behind"])
def test_points_that_tell_no_length_leave_the_spacing(carried):
    last = lengths([SPACING] * 4)[-1]
    held = expected(SPACING, SETTINGS.spacing_sigma_m, "straight", SPACING)
    assert step_length(last, (carried, 0.1), held, SETTINGS).length_m == SPACING


def test_without_points_the_length_stays_in_stated_spacings():
    braking = [SPACING] * 3 + [SPACING * 0.94**k for k in range(1, 12)]
    last = lengths(braking)[-1]
    share = last.length_in_spacings
    held = expected(share * SPACING, 1.0, "points", SPACING)
    blind = step_length(last, (nan, nan), held, SETTINGS)
    assert blind.length_m == pytest.approx(share * SPACING)
    assert blind.sigma_m > last.sigma_m
    # a step over an image that is left out is of two spacings
    wide = expected(2 * share * SPACING, 1.0, "points", 2 * SPACING)
    assert step_length(last, (nan, nan), wide, SETTINGS).length_m == pytest.approx(
        2 * blind.length_m
    )


def test_the_stated_spacing_stays_the_mean_in_the_long_run():
    """Errors of ratios add up without end; the spacing bounds their sum."""
    noise = np.random.default_rng(3).normal(0, 0.01, 2000)
    true = [SPACING * 0.96**k for k in range(20)] + [SPACING * 0.96**20] * 20
    true += [true[-1] * 1.04**k for k in range(1, 22)] + [SPACING] * (2000 - 61)
    found = lengths(true, noise)
    assert isfinite(found[-1].length_in_spacings)
    assert max(abs(log(f.length_m / SPACING)) for f in found[300:]) < 0.6


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


def test_distances_between_fixes_are_averaged_with_lengths_by_points():
    found = step_length(StepLength(8.0, 0.04), (8.2, 0.01), expected(8.0, 0.2, "fixes"), SETTINGS)
    assert 8.15 < found.length_m < 8.2
    assert found.sigma_m < 0.07
