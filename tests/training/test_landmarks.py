from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.special import expit

from training import landmarks as module
from training.landmarks import (
    NEITHER,
    NOTHING,
    SIGN,
    KnownPanels,
    LandmarkSamples,
    label_of,
    labelled_landmarks,
    learn_landmark_classifier,
    samples_of,
)
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import Observation
from wayside.stages.classifiers import at_alpha, evidence_ratios
from wayside.stages.mapping import FEATURES


def joined(parts):
    """Samples of several drives as one, numbered by drive."""
    columns = (
        np.concatenate([getattr(one, field.name) for one in parts])
        for field in fields(LandmarkSamples)
    )
    drive = np.repeat(np.arange(len(parts)), [len(one.label) for one in parts])
    return replace(LandmarkSamples(*columns), drive=drive)


class SeenAt:
    """A landmark as far as labels need it."""

    def __init__(self, *boxes, back=False, position=(1.0, -0.5, 20.0)):
        self.back = back
        self.best_frame = len(boxes) - 1
        self.position = np.array(position)
        self.views = tuple(Observation(i, 0, 0.0, 0.0, box, 0.0) for i, box in enumerate(boxes))


def truth(side="front", faces_travel=True):
    views = [{"frame": i, "side": side, "box": [100, 100, 140, 140]} for i in range(3)]
    sign = {"id": 7, "faces_travel": faces_travel, "frames": views, "centre": [1.0, -0.5, 28.0]}
    camera = {"quaternion": [0.0, 0.0, 0.0, 1.0]}
    frames = [camera | {"index": i, "position": [0.0, 0.0, 4.0 * i]} for i in range(3)]
    return {"signs": [sign], "frames": frames}


def label(landmark, **known):
    return label_of(landmark, KnownPanels.of(truth(**known)))


FACE, HALF, AWAY = (102, 101, 139, 142), (100, 100, 140, 114), (400, 100, 440, 140)


def test_a_landmark_on_a_face_is_a_sign_and_one_on_nothing_is_none():
    assert label(SeenAt(FACE, FACE, FACE)) == SIGN
    assert label(SeenAt(AWAY, AWAY, AWAY)) == NOTHING


def test_boxes_on_a_face_at_a_wrong_depth_are_no_sign():
    assert label(SeenAt(FACE, FACE, FACE, position=(2.0, -1.0, 40.0))) == NOTHING


def test_hand_made_boxes_decide_in_the_images_that_have_them():
    box = {"box": [100, 100, 140, 140]}
    sign = {"id": "A", "facing": "front", "boxes": [{"i": 1} | box]}
    checked = {"2": {"signs": [[400, 100, 440, 140, None, None]]}}
    known = KnownPanels.of_labels({"signs": [sign]}, checked)
    assert label_of(SeenAt(AWAY, FACE, FACE), known) == SIGN
    assert label_of(SeenAt(FACE, HALF, FACE), known) == NEITHER
    assert label_of(SeenAt(FACE, AWAY, AWAY), known) == SIGN
    assert label_of(SeenAt(FACE, AWAY, FACE), known) == NOTHING
    group = KnownPanels.of_labels({"signs": [sign | {"group": True}]}, {})
    assert label_of(SeenAt(FACE, FACE, FACE), group) == NEITHER


def test_one_good_view_of_three_does_not_make_a_sign():
    assert label(SeenAt(FACE, AWAY, AWAY)) == NEITHER


def test_a_part_of_a_face_where_it_stands_is_nobodys_example():
    assert label(SeenAt(HALF, HALF, HALF)) == NEITHER
    assert label(SeenAt(HALF, HALF, HALF, position=(9.0, -0.5, 20.0))) == NOTHING


def test_backs_and_signs_for_others_are_no_signs():
    assert label(SeenAt(FACE, FACE, FACE), side="back") == NOTHING
    assert label(SeenAt(FACE, FACE, FACE), faces_travel=False) == NOTHING


def test_what_is_followed_as_a_back_is_one_where_a_panel_is_seen_from_behind():
    behind = SeenAt(FACE, FACE, FACE, back=True)
    assert label(behind, side="back", faces_travel=False) == SIGN
    assert label(behind) == NOTHING
    assert label(SeenAt(AWAY, AWAY, AWAY, back=True), side="back") == NOTHING


