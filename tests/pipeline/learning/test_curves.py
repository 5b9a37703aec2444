from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm
from sklearn import metrics

from wayside.pipeline.learning.curves import RocCurve, resampled_groups


def scores(on, off, *, below=False, groups=4):
    value = np.concatenate([on, off]).astype(np.float64)
    n = len(value)
    return RocCurve(
        value,
        np.arange(n) < len(on),
        np.ones(n, np.int64),
        np.arange(n, dtype=np.int64) % groups,
        accept_below=below,
    )


values = st.lists(st.integers(-5, 5), min_size=1, max_size=30)


@settings(max_examples=25)
@given(values, values, st.booleans(), st.integers(0, 2**32 - 1))
def test_rates_and_area_of_counted_samples_are_those_of_scikit_learn(on, off, below, seed):
    one = scores(on, off, below=below)
    count = np.random.default_rng(seed).integers(1, 9, len(one.value))
    curve = replace(one, count=count)
    fpr, tpr, _ = metrics.roc_curve(
        one.on, one.likeness, sample_weight=count, drop_intermediate=False
    )
    accepted = [one.within(threshold) for threshold in curve.threshold]
    assert curve.tp.tolist() == [count[one.on & rows].sum() for rows in accepted]
    assert curve.fp.tolist() == [count[~one.on & rows].sum() for rows in accepted]
    points = set(zip(curve.fpr.tolist(), curve.tpr.tolist(), strict=True))
    gained = np.append(np.diff(tpr) > 0, False) | np.insert(np.diff(tpr) > 0, 0, False)
    corners = zip(fpr[gained].tolist(), tpr[gained].tolist(), strict=True)
    assert all(np.isclose(corner, list(points)).all(axis=1).any() for corner in corners)
    assert curve.area == pytest.approx(
        metrics.roc_auc_score(one.on, one.likeness, sample_weight=count)
    )


def test_the_curve_resolves_every_sign_among_many_others_and_the_threshold_of_the_run():
    draw = np.random.default_rng(4)
    on, off = draw.normal(4, 1, 16), draw.normal(0, 1, 200_000)
    curve = replace(scores(on, off), used=3.3)
    assert {*on.tolist(), 3.3} < {*curve.threshold.tolist()}
    assert len(curve.threshold) < 40
    for threshold, tpr, fpr in zip(curve.threshold, curve.tpr, curve.fpr, strict=True):
        assert (tpr, fpr) == ((on >= threshold).mean(), (off >= threshold).mean())
    assert curve.fpr[curve.used_row] == (off >= 3.3).mean()


def test_values_that_are_unknown_are_never_accepted():
    curve = scores([1.0, np.nan], [0.0, np.nan])
    assert curve.tpr[-1] == 0.5
    assert curve.positives == 2


def test_the_knee_of_two_normal_classes_lies_half_way_and_its_interval_holds_it():
    draw = np.random.default_rng(1)
    curve = scores(draw.normal(3, 1, 2000), draw.normal(0, 1, 2000), groups=20)
    assert curve.threshold[curve.knee] == pytest.approx(1.5, abs=0.2)
    assert curve.bands.knee.low <= curve.threshold[curve.knee] <= curve.bands.knee.high
    assert curve.area == pytest.approx(norm.cdf(3 / 2**0.5), abs=0.01)
    assert curve.bands.area.low < curve.area < curve.bands.area.high


def test_bands_are_wide_where_drives_differ_and_narrow_where_only_samples_do():
    draw = np.random.default_rng(2)
    shift = np.repeat([0.0, 0.0, 3.0, 3.0], 200)
    on, off = draw.normal(2, 1, 800) + shift, draw.normal(0, 1, 800)
    group = np.tile(np.repeat(np.arange(4), 200), 2)
    one = scores(on, off)
    by_drive = replace(one, group=group)
    shuffled = replace(one, group=draw.permutation(1600) % 40)
    widths = [np.ptp(c.bands.tpr, axis=1).max() for c in (by_drive, shuffled)]
    assert widths[0] > 3 * widths[1]


@pytest.mark.slow
def test_bands_hold_the_rate_as_often_as_they_say():
    held = 0
    for seed in range(60):
        draw = np.random.default_rng(seed)
        drive = np.repeat(np.arange(12), 30)
        on = draw.normal(1, 1, 360) + np.repeat(draw.normal(0, 0.5, 12), 30)
        off = draw.normal(0, 1, 360)
        curve = replace(scores(on, off), group=np.concatenate([drive, drive]))
        low, high = curve.bands.tpr[curve.at(0.5)]
        held += low <= norm.sf((0.5 - 1) / 1.25**0.5) <= high
    assert held >= 48  # of 60; a few drives make the bootstrap a little narrow


def test_nothing_can_be_said_without_signs_or_without_anything_else():
    assert not scores([], [1.0]).two_sided
    assert not scores([1.0], []).two_sided


def test_one_drive_is_resampled_by_stretches_and_several_by_drive():
    frame = np.array([0, 9, 10, 25], np.int32)
    group, what = resampled_groups(np.array(["a"] * 4), frame)
    assert (group.tolist(), what) == ([0, 0, 1, 2], "stretch")
    group, what = resampled_groups(np.array(["b", "a", "b", "a"]), frame)
    assert (group.tolist(), what) == ([1, 0, 1, 0], "drive")
