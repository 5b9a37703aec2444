"""Learning of the landmark classifiers: what it finds in made-up examples, and what it refuses."""

import numpy as np
import pytest
from scipy.special import expit

from training import learn_landmarks as module
from training.learn_landmarks import SAMPLE, learn_landmark_classifier, main, provenance, samples_of
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.errors import InputError
from wayside.stages.classifiers import at_alpha, evidence_ratios
from wayside.stages.mapping import FEATURES


def joined(parts):
    """Samples of several drives as one, numbered by drive."""
    found = np.concatenate(parts).view(np.recarray)
    found.drive = np.repeat(np.arange(len(parts)), [len(one) for one in parts])
    return found


def examples(count=800, seed=4, source=""):
    """Landmarks whose scores and misses tell signs from others, with their log odds at even shares."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(0, 1, (count, len(FEATURES))).astype(np.float32)
    score, missed = FEATURES.index("score_best"), FEATURES.index("missed")
    values[:, score] *= 8
    values[:, missed] *= 0.8
    odds = 1.0 * (values[:, score] - 4) - 5.0 * (values[:, missed] - 0.4)
    label = np.where(rng.random(count) < expit(odds), ON, OFF).astype(np.int8)
    made = np.zeros(count, SAMPLE).view(np.recarray)
    made.values, made.label, made.usual, made.source = values, label, True, source
    made.drive = np.arange(count) % 4
    return made, odds


def sums(model, values):
    named = [dict(zip(FEATURES, row.tolist(), strict=True)) for row in values]
    return np.array([model.shift + sum(evidence_ratios(model, row).values()) for row in named])


def test_the_ratios_learned_are_those_of_what_made_the_examples(monkeypatch):
    monkeypatch.setattr(module, "REAL_WEIGHT", 4000.0)  # so many examples deserve it
    learned, _ = examples(4000)
    model = learn_landmark_classifier(learned, "test")
    fresh, odds = examples(seed=5)
    found = sums(model, fresh.values)
    assert np.polyfit(odds, found, 1)[0] == pytest.approx(1.0, abs=0.2)
    assert np.corrcoef(odds, found)[0, 1] > 0.94


def test_a_curve_may_bend_where_the_examples_ask_for_it(monkeypatch):
    monkeypatch.setattr(module, "REAL_WEIGHT", 4000.0)
    learned, _ = examples(6000)
    odds = 3 * np.clip(learned.values[:, FEATURES.index("score_best")] - 6, -1, 1)
    learned.label = np.where(np.random.default_rng(7).random(6000) < expit(odds), ON, OFF)
    model = learn_landmark_classifier(learned, "test")
    curve = model.curves[model.features.index("score_best")]
    low, steep = curve[2] - curve[1], curve[4] - curve[3]
    assert steep > 4 * max(low, 0.05)


def test_the_sum_is_as_often_right_as_it_says_where_as_many_are_signs_as_it_expects(monkeypatch):
    monkeypatch.setattr(module, "REAL_WEIGHT", 4000.0)
    real = joined([examples(2000, seed, source)[0] for seed, source in ((1, "a"), (2, "b"))])
    model = learn_landmark_classifier(real, "test")
    fresh, _ = examples(20000, seed=9)
    kept = (fresh.label != ON) | (np.random.default_rng(10).random(20000) < 3 / 7)
    probability, sign = expit(sums(model, fresh.values[kept])), fresh.label[kept] == ON
    for low, high in ((0.1, 0.5), (0.5, 0.9)):
        own = (low < probability) & (probability < high)
        assert sign[own].mean() == pytest.approx(probability[own].mean(), abs=0.05)


def test_rendered_landmarks_never_outweigh_real_ones():
    real, rendered = examples(100, 1, "a")[0], examples(5000, 2)[0]
    both = joined([real, rendered])
    weight = module._weights(both, both.label == ON)
    assert weight[both.source == ""].sum() < 0.6 * weight[both.source == "a"].sum()


def test_a_stated_false_alarm_rate_is_that_of_the_traded_model_and_leaves_the_log_odds_alone():
    learned, _ = examples(4000)
    model = model_from_json(model_to_json(learn_landmark_classifier(learned, "test")))
    fresh, _ = examples(4000, seed=5)
    others = sums(model, fresh.values)[fresh.label == OFF]
    power = []
    for alpha in (0.01, 0.1, 0.3):
        traded = at_alpha(model, alpha)
        assert (others >= traded.decision).mean() == pytest.approx(alpha, abs=0.03)
        assert traded.threshold == pytest.approx(traded.decision + model.threshold)
        assert traded.shift == model.shift
        np.testing.assert_equal(traded.curves, model.curves)
        power.append((sums(traded, fresh.values)[fresh.label == ON] >= traded.decision).mean())
        stated = max(p.power for p in model.curve if p.false_alarm <= alpha)
        assert power[-1] == pytest.approx(stated, abs=0.05)
    assert power == sorted(power)
    with pytest.raises(ValueError, match="no operating point has"):
        at_alpha(model, 1e-6)


def test_no_feature_counts_against_its_nature():
    learned, _ = examples(4000)
    learned.label = 1 - learned.label
    model = learn_landmark_classifier(learned, "test")
    for name in ("score_best", "missed"):
        assert np.ptp(model.curves[model.features.index(name)]) == pytest.approx(0, abs=1e-3)


def test_examples_of_neither_kind_teach_nothing():
    learned, _ = examples()
    neither = learned[:50].copy()
    neither.values, neither.label = neither.values + 9, NEITHER
    garbage = np.concatenate([learned, neither]).view(np.recarray)
    one, other = learn_landmark_classifier(learned, "t"), learn_landmark_classifier(garbage, "t")
    np.testing.assert_equal(one.curves, other.curves)


def test_too_few_landmarks_are_refused_with_what_to_do():
    few, _ = examples(12)
    with pytest.raises(InputError, match="Add drives"):
        learn_landmark_classifier(few, "test")


def test_landmarks_of_several_drives_are_numbered_by_drive_and_the_provenance_counts_them():
    row = (tuple(range(len(FEATURES))), ON, False, True)
    other = (row[0], OFF, False, True)
    found = samples_of([("", [row, row]), ("city", []), ("city", [other, row, other])])
    assert found.label.tolist() == [ON, ON, OFF, ON, OFF]
    assert found.drive.tolist() == [0, 0, 2, 2, 2]
    assert found.source.tolist() == ["", "", "city", "city", "city"]
    assert found.values.shape == (5, len(FEATURES))
    assert len(samples_of([("", [])])) == 0
    words = provenance(["learn_a_500", "empty", "b"], found)
    assert "learn_a_500 (2 landmarks), empty (0 landmarks), b (3 landmarks)" in words


def test_a_truth_that_is_missing_is_named(tmp_path, capsys):
    (tmp_path / "learn_a_500.mcap").write_bytes(b"")
    assert main(["--drives", str(tmp_path), "-o", str(tmp_path)]) == 3
    assert "learn_a_500.truth.json" in capsys.readouterr().err
