from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit

from wayside.pipeline.learning import landmarks as module
from wayside.pipeline.learning.landmarks import (
    NEITHER,
    NOTHING,
    SIGN,
    KnownPanels,
    LandmarkSamples,
    label_of,
    learn_landmark_classifier,
)
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import Observation
from wayside.schemas.model_json import model_from_json, model_to_json
from wayside.stages.mapping import FEATURES


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


def examples(count=800, seed=4):
    """Landmarks whose scores and misses tell signs from others, with their log odds at even shares."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(0, 1, (count, len(FEATURES))).astype(np.float32)
    score, missed = FEATURES.index("score_mean"), FEATURES.index("missed")
    values[:, score] *= 4
    values[:, missed] *= 4
    odds = 2.0 * (values[:, score] - 2) - 1.0 * (values[:, missed] - 2)
    label = np.where(rng.random(count) < expit(odds), SIGN, NOTHING).astype(np.int8)
    return LandmarkSamples(values, label, np.arange(count) % 4, np.zeros(count, bool)), odds


def sums(model, values):
    named = [dict(zip(FEATURES, row.tolist(), strict=True)) for row in values]
    return np.array([model.shift + sum(model.ratios(row).values()) for row in named])


@pytest.fixture
def as_measured(monkeypatch):
    """Landmarks are learned from as they are, without jitter."""
    monkeypatch.setattr(module, "JITTER", 0.0)


def test_what_is_measured_in_images_weighs_less_than_it_says_and_what_is_counted_as_much(
    monkeypatch,
):
    learned, _ = examples(4000)
    weights = {}
    for jitter in (0.0, 1.0):
        monkeypatch.setattr(module, "JITTER", jitter)
        model = learn_landmark_classifier(learned, "test")
        named = dict(zip(model.features, model.weight.tolist(), strict=True))
        weights[jitter] = named["score_mean"], named["missed"]
    (exact, counted), (jittered, still) = weights[0.0], weights[1.0]
    assert 0.3 * exact < jittered < 0.7 * exact
    assert 0.7 < still / counted < 1.1
    fit = learn_landmark_classifier(learned, "test")
    assert model_to_json(fit) == model_to_json(model)  # the same jitter each time


def test_the_ratios_learned_are_those_of_what_made_the_examples(as_measured):
    learned, _ = examples(4000)
    model = learn_landmark_classifier(learned, "test")
    fresh, odds = examples(seed=5)
    found = sums(model, fresh.values)
    assert np.polyfit(odds, found, 1)[0] == pytest.approx(1.0, abs=0.15)
    assert np.corrcoef(odds, found)[0, 1] > 0.94


def test_what_is_more_unusual_than_nearly_all_signs_counts_as_those_do():
    learned, _ = examples(4000)
    sign, wide = learned.label == SIGN, FEATURES.index("log_width")
    rng = np.random.default_rng(6)
    learned.values[:, wide] = rng.uniform(0, np.where(sign, 1.0, 3.0))
    model = learn_landmark_classifier(learned, "test")
    largest = np.quantile(learned.values[sign, wide], 0.99)
    rows = np.repeat(learned.values[:1], 3, axis=0)
    rows[:, wide] = 0.5, largest, 2.9
    usual, edge, beyond = sums(model, rows)
    assert usual > edge + 0.1
    assert beyond == pytest.approx(edge, abs=1e-3)


def test_as_many_others_as_stated_are_reported_as_signs():
    learned, _ = examples(4000)
    model = learn_landmark_classifier(learned, "test")
    fresh, _ = examples(4000, seed=5)
    others = sums(model, fresh.values)[fresh.label == NOTHING]
    assert (others >= 0).mean() == pytest.approx(module.FALSE_ALARM, abs=0.035)


def test_a_stated_false_alarm_rate_is_that_of_the_traded_model_and_leaves_the_log_odds_alone(
    as_measured,
):
    learned, _ = examples(4000)
    model = model_from_json(model_to_json(learn_landmark_classifier(learned, "test")))
    assert model.at_alpha(module.FALSE_ALARM).decision == pytest.approx(0, abs=1e-3)
    uncertain = module.UNCERTAIN_TIMES * module.FALSE_ALARM
    assert model.at_alpha(uncertain).decision == pytest.approx(model.threshold, abs=1e-3)
    low, high = model.threshold_interval
    assert low < 0 < high
    assert model.threshold_rule.startswith(f"alpha {module.FALSE_ALARM:g}: ")
    fresh, _ = examples(4000, seed=5)
    others = sums(model, fresh.values)[fresh.label == NOTHING]
    power = []
    for alpha in (0.01, 0.1, 0.3):
        traded = model.at_alpha(alpha)
        assert (others >= traded.decision).mean() == pytest.approx(alpha, abs=0.03)
        assert traded.threshold == pytest.approx(traded.decision + model.threshold)
        assert (traded.shift, *traded.weight) == (model.shift, *model.weight)
        power.append((sums(traded, fresh.values)[fresh.label == SIGN] >= traded.decision).mean())
        stated = max(p.power for p in model.curve if p.false_alarm <= alpha)
        assert power[-1] == pytest.approx(stated, abs=0.05)
    assert power == sorted(power)
    with pytest.raises(ValueError, match="wanted operating points"):
        model.at_alpha(1e-6)


def test_no_feature_counts_against_its_nature():
    learned, _ = examples(4000)
    names = [name for name, *_ in module.EVIDENCE]
    inverted = replace(learned, label=1 - learned.label)
    model = learn_landmark_classifier(inverted, "test")
    weights = dict(zip(names, model.weight.tolist(), strict=True))
    assert weights["score_mean"] == pytest.approx(0, abs=1e-6)
    assert weights["missed"] == pytest.approx(0, abs=1e-6)


def test_examples_of_neither_kind_teach_nothing():
    learned, _ = examples()
    garbage = LandmarkSamples(
        np.concatenate([learned.values, learned.values[:50] + 9]),
        np.concatenate([learned.label, np.full(50, NEITHER, np.int8)]),
        np.concatenate([learned.drive, learned.drive[:50]]),
        np.concatenate([learned.back, learned.back[:50]]),
    )
    one, other = learn_landmark_classifier(learned, "t"), learn_landmark_classifier(garbage, "t")
    np.testing.assert_array_equal(one.weight, other.weight)


def test_too_few_landmarks_are_refused_with_what_to_do():
    few, _ = examples(12)
    with pytest.raises(InputError, match="add drives"):
        learn_landmark_classifier(few, "test")


def test_landmarks_are_gathered_from_tracked_drives(monkeypatch):
    landmark = SeenAt(FACE, FACE, FACE)
    landmark.features = tuple(range(len(FEATURES)))
    settled = [type("S", (), {"landmarks": (landmark,)})]
    monkeypatch.setattr(module, "track", lambda moved, settings, front, back, panel: iter(settled))
    known, none = truth(), {"signs": [], "frames": []}
    found = module.gather_landmarks(
        module.PosedDrive(name, [], None, None, KnownPanels.of(content))
        for name, content in (("a", known), ("b", none), ("a", known))
    )
    assert found.label.tolist() == [SIGN, NOTHING, SIGN]
    assert found.drive.tolist() == [0, 1, 0]
    assert found.values.shape == (3, len(FEATURES))


def test_landmarks_of_several_drives_are_numbered_by_drive():
    one, _ = examples(3)
    one = replace(one, drive=np.zeros_like(one.drive))
    both = module.joined([one, one.side(back=True), one])
    assert len(both.label) == 2 * len(one.label)
    assert both.drive.tolist() == [0] * len(one.label) + [2] * len(one.label)
    np.testing.assert_array_equal(both.values, np.concatenate([one.values, one.values]))
