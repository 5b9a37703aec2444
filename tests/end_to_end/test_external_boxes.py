"""Boxes that are not wayside's, from the log to the tables: from the truth, and from a detector."""

import json
from collections import Counter
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import wayside
from wayside.pipeline.cli import app
from wayside.pipeline.evaluation.rendered import evaluate_against_truth
from wayside.schemas.errors import UsageError

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
DETECTORS = Path(__file__).parents[1] / "stages" / "detection" / "detectors"
SCORE = 0.8


@pytest.fixture(scope="module")
def parquet(true_boxes, tmp_path_factory):
    path = tmp_path_factory.mktemp("boxes") / "boxes.parquet"
    lost = {"frame": 9000, "x_min": 1, "y_min": 1, "x_max": 9, "y_max": 9, "class": "stop"}
    inverted = lost | {"frame": 3, "x_max": 0}
    outside = lost | {"frame": 4, "x_min": 1700, "x_max": 1720}
    every = [{**row, "score": SCORE} for row in (*true_boxes, lost, inverted, outside)]
    pq.write_table(pa.Table.from_pylist(every), path)
    return path


@pytest.fixture(scope="module")
def inventory(parquet):
    return wayside.run(DEMO, detections=parquet).finish()


def test_boxes_of_the_truth_give_all_signs_and_no_other(inventory, truth):
    signs = inventory.signs.to_pylist()
    found = evaluate_against_truth(signs, truth)
    assert (len(found.found), found.wanted, len(found.false)) == (8, 8, 0)
    assert max(abs(error) for match in found.found for error in match.error_m) < 0.1
    assert {row["status"] for row in signs} == {"sign"}
    assert found.class_right("color") == found.class_right("shape") == 1.0  # by the networks
    assert [row["confidence"] for row in signs] == pytest.approx([SCORE] * len(signs), abs=1e-5)


def test_every_box_is_a_candidate_or_counted(inventory, true_boxes, parquet):
    about = inventory.about
    counts = about["accounting"]["boxes"]
    assert counts["given"] == len(true_boxes) + 3
    assert counts["left_out"] == {"no_area": 1, "outside_image": 1, "not_in_log": 1}
    assert counts["candidates"] == len(true_boxes) == inventory.observations.num_rows
    verdicts = Counter(inventory.observations["verdict"].to_pylist())
    assert counts["of_signs"] == verdicts["sign"] > 0.9 * len(true_boxes)
    assert set(inventory.observations["source"].to_pylist()) == {"external"}
    assert about["detector"]["file"] == parquet.name
    assert about["detector"]["sha256"] == about["models"]["detections"]
    notes = " ".join(about["notes"])
    assert f"1 of {len(true_boxes) + 3} boxes are of images that the log does not hold" in notes
    assert "no class map" in notes


def test_a_detector_is_run_from_the_command_line(tmp_path, capsys):
    classes = tmp_path / "classes.toml"
    classes.write_text('[classes]\nred = { color = "red", shape = "octagon" }\n')
    onnx = DETECTORS / "yolov8.onnx"
    out = tmp_path / "out"
    arguments = ["run", str(DEMO), "-o", str(out), "--until", "0.5s", "--workers", "1"]
    arguments += ["--detector", str(onnx), "--classes", str(classes)]
    assert not app(arguments, standalone_mode=False)
    about = json.loads((out / "run.json").read_text())
    used = {"file": "yolov8.onnx", "sha256": about["models"]["detector"], "format": "yolov8"}
    used |= {"input": [64, 64], "classes": {"0": {"color": "red", "shape": "octagon"}}}
    assert about["detector"] == used
    counts = about["accounting"]["boxes"]
    assert counts["given"] == counts["candidates"] + counts["left_out"].get("other_class", 0)
    assert "detector, yolov8 of yolov8.onnx" in capsys.readouterr().out


def test_one_file_of_boxes_belongs_to_one_log(tmp_path):
    arguments = ["run", "a.mcap", "b.mcap", "-o", str(tmp_path), "--detections", "c.parquet"]
    with pytest.raises(UsageError, match="2 logs are given"):
        app(arguments, standalone_mode=False)
