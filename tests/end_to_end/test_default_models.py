"""Models of one's own folder take part in the decisions of a run."""

import json

import numpy as np
import pytest

from wayside.pipeline.models.model_folder import shipped_models
from wayside.schemas.detections import COLORS, SHAPES
from wayside.stages.detection import BOX_VALUES, COLOR_AT, SHAPE_AT

SHORT = ("--until", "0.4")


@pytest.fixture(scope="module")
def run_with(run_demo, tmp_path_factory):
    """Run the first frames of the demo with some model files changed by a function each; `box`: its content."""

    def run(**changes):
        folder = tmp_path_factory.mktemp("models")
        for name, change in changes.items():
            if name == "box":
                content = (shipped_models() / "box.onnx").read_bytes()
                (folder / "box.onnx").write_bytes(change(content))
                continue
            text = (shipped_models() / f"{name}.json").read_text()
            (folder / f"{name}.json").write_text(json.dumps(change(json.loads(text))))
        return run_demo(*SHORT, *(("--set", f"models.folder={folder}") if changes else ()))

    return run


def test_a_panel_larger_than_the_settings_allow_is_none(run_demo):
    result = run_demo(*SHORT, "--set", "locate.largest_side_m=0.85")
    assert max(row["panel_width_m"] for row in result.signs) <= 0.85
    assert result.verdicts["panel_size"] > 0


def with_bias(added):
    """A change of the box network that adds to values of a box, by their position."""

    def change(content):
        # the bias of the last layer in an ONNX file: its name (field 8), then its numbers (field 9)
        head = b"\x42\x08out.bias\x4a" + bytes([4 * BOX_VALUES])
        start = content.index(head) + len(head)
        bias = np.frombuffer(content, np.float32, BOX_VALUES, start).copy()
        for position, value in added.items():
            bias[position] += value
        return content[:start] + bias.tobytes() + content[start + bias.nbytes :]

    return change


def test_the_box_network_names_colors_and_shapes(run_with):
    blue, circle = COLOR_AT + COLORS.index("blue"), SHAPE_AT + SHAPES.index("circle")
    result = run_with(box=with_bias({blue: 60.0, circle: 60.0}))
    faces = [row for row in result.signs if row["status"] == "sign"]
    assert {(row["color"], row["shape"]) for row in faces} == {("blue", "circle")}


def test_where_the_box_network_sees_no_front_there_is_no_face(run_with):
    usual, blind = run_with(), run_with(box=with_bias({0: -60.0}))
    assert usual.signs
    assert not [row for row in blind.signs if row["color"] is not None]
    assert blind.verdicts.get("sign", 0) < usual.verdicts["sign"]


def strict(model):
    """The same scores, none of which is enough."""
    return model | {"threshold": 99.0}


def test_the_thresholds_decide_which_boxes_are_faces_and_backs(run_with):
    result = run_with(front=strict, back=strict)
    assert result.signs == []
    assert result.verdicts["score"] > 0
    assert not result.verdicts.keys() & {"sign", "unmatched", "few_views", "overlap"}
