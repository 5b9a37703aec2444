from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from wayside.pipeline.learning.labelled import OFF, ON
from wayside.pipeline.learning.thresholds import (
    RATES,
    Gate,
    counted_tail,
    normal_tail,
    rates_of,
    score_points,
    with_learned_thresholds,
    with_score_threshold,
)
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel, MixtureModel
from wayside.stages.classifiers import at_alpha, class_distances

from ..asked import asked


def samples(values, on, kind=None):
    columns = {} if kind is None else {"kind": kind}
    return asked(np.where(on, ON, OFF), values, "color", "right_up_m", **columns)


def gate(distance, on, own=None, *, count=None):
    n = len(on)
    return Gate(distance, on, np.ones(n, int) if count is None else count, np.zeros(n, int), own)


def rates_on(data, found):
    """False and true positive rate of a model on samples."""
    reach = np.array([one.threshold for one in found.classes])
    return gate(class_distances(data.values, found), data.label == ON).rates(reach)


def model(*means):
    eye = np.eye(len(means[0]))
    classes = [
        GaussianClass(f"c{i}", np.array(m, np.float64), eye, 1.0, "typed", 1)
        for i, m in enumerate(means)
    ]
    return GaussianModel("right_up_m", tuple(classes), "")


@settings(max_examples=20)
@example(4191)  # steps of one slope
@given(st.integers(0, 2**32 - 1))
def test_no_pair_of_radii_accepts_more_signs_for_as_many_others_as_the_knee(seed):
    draw = np.random.default_rng(seed)
    distance = np.stack([draw.integers(1, 7, 40), np.full(40, 99)], axis=1).astype(np.float64)
    distance[20:] = distance[20:, ::-1]  # half are near each component
    on = draw.random(40) < 0.4
    if not on.any() or on.all():
        return
    one_gate = gate(distance, on)
    best = max(p.power - p.false_alarm for p in one_gate.points())
    for radii in product(range(7), repeat=2):
        false_alarm, power = one_gate.rates(np.array(radii))
        assert power - false_alarm <= best + 1e-9


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_the_points_hold_the_rates_of_the_gate_and_both_rise(seed):
    draw = np.random.default_rng(seed)
    distance, on = draw.random((60, 3)), draw.random(60) < 0.5
    on[:2] = True, False
    own = on[:, None] & (draw.integers(0, 3, 60)[:, None] == np.arange(3))
    count = draw.integers(1, 4, 60)
    for one_gate in (gate(distance, on, count=count), gate(distance, on, own, count=count)):
        points = one_gate.points()
        for one in points:
            assert (one.false_alarm, one.power) == one_gate.rates(np.array(one.thresholds))
        assert (np.diff([one.false_alarm for one in points]) >= 0).all()


@pytest.fixture(scope="module")
def colours():
    """Signs of two classes and others about them."""
    draw = np.random.default_rng(5)
    values = [draw.normal(0, 1, 300), draw.normal(20, 1, 300), draw.uniform(-40, 60, 1500)]
    kind = ["c0"] * 300 + ["c1"] * 300 + [""] * 1500
    return samples(np.concatenate(values), np.arange(2100) < 600, kind)


def test_each_colour_has_the_knee_of_its_own_signs_and_one_without_keeps_its_threshold(
    colours,
):
    found = with_learned_thresholds(model((0,), (20,), (99,)), colours)
    assert [1.5 < one.threshold < 3.5 for one in found.classes] == [True, True, False]
    assert found.classes[2].threshold_rule == "typed"


def test_one_knee_for_the_gate_is_the_point_of_its_curve_with_the_largest_gain(colours):
    found = with_learned_thresholds(model((0,), (20,), (99,)), colours, one_knee=True)
    reach = np.array([one.threshold for one in found.classes])
    distance, on = class_distances(colours.values, found), colours.label == ON
    false_alarm, power = rates_on(colours, found)
    assert power - false_alarm == max(one.power - one.false_alarm for one in found.curve)
    shares = [(distance[~on, j] <= reach[j]).mean() for j in range(3)]
    assert shares == pytest.approx([shares[0]] * 3, abs=0.02)  # one rate, without signs too
    for one in found.classes:
        assert one.threshold_rule.startswith("knee of the ROC of the gate")
        low, high = one.threshold_interval
        assert low <= high


def test_a_density_gets_the_knee_of_its_tracks_with_points_that_hold_their_rates():
    draw = np.random.default_rng(7)
    values = np.concatenate([draw.normal(2, 1, 300), draw.normal(-2, 2, 3000), [-np.inf]])
    on = np.arange(3301) < 300
    ones, eyes = np.ones(2), np.array([np.eye(4)] * 2)
    before = MixtureModel("image", 1, ones, np.zeros((2, 4)), eyes, 9.0, "typed", "drives")
    found = with_score_threshold(before, samples(values, on))
    gain = [(values[on] >= t).mean() - (values[~on] >= t).mean() for t in values]
    assert gain[int(np.argmin(abs(values - found.threshold)))] == pytest.approx(max(gain), abs=0.02)
    low, high = found.threshold_interval
    assert low <= found.threshold <= high
    read = model_from_json(model_to_json(found))
    for one in read.curve:
        assert (values[~on] >= one.thresholds[0]).mean() <= one.false_alarm + 1e-3
        traded = at_alpha(read, one.false_alarm).threshold
        assert (values[on] >= traded).mean() == pytest.approx(one.power, abs=0.005)
    with pytest.raises(InputError, match="signs and other things are needed"):
        with_score_threshold(before, samples(values[:300], on[:300]))


def test_thresholds_are_not_learned_of_signs_alone_nor_traded_without_points():
    with pytest.raises(InputError, match="signs and other things are needed"):
        with_learned_thresholds(model((0,)), samples(np.arange(5), np.ones(5, bool)))
    with pytest.raises(ValueError, match="no operating point"):
        at_alpha(model((0,)), 0.1)


def test_a_false_alarm_rate_trades_the_thresholds_of_a_model_that_holds_its_points():
    draw = np.random.default_rng(6)
    values = np.concatenate([draw.normal(0, 1, 400), draw.normal(4, 2, 4000)])
    data = samples(values, np.arange(4400) < 400)
    found = with_learned_thresholds(model((0,)), data)
    read = model_from_json(model_to_json(found))
    assert np.array([one.thresholds for one in read.curve]) == pytest.approx(
        np.array([one.thresholds for one in found.curve]), abs=1e-4
    )
    powers = []
    for alpha in (0.01, 0.05, 0.2):
        traded = at_alpha(found, alpha)
        false_alarm, power = rates_on(data, traded)
        assert false_alarm <= alpha
        assert f"alpha {alpha:g}" in traded.classes[0].threshold_rule
        powers.append(power)
    assert powers == sorted(powers)
    assert powers[0] < powers[-1]


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
def test_points_hold_their_rates_on_fresh_samples_and_intervals_grow_as_drives_scatter(
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
