"""Colour classes fitted to samples of a road, compared with the shipped ones."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.pipeline.fitting import models
from wayside.pipeline.fitting.models import Task, fit_colors, model_rates
from wayside.pipeline.learning.fits import Samples
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.detections import COLORS
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.report import color_features

PAINT = {"green": (20.0, 90, 60), "yellow": (200.0, 160, 20)}


@pytest.fixture(autouse=True)
def one_prior(monkeypatch):
    """One strength of the prior, which takes a quarter of the time."""
    monkeypatch.setattr(models, "PRIOR_SIGNS", (3.0,))


def shipped():
    """Classes of another camera: as broad as the world."""
    wide = np.diag([50.0**2] * 3)
    means = {"green": (60.0, 120, 90), "yellow": (220.0, 190, 60), "red": (180.0, 40, 40)}
    classes = tuple(GaussianClass(name, np.array(mean), wide, 99) for name, mean in means.items())
    least = -(4.0**2 + np.linalg.slogdet(2 * np.pi * wide)[1]) / 2  # a distance of 4
    return GaussianModel("rgb", classes, "rendered", threshold=least - np.log(len(classes)))


def road(signs=6, light=0.0, seed=0, others=240, tint=0.0):
    """Signs of two paints in six stretches, in light that varies, and background of grey and some `tint`."""
    random = np.random.default_rng(seed)
    values, kind, sign, stretch = [], [], [], []
    for j, (name, rgb) in enumerate(PAINT.items()):
        for k in range(signs):
            gain = np.exp(random.normal(0, light, (5, 1)))
            values.append(np.array(rgb) * gain + random.normal(0, 4, (5, 3)))
            kind += [name] * 5
            sign += [j * signs + k] * 5
            stretch += [k % 6] * 5
    grey = random.uniform(10, 240, (others, 1)) * np.ones(3) + random.normal(0, 6, (others, 3))
    grey += random.uniform(-tint, tint, (others, 3))
    column = np.array([*stretch, *(np.arange(others) % 6)])
    every = np.clip(np.concatenate([*values, grey]), 0, 255)
    names, numbers = np.array(kind + [""] * others), np.array(sign + [-1] * others)
    return Samples(every, names, numbers, column, column)


def task(alpha=None, *, only_labelled=False):
    return Task(alpha, only_labelled, "labels of a test")


@pytest.fixture(scope="module")
def fitted():
    return fit_colors(road(), shipped(), task(), "rgb")


def test_fitted_colours_know_their_road_better_than_shipped_ones(fitted):
    assert fitted.better
    assert fitted.held.named.value > 0.9
    assert fitted.held.false_rate.value < 0.05 < fitted.shipped.false_rate.value
    by_name = {one.name: one for one in fitted.model.classes}
    for name, rgb in PAINT.items():
        assert by_name[name].mean == pytest.approx(rgb, abs=4)
        assert by_name[name].count == 30


def test_a_model_names_its_rule_interval_and_origin_and_is_read_back():
    fitted = fit_colors(road(), shipped(), task(alpha=0.03), "rgb")
    assert fitted.model.provenance == "labels of a test"
    assert "alpha 0.03" in fitted.model.threshold_rule
    low, high = fitted.model.threshold_interval
    assert low <= fitted.model.threshold <= high
    again = model_from_json(model_to_json(fitted.model))
    assert again.space == "rgb"
    assert [one.name for one in again.classes] == ["yellow", "green", "red"]


def test_without_labels_a_class_stays_as_shipped(fitted):
    assert fitted.kept == ("red",)
    red = next(one for one in fitted.model.classes if one.name == "red")
    assert red.mean == pytest.approx((180, 40, 40), abs=10)
    assert fitted.fitted.false_rate.value < 0.15


def test_only_labelled_classes_are_kept_on_request():
    fitted = fit_colors(road(), shipped(), task(only_labelled=True), "rgb")
    assert [one.name for one in fitted.model.classes] == ["yellow", "green"]
    assert fitted.kept == ()


def test_light_that_varies_leads_to_a_space_that_does_not_follow_it():
    samples = road(signs=12, light=0.7, tint=60.0)
    fitted = fit_colors(samples, shipped(), task(), "auto")
    assert fitted.model.space != "rgb"
    other = fitted.compared["rgb"]
    gain = fitted.held.named.value - fitted.held.false_rate.value
    assert gain > other.named.value - other.false_rate.value
    in_space = replace(samples, values=color_features(samples.values, fitted.model.space))
    assert model_rates(fitted.model, in_space, COLORS).named.value > 0.8


def test_too_few_signs_are_refused_however_many_views_they_have():
    samples = road(signs=4)
    many = samples.select(np.repeat(np.arange(len(samples)), 20))
    words = r"5 labelled signs of a colour .* there are 4 yellow, 4 green"
    for few in (samples, many):
        with pytest.raises(InputError, match=words):
            fit_colors(few, shipped(), task(), "rgb")


def test_without_complete_images_nothing_is_known_to_be_no_sign():
    samples = road()
    with pytest.raises(InputError, match=r"50 samples that are not signs .* there are 0"):
        fit_colors(samples.select(samples.kind != ""), shipped(), task(), "rgb")


def test_signs_of_one_stretch_cannot_be_held_out():
    samples = road()
    alone = replace(samples, fold=np.where(samples.kind == "", samples.fold, 0))
    with pytest.raises(InputError, match="two stretches"):
        fit_colors(alone, shipped(), task(), "rgb")


def test_a_model_that_is_not_clearly_better_than_the_shipped_one_says_so(fitted):
    assert not fit_colors(road(), fitted.model, task(), "rgb").better
