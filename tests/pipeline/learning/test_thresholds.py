from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from wayside.pipeline.learning.asked import ClassifierSamples
from wayside.pipeline.learning.samples import OFF, ON
from wayside.pipeline.learning.thresholds import (
    class_points,
    component_points,
    gate_rates,
    with_learned_thresholds,
    with_score_threshold,
)
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel, MixtureModel
from wayside.stages.classifiers import at_alpha, class_distances


def samples(values, on, kind=None, drives=5):
    n = len(values)
    return ClassifierSamples(
        "location" if kind is None else "color",
        "right_up_m",
        np.asarray(values, np.float64).reshape(n, -1),
        np.where(on, ON, OFF).astype(np.int8),
        np.array([""] * n if kind is None else kind),
        np.zeros(n, bool),
        np.array([""] * n),
        np.array([f"d{i % drives}" for i in range(n)]),
        np.arange(n, dtype=np.int32),
        np.zeros((n, 4), np.float32),
        np.ones(n, np.int64),
    )


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
    on, count = draw.random(40) < 0.4, np.ones(40, np.int64)
    if not on.any() or on.all():
        return
    best = max(p.power - p.false_alarm for p in component_points(distance, on, count))
    for radii in product(range(7), repeat=2):
        false_alarm, power = gate_rates(distance, on, count, np.array(radii))
        assert power - false_alarm <= best + 1e-9


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_the_points_hold_the_rates_of_the_gate_and_both_rise(seed):
    draw = np.random.default_rng(seed)
    distance, on = draw.random((60, 3)), draw.random(60) < 0.5
    on[:2] = True, False
    own = on[:, None] & (draw.integers(0, 3, 60)[:, None] == np.arange(3))
    count = draw.integers(1, 4, 60)
    for points in (component_points(distance, on, count), class_points(distance, own, on, count)):
        for one in points:
            rates = gate_rates(distance, on, count, np.array(one.thresholds))
            assert (one.false_alarm, one.power) == pytest.approx(rates)
        assert (np.diff([one.false_alarm for one in points]) >= 0).all()


def test_two_clusters_of_signs_among_scattered_others_get_a_radius_each():
    draw = np.random.default_rng(4)
    right, left = draw.normal((8, 0), 1, (150, 2)), draw.normal((-9, 0), 0.3, (150, 2))
    others = draw.uniform((-30, -10), (30, 10), (1500, 2))
    values = np.concatenate([right, left, others])
    found = with_learned_thresholds(
        model((8, 0), (-9, 0)), samples(values, np.arange(len(values)) < 300)
    )
    wide, narrow = (one.threshold for one in found.classes)
    assert 2 < wide < 4
    assert 0.5 < narrow < 1.2
    for one in found.classes:
        low, high = one.threshold_interval
        assert low <= one.threshold <= high
        assert one.threshold_rule.startswith("knee of the ROC of all components together")


def test_each_colour_has_the_knee_of_its_own_signs_and_one_without_signs_keeps_its_threshold():
    draw = np.random.default_rng(5)
    values = np.concatenate(
        [draw.normal(0, 1, 300), draw.normal(20, 1, 300), draw.uniform(-40, 60, 3000)]
    )
    kind = ["c0"] * 300 + ["c1"] * 300 + [""] * 3000
    found = with_learned_thresholds(
        model((0,), (20,), (99,)), samples(values, np.arange(3600) < 600, kind)
    )
    assert [1.5 < one.threshold < 3.5 for one in found.classes] == [True, True, False]
    assert found.classes[2].threshold_rule == "typed"


def test_one_knee_for_the_gate_is_the_point_of_its_curve_with_the_largest_gain():
    draw = np.random.default_rng(5)
    values = np.concatenate(
        [draw.normal(0, 1, 300), draw.normal(20, 1, 300), draw.uniform(-40, 60, 1500)]
    )
    kind = ["c0"] * 300 + ["c1"] * 300 + [""] * 1500
    data = samples(values, np.arange(2100) < 600, kind)
    found = with_learned_thresholds(model((0,), (20,), (99,)), data, one_knee=True)
    reach = np.array([one.threshold for one in found.classes])
    distance, on = class_distances(data.values, found), data.label == ON
    false_alarm, power = gate_rates(distance, on, data.count, reach)
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
    eye = np.eye(4)[None]
    before = MixtureModel("image", np.ones(1), np.zeros((1, 4)), eye, 9.0, "typed", 1, "drives")
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
        reach = np.array([one.threshold for one in traded.classes])
        false_alarm, power = gate_rates(
            class_distances(data.values, traded), data.label == ON, data.count, reach
        )
        assert false_alarm <= alpha
        assert f"alpha {alpha:g}" in traded.classes[0].threshold_rule
        powers.append(power)
    assert powers == sorted(powers)
    assert powers[0] < powers[-1]


def test_thresholds_are_not_learned_of_signs_alone():
    with pytest.raises(InputError, match="signs and other things are needed"):
        with_learned_thresholds(model((0,)), samples(np.arange(5), np.ones(5, bool)))


def test_a_model_without_points_cannot_be_traded():
    with pytest.raises(ValueError, match="no operating point"):
        at_alpha(model((0,)), 0.1)
