"""The box network that ships, on boxes of drawn faces and of textured ground."""

from functools import cache
from unittest.mock import MagicMock

import cv2
import numpy as np
import onnxruntime
import pytest

from wayside.pipeline.models.model_folder import shipped_models
from wayside.schemas.detections import LEARNED_COLORS, SHAPES
from wayside.schemas.models import ScoreModel
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.detection import BoxClassifier, BoxNetwork
from wayside.stages.detection.box_network import TOGETHER
from wayside.stages.geometry import iou_matrix
from wayside.stages.sign_codes import FaceClassifier

GROUND = np.array([[40, 200, 72, 232], [300, 20, 340, 60], [420, 280, 450, 330]], np.float32)
"""Boxes off all faces."""

DIAMOND, PLATE, STOP = [100, 100, 148, 148], [220, 90, 256, 135], [336, 146, 384, 194]


@cache
def network():
    return BoxNetwork(str(shipped_models() / "box.onnx"))


@cache
def scene():
    """A yellow diamond, a white plate with a legend and a red octagon before green texture."""
    random = np.random.default_rng(4)
    coarse = random.normal(0, 1, (46, 64)).astype(np.float32)
    texture = cv2.resize(coarse, (512, 368), interpolation=cv2.INTER_CUBIC)[..., None]
    rgb = np.array([95.0, 110, 80]) + 14 * texture + random.normal(0, 4, (368, 512, 3))
    rgb = np.ascontiguousarray(np.clip(rgb, 0, 255).astype(np.uint8))
    for size, color in ((24, (30, 30, 25)), (22, (240, 190, 30))):
        corners = [(124, 124 - size), (124 + size, 124), (124, 124 + size), (124 - size, 124)]
        cv2.fillPoly(rgb, [np.array(corners, np.int32)], color, cv2.LINE_AA)
    cv2.line(rgb, (124, 134), (124, 114), (30, 30, 25), 3, cv2.LINE_AA)
    cv2.rectangle(rgb, (220, 90), (255, 134), (230, 230, 228), -1)
    cv2.rectangle(rgb, (222, 92), (253, 132), (30, 30, 30), 1)
    cv2.putText(rgb, "50", (225, 125), cv2.FONT_HERSHEY_SIMPLEX, 0.75, (30, 30, 30), 2, cv2.LINE_AA)
    angles = np.pi / 8 + np.pi / 4 * np.arange(8)
    for size, color in ((25.8, (230, 230, 230)), (24, (190, 25, 35))):
        corners = np.stack([360 + size * np.cos(angles), 170 + size * np.sin(angles)], 1)
        cv2.fillPoly(rgb, [np.round(16 * corners).astype(np.int32)], color, cv2.LINE_AA, 4)
    cv2.putText(rgb, "STOP", (341, 176), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (240, 240, 240), 2, 16)
    return cv2.GaussianBlur(rgb, (0, 0), 0.6)


def some_boxes(count, seed=1):
    random = np.random.default_rng(seed)
    corner, size = random.uniform(0, 330, (count, 2)), random.uniform(8, 60, (count, 2))
    return np.concatenate([corner, corner + size], 1).astype(np.float32)


def columns(found):
    return {name: getattr(found, name) for name in ("front", "back", "offset", "color", "shape")}


def test_a_box_scores_the_same_however_many_others_are_asked_about():
    boxes = some_boxes(TOGETHER + 3)
    together = columns(network().scores(scene(), boxes))
    for rows in ([0], [5, 2], [TOGETHER - 1, TOGETHER, TOGETHER + 2]):
        apart = columns(network().scores(scene(), boxes[rows]))
        for name, values in apart.items():
            np.testing.assert_allclose(values, together[name][rows], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    "boxes",
    [
        some_boxes(0),
        some_boxes(7),
        np.array([[50, 50, 50.5, 50.5], [-30, -20, 10, 15], [500, 360, 600, 400]], np.float32),
    ],
    ids=["none", "inside", "too small or beyond the image"],
)
def test_every_box_has_a_finite_row_of_each_column(boxes):
    found, count = network().scores(scene(), boxes), len(boxes)
    wide = {"offset": (4,), "color": (len(LEARNED_COLORS),), "shape": (len(SHAPES),)}
    for name, values in columns(found).items():
        assert (values.dtype, values.shape) == (np.float32, (count, *wide.get(name, ())))
        assert np.isfinite(values).all()
    assert found.best.shape == (count,)


def test_a_clear_face_scores_far_higher_than_the_ground_and_has_its_colour_and_shape():
    faces = np.array([DIAMOND, PLATE, STOP], np.float32)
    shown = network().scores(scene(), np.concatenate([faces, GROUND]))
    assert shown.front[:3].min() > shown.front[3:].max() + 4
    assert (shown.front[:3] > shown.back[:3]).all()
    named = shown.select(np.arange(3))
    assert [LEARNED_COLORS[k] for k in named.color.argmax(axis=1)] == ["yellow", "white", "red"]
    assert [SHAPES[k] for k in named.shape.argmax(axis=1)] == ["diamond", "rectangle", "octagon"]


@pytest.mark.parametrize("side", range(4))
def test_offsets_lead_a_box_towards_its_face(side):
    face = np.array(DIAMOND, np.float32)
    off = face.copy()
    off[side] += 14 if side < 2 else -14
    (offset,) = network().scores(scene(), off[None]).offset
    moved = off + offset * np.tile(off[2:] - off[:2], 2)
    before, after = iou_matrix(np.stack([off, moved]), face[None])[:, 0]
    assert after > before + 0.05


def test_a_classifier_has_the_log_odds_of_its_side():
    found, boxes = network().scores(scene(), GROUND), GROUND
    for back, wanted in ((False, found.front), (True, found.back)):
        side = BoxClassifier(network(), ScoreModel(1.5, "made up"), back=back)
        np.testing.assert_array_equal(side.scores([(scene(), boxes)]), wanted)


@pytest.mark.parametrize(
    ("kind", "other"), [(BoxNetwork, "network.onnx"), (FaceClassifier, "box.onnx")]
)
def test_a_file_that_is_no_such_network_is_refused(kind, other, tmp_path):
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    for path in (shipped_models() / other, broken, tmp_path / "missing.onnx"):
        with pytest.raises(ValueError, match=r"."):
            kind(str(path))


def test_a_network_is_opened_once_on_the_best_that_onnxruntime_has(monkeypatch, tmp_path):
    path, opened = tmp_path / "box.onnx", MagicMock()
    path.write_bytes(b"a network")
    here = [f"{name}ExecutionProvider" for name in ("Azure", "CPU", "CUDA")]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: here)
    monkeypatch.setattr(onnxruntime, "InferenceSession", opened)
    for _ in range(2):
        OnnxNetwork(str(path))
    assert [call.kwargs["providers"] for call in opened.call_args_list] == [[here[2], here[1]]]
