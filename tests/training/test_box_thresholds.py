"""Thresholds by a stated rate of false alarms; scores of two networks joined: the better classifier, as strict."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from training import box_thresholds
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON
from wayside.pipeline.models.model_folder import shipped_models
from wayside.pipeline.models.model_json import model_from_json, model_to_json
from wayside.pipeline.statistics import resampled_interval
from wayside.schemas.errors import InputError
from wayside.schemas.models import ScoreModel

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"

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
        made.append(box_thresholds.ScoredBoxes(box, score, label, on.astype(np.float32)))
    return made


def test_the_weights_are_those_of_the_log_odds_and_the_threshold_stays():
    made = images()
    joined, interval = box_thresholds.learn_network_sum([made[k::6] for k in range(6)], THRESHOLD)
    assert interval is not None
    assert interval.low < THRESHOLD < interval.high
    assert (joined.own, joined.network) == pytest.approx(tuple(SLOPES), abs=0.06)
    scores = [one.score @ (joined.own, joined.network) + joined.shift for one in made]
    off = [(score > THRESHOLD)[one.label == OFF] for score, one in zip(scores, made, strict=True)]
    assert np.concatenate(off).sum() == round(box_thresholds.FALSE_FACES * len(made))


def test_of_boxes_on_one_thing_only_the_best_is_counted_as_false():
    same = np.array([[0, 0, 20, 20]] * 3, np.float32)
    one = box_thresholds.ScoredBoxes(
        same, np.zeros((3, 2)), np.full(3, OFF), np.zeros(3, np.float32)
    )
    assert box_thresholds.false_scores(one, np.array([1.0, 3.0, 2.0])).tolist() == [3.0]


def test_boxes_of_one_kind_teach_nothing():
    one = images(1)[0]
    neither = replace(one, label=np.full(len(one.box), NEITHER, np.int8))
    with pytest.raises(InputError, match="Add drives"):
        box_thresholds.learn_network_sum([[neither]], THRESHOLD)


IMAGES, FACES, OTHERS = 30, 2, 20


def drive(shift, seed):
    """Images of boxes apart from each other, `FACES` on faces and `OTHERS` off any, with one score each."""
    draw = np.random.default_rng(seed)
    left = 20.0 * np.arange(FACES + OTHERS)
    box = np.stack([left, 0 * left, left + 10, 0 * left + 10], axis=1).astype(np.float32)
    on = np.arange(FACES + OTHERS) < FACES
    scores = [draw.normal(np.where(on, 2.0, -2.0), 1.0) + shift for _ in range(IMAGES)]
    label = np.where(on, ON, OFF).astype(np.int8)
    return [
        box_thresholds.ScoredBoxes(box, score[:, None], label, on.astype(float)) for score in scores
    ]


def threshold_of(drives, accepted=1.0):
    return box_thresholds.rule_threshold(drives, np.ones(1), accepted)


@pytest.mark.parametrize("accepted", [0.3, 3.0, 2.0 * OTHERS])
def test_the_threshold_lets_through_the_stated_rate_of_boxes_off_any_face(accepted):
    drives = [drive(0.0, seed) for seed in range(6)]
    threshold, _ = threshold_of(drives, accepted)
    off = np.concatenate([one.score[one.label == OFF] for images in drives for one in images])
    # where fewer are false than may be, the least of them is the threshold
    assert (off >= threshold).sum() == min(round(accepted * 6 * IMAGES), len(off))
    assert f"{accepted:g} boxes off any face" in box_thresholds.false_boxes_rule(accepted)


def test_the_interval_holds_the_threshold_and_is_wider_where_drives_differ():
    widths = []
    for apart in (0.0, 0.8):
        threshold, interval = threshold_of([drive(apart * seed, seed) for seed in range(6)])
        assert interval.low <= threshold <= interval.high
        widths.append(interval.high - interval.low)
    assert widths[1] > 3 * widths[0]


def test_of_a_single_drive_there_is_no_interval():
    assert threshold_of([drive(0.0, 1)])[1] is None
    assert resampled_interval(1, lambda count: 0.0) is None


def test_the_interval_of_a_mean_over_groups_is_that_of_the_normal_distribution():
    values = np.random.default_rng(3).normal(0, 1, 100)
    low, high = resampled_interval(100, lambda count: float(count @ values / 100), draws=4000)
    assert (high - low) / 2 == pytest.approx(1.96 * values.std() / 10, rel=0.06)


def test_a_file_keeps_the_rule_the_interval_and_the_sum_of_a_threshold():
    joined, interval = box_thresholds.learn_network_sum([images()], THRESHOLD)
    model = ScoreModel(THRESHOLD, "made up", joined, "alpha: 5 boxes", (-2.5, -1.0))
    again = model_from_json(model_to_json(model))
    assert interval is None
    assert again == model
    assert "threshold_rule" not in model_to_json(replace(model, threshold_rule=""))
    assert "with_network" not in model_to_json(replace(model, with_network=None))


@pytest.fixture
def of_demo(tmp_path, monkeypatch):
    """A folder of drives with the demo as one that is learned from, and three of its images."""
    monkeypatch.setattr(box_thresholds, "EVERY", 8)
    for ending in (".mcap", ".truth.json"):
        (tmp_path / f"learn_demo{ending}").symlink_to(DEMO.with_suffix(ending))
    for name in ("box.onnx", "network.onnx"):
        (tmp_path / name).write_bytes((shipped_models() / name).read_bytes())
    return tmp_path


def test_boxes_of_a_drive_are_scored_by_both_networks_and_labelled_by_its_truth(of_demo):
    faces, backs = box_thresholds.scored_boxes(of_demo / "learn_demo.mcap", of_demo)
    assert len(faces) == len(backs) == 3
    label = np.concatenate([one.label for one in faces])
    score = np.concatenate([one.score for one in faces])
    assert score.shape == (len(label), 2)
    assert set(label) == {OFF, ON, NEITHER}
    on, off = (np.median(score[label == kind], axis=0) for kind in (ON, OFF))
    assert (on > off + 2).all()
    assert {one.score.shape[1] for one in backs} == {1}
    assert sum(map(len, (one.box for one in backs))) < len(label)


def test_the_thresholds_are_written_beside_the_networks_with_what_they_come_from(of_demo, capsys):
    assert box_thresholds.main(["--drives", str(of_demo), "-o", str(of_demo)]) == 0
    front, back = (
        model_from_json((of_demo / name).read_text(), name) for name in ("front.json", "back.json")
    )
    assert front.provenance == back.provenance == "thresholds by learn_demo (3 images)"
    assert front.threshold_rule == box_thresholds.false_boxes_rule(box_thresholds.FALSE_FACES)
    assert back.threshold_rule == box_thresholds.false_boxes_rule(box_thresholds.FALSE_BACKS)
    assert front.with_network is not None
    assert back.with_network is None
    assert front.threshold_interval is None
    assert str(of_demo / "front.json") in capsys.readouterr().out


def test_a_folder_whose_networks_cannot_be_used_is_refused(of_demo, capsys):
    (of_demo / "box.onnx").write_bytes(b"none")
    assert box_thresholds.main(["--drives", str(of_demo), "-o", str(of_demo)]) == 3
    assert "box.onnx" in capsys.readouterr().err
    assert not (of_demo / "front.json").exists()


def test_with_many_samples_the_log_odds_are_those_of_scikit_learn_and_always_finite():
    random = np.random.default_rng(3)
    scores = random.normal(0, 2, (5000, 2))
    positive = random.random(5000) < 1 / (1 + np.exp(-(scores @ [0.5, 1.5] - 1)))
    slopes, shift = box_thresholds.platt(scores, positive)
    wanted = LogisticRegression(C=np.inf, tol=1e-8).fit(scores, positive)
    assert (*slopes, shift) == pytest.approx((*wanted.coef_[0], *wanted.intercept_), abs=0.01)
    apart = np.array([[-2.0], [-1.0], [1.0], [2.0]])
    (slope,), shift = box_thresholds.platt(apart, apart[:, 0] > 0)
    assert 0 < slope < 10
    assert shift == pytest.approx(0, abs=1e-6)
