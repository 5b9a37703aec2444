from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("sklearn", reason="learning needs scikit-learn")

from wayside.pipeline.learning import landmarks as module
from wayside.pipeline.learning.landmarks import (
    NEITHER,
    NOTHING,
    SIGN,
    LandmarkSamples,
    label_of,
    learn_landmark_classifier,
    panels_by_frame,
)
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import Observation
from wayside.stages.classifiers.trees import log_odds
from wayside.stages.mapping.landmark_features import FEATURES


class SeenAt:
    """A place as far as labels need it."""

    def __init__(self, *boxes, back=False):
        self.back = back
        self.views = tuple(Observation(i, 0, 0.0, 0.0, box, 0.0) for i, box in enumerate(boxes))


def truth(side="front", faces_travel=True):
    views = [{"frame": i, "side": side, "box": [100, 100, 140, 140]} for i in range(3)]
    return {"signs": [{"id": 7, "faces_travel": faces_travel, "frames": views}]}


FACE, HALF, AWAY = (102, 101, 139, 142), (100, 100, 140, 114), (400, 100, 440, 140)


def test_a_place_on_a_face_is_a_sign_and_one_on_nothing_is_none():
    known = panels_by_frame(truth())
    assert label_of(SeenAt(FACE, FACE, FACE), known) == SIGN
    assert label_of(SeenAt(AWAY, AWAY, AWAY), known) == NOTHING


def test_one_good_view_of_three_does_not_make_a_sign():
    assert label_of(SeenAt(FACE, AWAY, AWAY), panels_by_frame(truth())) == NEITHER


@pytest.mark.parametrize("box", [HALF])
def test_a_part_of_a_face_is_nobodys_example(box):
    assert label_of(SeenAt(box, box, box), panels_by_frame(truth())) == NEITHER


def test_backs_and_signs_for_others_are_no_signs():
    for known in (truth(side="back"), truth(faces_travel=False)):
        assert label_of(SeenAt(FACE, FACE, FACE), panels_by_frame(known)) == NOTHING


def test_what_is_followed_as_a_back_is_one_where_a_panel_is_seen_from_behind():
    behind = SeenAt(FACE, FACE, FACE, back=True)
    assert label_of(behind, panels_by_frame(truth(side="back", faces_travel=False))) == SIGN
    assert label_of(behind, panels_by_frame(truth())) == NOTHING
    away = SeenAt(AWAY, AWAY, AWAY, back=True)
    assert label_of(away, panels_by_frame(truth(side="back"))) == NOTHING


@pytest.fixture(autouse=True)
def few_trees(monkeypatch):
    monkeypatch.setattr(module, "TREES", replace(module.TREES, trees=30))


def examples(count=400, seed=4):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(count, len(FEATURES))).astype(np.float32)
    probability = 1 / (1 + np.exp(-2 * values[:, 3]))
    label = np.where(rng.random(count) < probability, SIGN, NOTHING).astype(np.int8)
    return LandmarkSamples(values, label, np.arange(count) % 4, np.zeros(count, bool)), probability


def test_the_classifier_states_odds_that_hold():
    learned, _ = examples()
    model = learn_landmark_classifier(learned, "test")
    fresh, probability = examples(seed=5)
    stated = 1 / (1 + np.exp(-log_odds(model, fresh.values)))
    for low, high in ((0.0, 0.3), (0.3, 0.7), (0.7, 1.0)):
        inside = (stated >= low) & (stated < high)
        assert abs(stated[inside].mean() - probability[inside].mean()) < 0.12


def test_examples_of_neither_kind_teach_nothing():
    learned, _ = examples()
    garbage = LandmarkSamples(
        np.concatenate([learned.values, learned.values[:50] + 9]),
        np.concatenate([learned.label, np.full(50, NEITHER, np.int8)]),
        np.concatenate([learned.drive, learned.drive[:50]]),
        np.concatenate([learned.back, learned.back[:50]]),
    )
    one, other = learn_landmark_classifier(learned, "t"), learn_landmark_classifier(garbage, "t")
    np.testing.assert_array_equal(one.value, other.value)


def test_too_few_places_are_refused_with_what_to_do():
    few, _ = examples(12)
    with pytest.raises(InputError, match="add drives"):
        learn_landmark_classifier(few, "test")


def test_places_are_gathered_from_tracked_drives(monkeypatch):
    place = SeenAt(FACE, FACE, FACE)
    place.features = tuple(range(len(FEATURES)))
    settled = [type("S", (), {"landmarks": (place,)})]
    monkeypatch.setattr(module, "track", lambda moved, settings, front, back, panel: iter(settled))
    known, none = truth() | {"name": "a"}, {"name": "b", "signs": []}
    found = module.gather_landmarks(
        module.PosedDrive([], None, None, truth) for truth in (known, none, known)
    )
    assert found.label.tolist() == [SIGN, NOTHING, SIGN]
    assert found.drive.tolist() == [0, 1, 0]
    assert found.values.shape == (3, len(FEATURES))


def test_places_of_several_drives_are_numbered_by_drive():
    one, _ = examples(3)
    one = replace(one, drive=np.zeros_like(one.drive))
    both = module.joined([one, one.side(back=True), one])
    assert len(both.label) == 2 * len(one.label)
    assert both.drive.tolist() == [0] * len(one.label) + [2] * len(one.label)
    np.testing.assert_array_equal(both.values, np.concatenate([one.values, one.values]))
