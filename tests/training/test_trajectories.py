"""How signs and other things move, learned from made-up tracks of points that stand still."""

import numpy as np
import pytest
from scipy.linalg import eigvalsh

from training.trajectories import Track, fitted, learn_trajectories, steps_in_form
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON
from wayside.pipeline.learning.thresholds import GATE_RATES
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.errors import InputError
from wayside.stages.classifiers import log_ratio
from wayside.stages.report.trajectory import mean_log_ratio

STEP = 8.0


def drive(seed, signs=12, others=40):
    """Signs stand 3 m right and half a metre up; the others anywhere, and some between both are of neither kind."""
    rng = np.random.default_rng(seed)
    tracks = []
    for label, count in ((ON, signs), (OFF, others), (NEITHER, 3)):
        for _ in range(count):
            right, down = rng.normal((3.1, -0.6), (0.8, 0.3)) if label else rng.normal(0, 12, 2)
            depth = rng.uniform(30, 70) - STEP * np.arange(4)
            rays = np.stack([right / depth, down / depth], axis=1) + rng.normal(0, 5e-4, (4, 2))
            steps = np.concatenate([rays[:-1], np.diff(rays, axis=0)], axis=1)
            tracks.append(Track(np.stack([steps, steps], axis=1), label, seed))
    return tracks


@pytest.fixture(scope="module")
def tracks():
    return [one for seed in range(5) for one in drive(seed)]


@pytest.fixture(scope="module")
def model(tracks):
    return learn_trajectories(tracks, "compensated", "made up")


def test_signs_are_kept_and_what_stands_elsewhere_goes_on_a_drive_not_learned_from(model):
    kept = {ON: [], OFF: [], NEITHER: []}
    for one in drive(99, 100, 300):
        kept[one.label].append(mean_log_ratio(one.steps, model) >= model.threshold)
    assert np.mean(kept[ON]) > 0.85
    assert np.mean(kept[OFF]) < GATE_RATES["trajectory"] + 0.1


def test_the_file_says_the_rule_its_rates_and_what_it_was_learned_from(model):
    assert model.threshold_rule.startswith(f"alpha {GATE_RATES['trajectory']:g}")
    text = model_to_json(model)
    again = model_from_json(text)
    assert model_to_json(again) == text
    steps = steps_in_form(drive(7), "compensated")
    np.testing.assert_allclose(log_ratio(steps, again), log_ratio(steps, model), rtol=1e-5)


def test_a_track_unlike_all_others_does_not_become_a_spike(tracks):
    odd = Track(np.full((1, 2, 4), 0.9), ON, 0)
    model = fitted([*tracks, odd], "image")
    nearest = np.linalg.norm(model.mean[: model.signs] - 0.9, axis=1).argmin()
    pooled = np.cov(steps_in_form([one for one in tracks if one.label == ON], "image").T)
    assert eigvalsh(model.covariance[nearest], pooled).min() > 0.01


def test_too_few_tracks_or_drives_are_refused_with_the_number_needed(tracks):
    for few in ([t for t in tracks if t.drive < 4], [t for t in tracks if t.label != ON]):
        with pytest.raises(InputError, match="40 tracks of signs, 40 others and 5 drives are"):
            learn_trajectories(few, "image", "made up")


@pytest.mark.parametrize(
    ("found", "put"),
    [
        ('"weight":[', '"weight":[0.5,'),
        ('"covariance":[[[', '"covariance":[[[-'),
        ('"threshold":', '"threshold":"x","was":'),
    ],
)
def test_a_damaged_density_is_refused(model, found, put):
    with pytest.raises(InputError, match="this is not a model file of wayside"):
        model_from_json(model_to_json(model).replace(found, put, 1))
