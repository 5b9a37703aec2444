"""Signs that labels leave out: right to report, and no part of recall."""

import json

import pyarrow.parquet as pq
import pytest

from wayside.pipeline.evaluation.real import evaluate_against_labels


@pytest.fixture(scope="module")
def checked(load):
    return load("checked_boxes")


def test_a_row_on_an_unlabelled_sign_is_not_false_and_finds_nothing(checked, tmp_path, monkeypatch):
    boxes = {"signs": [[10, 10, 20, 20, "white", None]], "other": [[50, 50, 60, 60]]}
    path = tmp_path / "checked.json"
    path.write_text(json.dumps({"road": {"4": boxes}}))
    monkeypatch.setattr(checked, "OF_TESTS", path)
    label = {"id": "R1", "wanted": True, "facing": "front"}
    label |= {"boxes": [{"i": 3, "box": [0, 0, 9, 9]}]}
    labels = {"stride": 1, "signs": [label], "distractors": []}
    rows = [
        {"sign_id": name, "best_frame": 4, "best_box": box, "color": None, "shape": None}
        for name, box in (("d-0001", (10, 10, 21, 20)), ("d-0002", (50, 50, 60, 60)))
    ]
    plain = evaluate_against_labels(rows, [], labels)
    found = evaluate_against_labels(rows, [], checked.with_checked_boxes(labels, "road"))
    assert [one["sign_id"] for one in plain.false] == ["d-0001", "d-0002"]
    assert [one["sign_id"] for one in found.false] == ["d-0002"]
    assert (found.wanted, found.found, found.missed) == (1, (), ("R1",))
    assert checked.with_checked_boxes(labels, "other road") == labels


def test_the_boxes_of_the_drives_for_tests_are_of_none_that_is_learned_from(checked):
    own = json.loads(checked.OF_TESTS.read_text())
    assert own
    assert own.keys().isdisjoint(pq.read_table(checked.LEARNED)["source"].to_pylist())
