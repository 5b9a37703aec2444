"""Estimation from few samples, held-out figures and thresholds by a rule."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from wayside.pipeline.learning import fits
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.classifiers import class_distances, log_ratios

NAMES = ("red", "blue")


def floor(mean):
    return np.full(len(mean), 0.1)


def fit(samples, prior=3.0):
    return fits.fit_classes(samples, NAMES, floor, prior)


def fit_model(samples):
    background = fits.fit_background(samples.values[samples.kind == ""], floor)
    return GaussianModel("", fit(samples), "", background)


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
    return fits.Samples(np.concatenate(parts), np.array(kind), np.array(sign), column, column)


def test_every_sign_counts_the_same_however_many_views_it_has():
    values = np.array([[0.0, 0]] * 9 + [[10.0, 0]])
    none, sign = np.zeros(10, int), np.array([0] * 9 + [1])
    (red,) = fit(fits.Samples(values, np.array(["red"] * 10), sign, none, none))
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


def test_a_sample_is_measured_by_a_model_fitted_without_its_fold():
    samples = road()
    distance, ratio = fits.held_out(samples, NAMES, fit_model)
    for fold in (0, 3):
        own = samples.fold == fold
        model = fit_model(samples.select(~own))
        assert distance[own] == pytest.approx(class_distances(samples.values[own], model.classes))
        assert ratio[own] == pytest.approx(log_ratios(samples.values[own], model))


def test_a_class_that_is_all_in_one_fold_is_never_accepted_there():
    samples = road()
    kept = samples.select((samples.kind != "blue") | (samples.fold == 2))
    distance, ratio = fits.held_out(kept, NAMES, fit_model)
    assert (distance[kept.kind == "blue", 1] == fits.BEYOND).all()
    assert (ratio[kept.kind == "blue", 1] == -fits.BEYOND).all()
    assert (distance[kept.fold != 2, 1] < fits.BEYOND).all()


def test_the_held_out_density_is_largest_near_the_true_scatter():
    samples = road(signs=30)

    def scaled(by):
        def fit_scaled(given_samples):
            return tuple(replace(c, covariance=by * c.covariance) for c in fit(given_samples))

        return fits.held_out_log_density(samples, fit_scaled)

    assert scaled(1.0) > scaled(0.2)
    assert scaled(1.0) > scaled(5.0)


def test_the_background_is_the_density_of_what_it_was_fitted_to():
    draw = np.random.default_rng(3)
    drawn = [draw.normal(0, 1, (6000, 2)), draw.normal((9, 2), (0.5, 3), (2000, 2))]
    background = fits.fit_background(np.concatenate([*drawn, [[np.nan, 0]]]), floor)
    assert sum(one.count for one in background) == pytest.approx(8000, abs=8)
    model = GaussianModel("", (GaussianClass("", np.zeros(2), np.eye(2), 1),), "", background)
    values = np.concatenate([draw.normal(0, 1, (300, 2)), draw.normal((9, 2), (0.5, 3), (100, 2))])
    parts = [multivariate_normal(np.zeros(2), np.eye(2)).logpdf(values) + np.log(0.75)]
    parts.append(multivariate_normal((9, 2), np.diag([0.25, 9])).logpdf(values) + np.log(0.25))
    wanted = np.logaddexp(*parts)
    found = multivariate_normal(np.zeros(2), np.eye(2)).logpdf(values)
    found -= log_ratios(values, model)[:, 0]
    assert np.mean(wanted - found) < 0.03  # Kullback-Leibler divergence, nats
    few = fits.fit_background(drawn[0][:30], floor)
    assert [one.count for one in few] == [30]


def scored(samples, alpha=0.05):
    return fits.score_held_out(samples, NAMES, *fits.held_out(samples, NAMES, fit_model), alpha)


def test_classes_far_from_the_rest_are_found_by_name_and_those_that_overlap_say_so():
    far, near = scored(road(apart=20)), scored(road(apart=0.2, others=400))
    assert far.others == 200
    assert far.false_rate.value < 0.05
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
    loose, tight = scored(samples, 0.1), scored(samples, 0.02)
    assert loose.false_rate.value == pytest.approx(0.1, abs=0.02)
    assert tight.false_rate.value == pytest.approx(0.02, abs=0.01)
    assert tight.named.value < loose.named.value
