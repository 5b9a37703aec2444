"""The networks of `detectors/` see red (class 0) and blue (class 1) cells of 16 px of an input of 64 x 64."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.models.detector_file import load_detector
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.detectors import SignClass
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ModelSettings
from wayside.stages.detection.detector_outputs import WHOLE_IMAGE, RawBoxes
from wayside.stages.detection.onnx_detector import (
    SUREST,
    OnnxDetector,
    fitted,
    score_log_odds,
    sign_boxes,
)

DETECTORS = Path(__file__).parent / "detectors"
FORMATS = sorted(path.stem for path in DETECTORS.glob("*.onnx"))


def detector(name, **settings):
    return load_detector(ModelSettings(detector=str(DETECTORS / f"{name}.onnx"), **settings))


def image():
    """128 x 96 pixels: one cell is 32 x 24 where it is stretched, 32 x 32 and 16 lower where it is letterboxed."""
    return np.full((96, 128, 3), 128, np.uint8)


def cell(name, column, row):
    """A box that is one cell of the network's input."""
    tall, first = (24, 0) if name in WHOLE_IMAGE else (32, -16)
    x, y = 32 * column, first + tall * row
    return [x, y, x + 32, y + tall]


def painted(*boxes):
    rgb = image()
    for box, color in boxes:
        x0, y0, x1, y1 = np.clip(box, 0, 128)
        rgb[y0:y1, x0:x1] = color
    return rgb


def test_there_is_a_network_of_every_format():
    assert len(FORMATS) == 7


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_is_recognised_and_its_boxes_stand_on_the_faces(name):
    file = detector(name)
    assert (file.format, file.input_size) == (name, (64, 64))
    red, blue = cell(name, 2, 1), cell(name, 1, 2)
    rgb = painted((red, (255, 0, 0)), (blue, (100, 100, 255)))
    found = OnnxDetector(file).boxes(rgb, 0.25, 0.4)
    np.testing.assert_allclose(found.box, [red, blue], atol=1e-3)
    odds = score_log_odds(np.array([1.0, 155 / 255]))
    np.testing.assert_allclose(found.score, odds, atol=2e-2)
    assert found.color.tolist() == found.shape.tolist() == [-1, -1]
    assert len(OnnxDetector(file).boxes(rgb, 0.7, 0.4)) == 1
    assert len(OnnxDetector(file).boxes(image(), 0.25, 0.4)) == 0


@pytest.mark.parametrize("name", FORMATS)
def test_classes_that_are_no_signs_are_left_out_and_counted(name, tmp_path):
    classes = tmp_path / "classes.toml"
    classes.write_text('[classes]\nblue = { color = "blue", shape = "circle" }\n')
    file = detector(name, classes=str(classes))
    assert file.signs == {1: SignClass("blue", "circle")}
    blue = cell(name, 1, 2)
    rgb = painted((cell(name, 2, 1), (255, 0, 0)), (blue, (0, 0, 255)))
    found = OnnxDetector(file).boxes(rgb, 0.25, 0.4)
    np.testing.assert_allclose(found.box, [blue], atol=1e-3)
    assert (found.color.tolist(), found.shape.tolist()) == (
        [COLORS.index("blue")],
        [SHAPES.index("circle")],
    )
    assert found.found == 2


def test_a_wrong_format_is_refused_when_an_image_is_seen():
    file = detector("yolov8", detector_format="detr_logits")
    with pytest.raises(InputError, match=r"are not boxes of format detr_logits: outputs"):
        OnnxDetector(file).boxes(image(), 0.25, 0.4)


@given(
    width=st.integers(20, 2000),
    height=st.integers(20, 2000),
    size=st.tuples(st.sampled_from([64, 96, 160]), st.sampled_from([64, 96, 160])),
    whole=st.booleans(),
)
def test_the_corners_of_the_image_are_where_scale_and_border_say(width, height, size, whole):
    seen, scale, border = fitted(np.full((height, width, 3), 7, np.uint8), size, whole=whole)
    assert seen.shape == (*size, 3)
    inside = (seen == 7).all(axis=2)
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    first = np.array([columns[0], rows[0]])
    last = np.array([columns[-1] + 1, rows[-1] + 1])
    np.testing.assert_allclose(first, border)
    np.testing.assert_allclose(last, border + scale * [width, height], atol=1e-3)
    if not whole:
        assert (last - first == size[::-1]).any()
        assert abs(scale[0] / scale[1] - 1) <= 0.5 / (min(last - first) - 0.5) + 1e-6


def test_of_boxes_on_one_face_the_best_stays_whatever_its_class():
    box = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [20, 0, 30, 10]], np.float32)
    raw = RawBoxes(box, np.array([0.5, 0.9, 0.4], np.float32), np.array([0, 1, 0]))
    assert sign_boxes(raw, (50, 50), None, 0.25, 0.4).box[:, 0].tolist() == [1, 20]
    assert len(sign_boxes(raw, (50, 50), None, 0.25, None)) == 3


def test_boxes_are_cut_at_the_border_and_dropped_outside_and_where_they_are_not_finite():
    box = [[-5, -5, 5, 5], [45, 45, 60, 60], [60, 0, 70, 9], [9, 9, 5, 5], [np.nan, 0, 5, 5]]
    score, number = np.full(5, 0.5, np.float32), np.zeros(5, np.int64)
    raw = RawBoxes(np.array(box, np.float32), score, number)
    found = sign_boxes(raw, (50, 50), None, 0.25, None)
    assert found.box.tolist() == [[0, 0, 5, 5], [45, 45, 50, 50]]


def test_no_score_is_sure_beyond_all_evidence():
    odds = score_log_odds(np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(1 / (1 + np.exp(-odds)), [1 - SUREST, 0.5, SUREST], rtol=1e-5)
