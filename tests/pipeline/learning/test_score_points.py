"""Thresholds of a gate with one score for stated false-alarm rates."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from wayside.pipeline.learning.thresholds import (
    RATES,
    counted_tail,
    normal_tail,
    rates_of,
    score_points,
)

values = st.lists(st.floats(-50, 50, width=32), min_size=2, max_size=40)


@settings(max_examples=60)
@given(values, st.integers(0, 2**32 - 1))
def test_a_counted_threshold_leaves_at_most_its_share_above_and_no_lower_one_between_samples_does(
    listed, seed
):
    others = np.array(listed, np.float64)
    weight = np.random.default_rng(seed).integers(0, 3, len(others)).astype(np.float64)
    weight[0] = 1.0
    for rate, threshold in zip(RATES, counted_tail(others, weight, np.array(RATES)), strict=True):
        above = others >= threshold
        assert weight[above].sum() <= rate * weight.sum() + 1e-9
        following = others[~above].max(initial=-np.inf)
        one_more = others >= following
        assert weight[one_more].sum() > rate * weight.sum() - 1e-9


def test_a_normal_threshold_is_the_quantile_of_the_fitted_density():
    others = np.random.default_rng(1).normal(-3, 2, 20_000)
    found = normal_tail(others, np.ones(len(others)), np.array([0.03, 0.001]))
    assert found == pytest.approx(norm(-3, 2).ppf([0.97, 0.999]), abs=0.1)


@pytest.mark.parametrize("tail", [normal_tail, counted_tail])
def test_points_hold_their_rates_on_fresh_samples_and_intervals_grow_with_the_scatter_of_drives(
    tail,
):
    draw = np.random.default_rng(2)

    def road(scatter):
        drive = np.repeat(np.arange(20), 200)
        return draw.normal(0, 1, 4000) + draw.normal(0, scatter, 20)[drive], drive

    others, drive = road(0.0)
    signs = draw.normal(3, 1, 500)
    on = np.arange(4500) < 500
    group = np.concatenate([np.arange(500) % 20, drive])
    alike = score_points(np.append(signs, others), on, group, tail, RATES)
    fresh = draw.normal(0, 1, 100_000)
    for one in alike[5:]:
        assert (fresh >= one.thresholds[0]).mean() == pytest.approx(one.false_alarm, rel=0.25)
        assert one.power == np.mean(signs >= one.thresholds[0])
        low, high = one.intervals[0]
        assert low <= one.thresholds[0] <= high
    apart = score_points(np.append(signs, road(1.0)[0]), on, group, tail, RATES)
    width = [np.ptp(points[9].intervals[0]) for points in (alike, apart)]
    assert width[1] > 3 * width[0]


def test_without_a_second_drive_a_threshold_has_no_interval():
    score, on = np.arange(40.0), np.arange(40) >= 30
    points = score_points(score, on, np.zeros(40, np.int64), counted_tail, rates_of(30))
    assert [one.false_alarm for one in points] == [rate for rate in RATES if rate >= 1 / 30]
    assert {one.intervals for one in points} == {()}


def test_the_interval_is_that_of_the_resamplings_that_a_density_can_be_fitted_to():
    score = np.concatenate([np.linspace(-3, 0, 9), np.linspace(2, 4, 9)])
    on, group = score > 1, np.array([0] * 4 + [1] * 4 + [2] + [0, 1, 2] * 3)
    (point,) = score_points(score, on, group, normal_tail, [0.05], seed=1)
    ((low, high),) = point.intervals
    assert np.isfinite([low, high]).all()
    assert low <= high