def examples(count=800, seed=4, source=""):
    """Landmarks whose scores and misses tell signs from others, with their log odds at even shares."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(0, 1, (count, len(FEATURES))).astype(np.float32)
    score, missed = FEATURES.index("score_best"), FEATURES.index("missed")
    values[:, score] *= 8
    values[:, missed] *= 0.8
    odds = 1.0 * (values[:, score] - 4) - 5.0 * (values[:, missed] - 0.4)
    label = np.where(rng.random(count) < expit(odds), SIGN, NOTHING).astype(np.int8)
    none, source = np.zeros(count, bool), np.full(count, source)
    return LandmarkSamples(values, label, np.arange(count) % 4, none, source, ~none), odds


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
    score = learned.values[:, FEATURES.index("score_best")]
    odds = 3 * np.clip(score - 6, -1, 1)
    rng = np.random.default_rng(7)
    learned = replace(learned, label=np.where(rng.random(6000) < expit(odds), SIGN, NOTHING))
    model = learn_landmark_classifier(learned, "test")
    curve = model.curves[model.features.index("score_best")]
    low, steep = curve[2] - curve[1], curve[4] - curve[3]
    assert steep > 4 * max(low, 0.05)


def test_the_sum_is_as_often_right_as_it_says_where_as_many_are_signs_as_it_expects(monkeypatch):
    monkeypatch.setattr(module, "REAL_WEIGHT", 4000.0)
    real = joined([examples(2000, seed, source)[0] for seed, source in ((1, "a"), (2, "b"))])
    model = learn_landmark_classifier(real, "test")
    fresh, _ = examples(20000, seed=9)
    rng = np.random.default_rng(10)
    kept = (fresh.label != SIGN) | (rng.random(20000) < 3 / 7)
    probability, sign = expit(sums(model, fresh.values[kept])), fresh.label[kept] == SIGN
    for low, high in ((0.1, 0.5), (0.5, 0.9)):
        own = (low < probability) & (probability < high)
        assert sign[own].mean() == pytest.approx(probability[own].mean(), abs=0.05)


def test_rendered_landmarks_never_outweigh_real_ones():
    real, rendered = examples(100, 1, "a")[0], examples(5000, 2)[0]
    both = joined([real, rendered])
    weight = module._weights(both, both.label == SIGN)
    assert weight[both.source == ""].sum() < 0.6 * weight[both.source == "a"].sum()


def test_a_stated_false_alarm_rate_is_that_of_the_traded_model_and_leaves_the_log_odds_alone():
    learned, _ = examples(4000)
    model = model_from_json(model_to_json(learn_landmark_classifier(learned, "test")))
    fresh, _ = examples(4000, seed=5)
    others = sums(model, fresh.values)[fresh.label == NOTHING]
    power = []
    for alpha in (0.01, 0.1, 0.3):
        traded = at_alpha(model, alpha)
        assert (others >= traded.decision).mean() == pytest.approx(alpha, abs=0.03)
        assert traded.threshold == pytest.approx(traded.decision + model.threshold)
        assert traded.shift == model.shift
        np.testing.assert_equal(traded.curves, model.curves)
        power.append((sums(traded, fresh.values)[fresh.label == SIGN] >= traded.decision).mean())
        stated = max(p.power for p in model.curve if p.false_alarm <= alpha)
        assert power[-1] == pytest.approx(stated, abs=0.05)
    assert power == sorted(power)
    with pytest.raises(ValueError, match="no operating point has"):
        at_alpha(model, 1e-6)


def test_no_feature_counts_against_its_nature():
    learned, _ = examples(4000)
    inverted = replace(learned, label=1 - learned.label)
    model = learn_landmark_classifier(inverted, "test")
    for name in ("score_best", "missed"):
        assert np.ptp(model.curves[model.features.index(name)]) == pytest.approx(0, abs=1e-3)


def test_examples_of_neither_kind_teach_nothing():
    learned, _ = examples()
    garbage = LandmarkSamples(
        np.concatenate([learned.values, learned.values[:50] + 9]),
        np.concatenate([learned.label, np.full(50, NEITHER, np.int8)]),
        *(
            np.concatenate([column, column[:50]])
            for column in (learned.drive, learned.back, learned.source, learned.usual)
        ),
    )
    one, other = learn_landmark_classifier(learned, "t"), learn_landmark_classifier(garbage, "t")
    np.testing.assert_equal(one.curves, other.curves)


def test_too_few_landmarks_are_refused_with_what_to_do():
    few, _ = examples(12)
    with pytest.raises(InputError, match="Add drives"):
        learn_landmark_classifier(few, "test")


def test_landmarks_of_several_drives_are_labelled_and_numbered_by_drive():
    landmark = SeenAt(FACE, FACE, FACE)
    landmark.features = tuple(range(len(FEATURES)))
    settled = [type("S", (), {"landmarks": (landmark, landmark)})]
    known, none = KnownPanels.of(truth()), KnownPanels.of({"signs": [], "frames": []})
    one, other = (labelled_landmarks(settled, panels, usual=True) for panels in (known, none))
    found = samples_of([("", one), ("city", []), ("city", other)])
    assert found.label.tolist() == [SIGN, SIGN, NOTHING, NOTHING]
    assert found.drive.tolist() == [0, 0, 2, 2]
    assert found.source.tolist() == ["", "", "city", "city"]
    assert found.values.shape == (4, len(FEATURES))
    assert len(samples_of([("", [])]).label) == 0
