import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.stages.detection.detector_outputs import read_outputs, recognised

SIZE = (320, 640)
CELLS = 40 * 80 + 20 * 40 + 10 * 20


def table(rows, columns, low=0.1, high=0.9):
    return np.random.default_rng(0).uniform(low, high, (1, rows, columns)).astype(np.float32)


def numbered(rows, unit):
    values = table(rows, 6)
    values[..., :4] *= unit
    values[..., 5] = np.arange(rows) % 3
    return values


@pytest.mark.parametrize(
    ("outputs", "expected"),
    [
        ({"output0": table(84, CELLS)}, "yolov8"),
        ({"output0": table(5, CELLS)}, "yolov8"),
        ({"output0": table(6, 80 * 160 + CELLS)}, "yolov8"),
        ({"output0": table(3 * CELLS, 85)}, "yolov5"),
        ({"output": table(3 * CELLS, 6)}, "yolov5"),
        ({"output0": numbered(300, 320)}, "end_to_end"),
        ({"output0": np.zeros((1, 300, 6), np.float32)}, "end_to_end"),
        ({"output0": numbered(300, 1)}, "detr"),
        ({"output0": table(300, 6)}, "detr_classes"),
        ({"output0": table(300, 84)}, "detr_classes"),
        ({"logits": table(300, 80), "pred_boxes": table(300, 4)}, "detr_logits"),
        ({"labels": table(1, 9)[0], "boxes": table(9, 4), "scores": table(1, 9)[0]}, "detr_pixels"),
    ],
)
def test_a_format_is_recognised_by_shapes_names_and_units(outputs, expected):
    assert recognised(outputs, SIZE, "", 0) == expected


@pytest.mark.parametrize(
    ("outputs", "classes"),
    [
        ({"output0": table(84, CELLS + 1, 2, 90)}, 0),  # for another size of input
        ({"output0": table(84, CELLS)}, 79),  # not as many as the file states
        ({"output0": table(300, 84, 2, 90)}, 0),  # pixels without numbers of classes
        ({"output0": table(116, CELLS), "output1": table(32, 100)}, 0),  # with masks
        ({"output0": table(84, 5)[0]}, 0),
        ({"one": table(300, 80), "other": table(300, 4)}, 0),
        ({"output0": table(CELLS, 85)}, 0),  # one box a cell and objectness: exporters differ
    ],
)
def test_other_outputs_are_refused(outputs, classes):
    with pytest.raises(ValueError, match=r"outputs .*\[.* for an input of 640 x 320"):
        recognised(outputs, SIZE, "Detect", classes)


def test_boxes_of_an_untrained_detr_are_fractions_because_its_head_says_so():
    values = numbered(300, 1)
    values[0, 0, 2] = 0.0
    assert recognised({"output0": values}, SIZE, "", 0) == "end_to_end"
    assert recognised({"output0": values}, SIZE, "RTDETRDecoder", 0) == "detr"


def test_scores_that_are_no_probabilities_are_refused():
    with pytest.raises(ValueError, match="scores from -3 to -3"):
        read_outputs({"output0": np.full((1, 5, CELLS), -3, np.float32)}, "yolov8")


def test_logits_become_probabilities():
    outputs = {
        "logits": np.array([[[-1000.0, 0.0]]], np.float32),
        "pred_boxes": np.array([[[0.5, 0.5, 0.2, 0.1]]], np.float32),
    }
    box, score, number = read_outputs(outputs, "detr_logits")
    np.testing.assert_allclose(box, [[0.4, 0.45, 0.6, 0.55]], atol=1e-6)
    assert (score.tolist(), number.tolist()) == ([0.5], [1])


@pytest.mark.parametrize("form", ["yolov5", "yolov8", "end_to_end", "detr", "detr_classes"])
@given(rows=st.integers(0, 3), columns=st.integers(0, 8), more=st.booleans())
def test_outputs_of_any_shape_are_read_or_refused_as_such(form, rows, columns, more):
    outputs = {"a": np.zeros((1, rows, columns), np.float32)}
    if more:
        outputs["b"] = np.zeros((1, 1), np.float32)
    try:
        found = read_outputs(outputs, form)
    except ValueError:
        return
    assert found.box.shape == (len(found.score), 4)
    assert len(found.number) == len(found.score)
