"""Estimation from few samples, held-out figures and thresholds by a rule."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.pipeline.learning.fits import (
    BEYOND,
    Samples,
    distances_to,
    fit_classes,
    held_out_distances,
    held_out_log_density,
    score_held_out,
)

NAMES = ("red", "blue")


def floor(mean):
    return np.full(len(mean), 0.1)


def fit(samples, prior=3.0):
    return fit_classes(samples, NAMES, floor, prior)


def road(signs=6, views=4, others=200, seed=0, apart=6.0):
    """Signs of two classes `apart` sigmas from each other and from the rest, a sign a stretch."""
    random = np.random.default_rng(seed)
    parts, kind, sign, stretch = [], [], [], []
    for j, name in enumerate(NAMES):
        for k in range(signs):
            parts.append(random.normal((apart * (j + 1), 0), 1, (views, 2)))
            kind += [name] * views
            sign += [j * signs + k] * views
            stretch += [k] * views
    parts.append(random.normal((0, 0), 1, (others, 2)))
    kind += [""] * others
    sign += [-1] * others
    stretch += list(np.arange(others) % signs)
    column = np.array(stretch)
    return Samples(np.concatenate(parts), np.array(kind), np.array(sign), column, column)


def test_every_sign_counts_the_same_however_many_views_it_has():
    values = np.array([[0.0, 0]] * 9 + [[10.0, 0]])
    none, sign = np.zeros(10, int), np.array([0] * 9 + [1])
    (red,) = fit(Samples(values, np.array(["red"] * 10), sign, none, none))
    assert red.mean == pytest.approx([5, 0])
    assert red.count == 10


def test_a_class_of_few_signs_takes_its_covariance_from_the_others():
    samples = road(signs=40)
    few = samples.select((samples.kind == "red") | (samples.sign == 40))
    _, blue = fit(few, prior=1e6)
    red, _ = fit(few, prior=1e6)
    assert blue.covariance == pytest.approx(red.covariance, rel=1e-3, abs=1e-3)
    red, blue = fit(few, prior=0.0)
    assert not np.allclose(blue.covariance, red.covariance, rtol=0.2)


def test_no_axis_is_narrower_than_its_floor():
    samples = road(signs=5)
    same = replace(samples, values=np.zeros_like(samples.values))
    for one in fit(same):
        assert (np.sqrt(np.diag(one.covariance)) >= 0.1).all()


def test_a_sample_is_measured_by_classes_fitted_without_its_fold():
    samples = road()
    distance = held_out_distances(samples, NAMES, fit)
    for fold in (0, 3):
        own = samples.fold == fold
        wanted = distances_to(fit(samples.select(~own)), NAMES, samples.values[own])
        assert distance[own] == pytest.approx(wanted)


def test_a_class_that_is_all_in_one_fold_is_never_accepted_there():
    samples = road()
    kept = samples.select((samples.kind != "blue") | (samples.fold == 2))
    distance = held_out_distances(kept, NAMES, fit)
    assert (distance[kept.kind == "blue", 1] == BEYOND).all()
    assert (distance[kept.fold != 2, 1] < BEYOND).all()


def test_the_held_out_density_is_largest_near_the_true_scatter():
    samples = road(signs=30)

    def scaled(by):
        def fit_scaled(given_samples):
            return tuple(replace(c, covariance=by * c.covariance) for c in fit(given_samples))

        return held_out_log_density(samples, fit_scaled)

    assert scaled(1.0) > scaled(0.2)
    assert scaled(1.0) > scaled(5.0)


def scored(samples, alpha=None):
    return score_held_out(samples, NAMES, held_out_distances(samples, NAMES, fit), alpha)


def test_classes_far_from_the_rest_are_found_by_name_and_those_that_overlap_say_so():
    far, near = scored(road(apart=20)), scored(road(apart=0.2, others=400))
    assert far.others == 200
    assert far.false_rate.value == 0
    assert far.confusion.get("red -> blue", 0) == 0
    for one in (far, *far.classes):
        assert one.named.value > 0.9
    assert near.named.value - near.false_rate.value < 0.5
    assert near.named.low <= near.named.value <= near.named.high
    for one, other in zip(far.classes, near.classes, strict=True):
        assert one.curve.area == pytest.approx(1.0)
        assert other.curve.area < 0.75


def test_a_threshold_for_alpha_keeps_the_false_alarm_rate_on_what_is_held_out():
    samples = road(apart=1.5, others=2000)
    loose, tight = scored(samples), scored(samples, 0.02)
    assert loose.false_rate.value > 0.04
    assert tight.false_rate.value < 0.03
    assert tight.named.value < loose.named.value
