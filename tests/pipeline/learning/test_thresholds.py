from dataclasses import replace

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
    with_threshold,
)
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel, MixtureModel
from wayside.stages.classifiers import at_alpha


def test_a_gate_gets_the_threshold_of_its_rate_and_points_that_hold_theirs():
    draw = np.random.default_rng(7)
    values = np.concatenate([draw.normal(2, 1, 300), draw.normal(-2, 2, 3000), [-np.inf]])
    on, drive = np.arange(3301) < 300, np.arange(3301) % 4
    one = GaussianClass("sign", np.zeros(4), np.eye(4), 1)
    for before in (
        MixtureModel(
            "image", 1, np.ones(2), np.zeros((2, 4)), np.array([np.eye(4)] * 2), 9.0, "typed", ""
        ),
        GaussianModel("image", (one,), "typed", background=(replace(one, count=9),)),
    ):
        found = with_threshold(before, values, on, drive, 0.1)
        assert (values[~on] >= found.threshold).mean() == pytest.approx(0.1, abs=1e-3)
        low, high = found.threshold_interval
        assert low <= found.threshold <= high
        read = model_from_json(model_to_json(found))
        assert (read.curve, read.threshold) == (found.curve, found.threshold)
        powers = []
        for point in read.curve:
            assert (values[~on] >= point.threshold).mean() <= point.false_alarm + 1e-3
            traded = at_alpha(read, point.false_alarm)
            assert f"alpha {point.false_alarm:g}" in traded.threshold_rule
            powers.append((values[on] >= traded.threshold).mean())
            assert powers[-1] == pytest.approx(point.power, abs=0.005)
        assert powers == sorted(powers)
        assert powers[0] < powers[-1]
        with pytest.raises(ValueError, match="no operating point"):
            at_alpha(before, 0.1)
        with pytest.raises(InputError, match="signs and other things are needed"):
            with_threshold(before, values[:300], on[:300], drive[:300], 0.1)


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
def test_points_hold_their_rates_on_fresh_samples_and_intervals_grow_as_drives_scatter(tail):
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
        assert (fresh >= one.threshold).mean() == pytest.approx(one.false_alarm, rel=0.25)
        assert one.power == np.mean(signs >= one.threshold)
        low, high = one.interval
        assert low <= one.threshold <= high
    apart = score_points(np.append(signs, road(1.0)[0]), on, group, tail, RATES)
    width = [np.ptp(points[9].interval) for points in (alike, apart)]
    assert width[1] > 3 * width[0]


def test_without_a_second_drive_a_threshold_has_no_interval():
    score, on = np.arange(40.0), np.arange(40) >= 30
    points = score_points(score, on, np.zeros(40, np.int64), counted_tail, rates_of(30))
    assert [one.false_alarm for one in points] == [rate for rate in RATES if rate >= 1 / 30]
    assert {one.interval for one in points} == {None}
