"""Calibration of the landmark classifier by labelled landmarks."""

import numpy as np
import pytest
from scipy.optimize import minimize
from sklearn import metrics

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.fitting.models import Task, fit_confidence
from wayside.pipeline.learning import fits
from wayside.pipeline.models.model_files import load_models
from wayside.schemas.errors import InputError
from wayside.stages.classifiers import evidence_ratios
from wayside.stages.mapping import FEATURES


def task(alpha=None):
    return Task(alpha, False, "labels")


def landmarks(count=200, slope=1.0, shift=0.0, seed=0):
    """Landmarks whose log odds are slope * score + shift."""
    random = np.random.default_rng(seed)
    score = random.normal(0, 3, count)
    on = random.random(count) < 1 / (1 + np.exp(-(slope * score + shift)))
    stretch = np.arange(count) % 10
    kind = np.where(on, "sign", "")
    return fits.Samples(score[:, None], kind, np.where(on, np.arange(count), -1), stretch, stretch)


@pytest.fixture(scope="module")
def shipped():
    return load_models(load_settings()[0]).landmark_classifier


def test_the_calibration_is_the_maximum_of_the_posterior():
    samples = landmarks(60, 0.6, -1.0)
    score, on = samples.values[:, 0], samples.kind != ""

    def negative(found):
        prior = ((found[0] - 1) / fits.SLOPE_SIGMA) ** 2 + (found[1] / fits.SHIFT_SIGMA) ** 2
        return len(on) * fits.log_loss(found[0] * score + found[1], on) + prior / 2

    wanted = minimize(negative, [1.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-8}).x
    assert fits.calibrated(score, on) == pytest.approx(wanted, abs=1e-4)
    assert fits.calibrated(score[:0], on[:0]) == pytest.approx((1, 0))  # without labels as shipped


def test_a_shift_of_the_user_s_road_is_found_and_helps_what_is_held_out(shipped):
    found = fit_confidence(landmarks(400, 1.0, -3.0), shipped, task())
    assert found.shift == pytest.approx(-3, abs=0.8)
    assert found.better
    assert found.brier_after < found.brier_before


def test_the_model_gives_the_calibrated_log_odds(shipped):
    found = fit_confidence(landmarks(200, 0.7, -1.0), shipped, task())
    random = np.random.default_rng(0)
    for values in random.uniform(-2, 5, (9, len(FEATURES))):
        named = dict(zip(FEATURES, values.tolist(), strict=True))
        before, after = (
            m.shift + sum(evidence_ratios(m, named).values()) for m in (shipped, found.model)
        )
        assert after == pytest.approx(found.slope * before + found.shift, abs=1e-4)
    assert found.model.provenance.startswith("labels; log odds")
    assert found.model.threshold == shipped.threshold


def test_the_fitted_model_holds_operating_points_of_the_user_s_own_road(shipped):
    samples = landmarks(1000, 0.7, -1.0)
    found = fit_confidence(samples, shipped, task(0.05))
    score = found.slope * samples.values[:, 0] + found.shift
    others = score[samples.kind == ""]
    assert (others >= found.model.decision).mean() == pytest.approx(0.05, abs=0.03)
    low, high = found.model.threshold_interval
    assert low < found.model.decision < high
    assert found.model.threshold == pytest.approx(shipped.threshold + found.model.decision)
    with pytest.raises(InputError, match=r"landmarks that are not signs allow no smaller rate"):
        fit_confidence(landmarks(60), shipped, task(0.01))


def test_few_landmarks_are_refused_with_the_number_needed(shipped):
    samples = landmarks(200)
    few = samples.select((samples.kind == "") | (samples.sign < 10))
    with pytest.raises(InputError, match=r"10 landmarks of labelled signs .* There are [0-9] and"):
        fit_confidence(few, shipped, task())


def test_log_loss_and_brier_score_are_those_of_scikit_learn():
    random = np.random.default_rng(4)
    score, on = random.normal(0, 2, 50), random.random(50) < 0.5
    chance = 1 / (1 + np.exp(-score))
    assert fits.log_loss(score, on) == pytest.approx(metrics.log_loss(on, chance))
    assert fits.brier_score(score, on) == pytest.approx(metrics.brier_score_loss(on, chance))
