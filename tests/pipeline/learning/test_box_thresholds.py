"""Scores of two classifiers joined: the sum must be the better classifier, and accept at the old threshold."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.pipeline.learning.box_thresholds import (
    FALSE_FACES,
    ScoredBoxes,
    false_scores,
    learn_network_sum,
)
from wayside.pipeline.learning.samples import NEITHER, OFF, ON
from wayside.schemas.errors import InputError

THRESHOLD, SLOPES = -2.0, np.array([0.8, 0.4])


def images(count=60, boxes=150, seed=2):
    """Boxes far from each other whose label has the log odds `SLOPES` times the scores, less 1."""
    rng = np.random.default_rng(seed)
    corner = 50.0 * np.arange(boxes, dtype=np.float32)[:, None]
    box = np.concatenate([corner, corner, corner + 20, corner + 20], axis=1)
    made = []
    for _ in range(count):
        score = rng.normal((-2, -3), 2, (boxes, 2)).astype(np.float32)
        on = rng.random(boxes) < 1 / (1 + np.exp(1 - score @ SLOPES))
        label = np.where(on, ON, OFF).astype(np.int8)
        made.append(ScoredBoxes(box, score, label, on.astype(np.float32)))
    return made


def test_the_weights_are_those_of_the_log_odds_and_the_threshold_stays():
    made = images()
    joined, interval = learn_network_sum([made[k::6] for k in range(6)], THRESHOLD, 0.5)
    assert interval is not None
    assert interval.low < THRESHOLD < interval.high
    assert (joined.own, joined.network) == pytest.approx(tuple(SLOPES), abs=0.06)
    scores = [one.score @ (joined.own, joined.network) + joined.shift for one in made]
    off = [(score > THRESHOLD)[one.label == OFF] for score, one in zip(scores, made, strict=True)]
    assert np.concatenate(off).sum() == round(FALSE_FACES * len(made))


def test_of_boxes_on_one_thing_only_the_best_is_counted_as_false():
    same = np.array([[0, 0, 20, 20]] * 3, np.float32)
    one = ScoredBoxes(same, np.zeros((3, 2)), np.full(3, OFF), np.zeros(3, np.float32))
    assert false_scores(one, np.array([1.0, 3.0, 2.0]), 0.5).tolist() == [3.0]


def test_boxes_of_one_kind_teach_nothing():
    one = images(1)[0]
    with pytest.raises(InputError, match="add drives"):
        learn_network_sum(
            [[replace(one, label=np.full(len(one.box), NEITHER, np.int8))]], THRESHOLD, 0.5
        )
