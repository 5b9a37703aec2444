"""Thresholds of the box classifiers: by a stated rate of false alarms, with the rule and an interval over drives."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.pipeline.learning.detector import FeaturedDrive, detection_rates
from wayside.pipeline.learning.samples import OFF, ON, CandidateSamples, TrainingDrive, TrueFaces
from wayside.pipeline.model_files import load_models
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.statistics import resampled_interval
from wayside.schemas.detections import Regions
from wayside.schemas.model_json import model_from_json, model_to_json

IMAGES, FACES, OTHERS = 30, 2, 20


def drive(name, shift, seed):
    """Boxes apart from each other, `FACES` on faces and `OTHERS` off any in an image, and their scores."""
    draw = np.random.default_rng(seed)
    each = FACES + OTHERS
    frame = np.repeat(np.arange(IMAGES), each)
    left = np.tile(np.arange(each) * 20.0, IMAGES)
    box = np.stack([left, 0 * left, left + 10, 0 * left + 10], axis=1).astype(np.float32)
    on = np.tile(np.arange(each) < FACES, IMAGES)
    face = np.where(on, np.cumsum(on) - 1, -1).astype(np.int32)
    count = len(frame)
    samples = CandidateSamples(
        Regions(box, np.full(count, 100), np.zeros((count, 3), np.float32), np.zeros(count, int)),
        frame.astype(np.int32),
        np.where(on, ON, OFF).astype(np.int8),
        on.astype(np.float32),
        face,
    )
    faces = TrueFaces(
        frame[on], box[on].astype(float), np.ones(on.sum(), bool), np.ones(IMAGES, bool)
    )
    wanted = np.ones(on.sum(), bool)
    known = TrainingDrive(name, IMAGES, (), samples, faces, wanted, (), np.zeros((0, 2)), faces)
    score = (draw.normal(np.where(on, 2.0, -2.0), 1.0) + shift).astype(np.float32)
    return FeaturedDrive(known, samples, np.zeros((count, 0), np.float32)), score


def rates_of(drives, accepted=1.0):
    passed, scores = zip(*drives, strict=True)
    return detection_rates(passed, scores, accepted, 0.5)


@pytest.mark.parametrize("accepted", [0.3, 1.0, 3.0])
def test_the_threshold_lets_through_the_stated_rate_of_boxes_off_any_face(accepted):
    drives = [drive(f"d{k}", 0.0, k) for k in range(6)]
    rates = rates_of(drives, accepted)
    off = np.concatenate([score[one.candidates.label == OFF] for one, score in drives])
    assert (off >= rates.threshold).sum() == pytest.approx(accepted * 6 * IMAGES, abs=1)
    assert f"{accepted:g} boxes off any face" in rates.rule


def test_the_interval_holds_the_threshold_and_is_wider_where_drives_differ():
    alike = rates_of([drive(f"d{k}", 0.0, k) for k in range(6)])
    unlike = rates_of([drive(f"d{k}", 0.8 * k, k) for k in range(6)])
    for rates in (alike, unlike):
        low, high = rates.interval
        assert low <= rates.threshold <= high
    assert np.ptp(unlike.interval) > 3 * np.ptp(alike.interval)


def test_of_a_single_drive_there_is_no_interval():
    assert rates_of([drive("d", 0.0, 1)]).interval is None
    assert resampled_interval(1, lambda count: 0.0) is None


def test_the_interval_of_a_mean_over_groups_is_that_of_the_normal_distribution():
    values = np.random.default_rng(3).normal(0, 1, 100)
    low, high = resampled_interval(100, lambda count: float(count @ values / 100), draws=4000)
    assert (high - low) / 2 == pytest.approx(1.96 * values.std() / 10, rel=0.06)


def test_a_file_of_trees_keeps_the_rule_and_the_interval_of_its_threshold():
    shipped = load_models(load_settings()[0]).box_classifier
    model = replace(shipped, threshold_rule="alpha: 5 boxes", threshold_interval=(-2.0, -1))
    again = model_from_json(model_to_json(model))
    assert (again.threshold_rule, again.threshold_interval) == ("alpha: 5 boxes", (-2, -1))
    unnamed = replace(shipped, network=None, threshold_rule="")
    assert "threshold_rule" not in model_to_json(unnamed)
