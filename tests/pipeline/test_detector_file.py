from hashlib import sha256
from pathlib import Path

import pytest

from wayside.pipeline.models import detector_file
from wayside.pipeline.models.detector_file import FLOAT32, load_detector
from wayside.pipeline.models.model_folder import shipped_models
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ModelSettings
from wayside.stages.classifiers import NetworkInput, OnnxNetwork

DETECTORS = Path(__file__).parents[1] / "stages" / "detection" / "detectors"
YOLO = DETECTORS / "yolov8.onnx"


def test_the_digest_of_a_detector_is_that_of_its_file_and_a_format_can_be_said():
    found = load_detector(ModelSettings(detector=str(YOLO), detector_format="yolov5"))
    assert found.onnx.sha256 == sha256(YOLO.read_bytes()).hexdigest()
    assert found.format == "yolov5"


def refused(path, **settings):
    with pytest.raises(InputError, match=r"models\.detector: ") as caught:
        load_detector(ModelSettings(detector=str(path), **settings))
    return str(caught.value)


@pytest.mark.parametrize(
    "data", [None, b"", b"no network", b"\xff" * 100, YOLO.read_bytes()[:-400]]
)
def test_what_is_no_onnx_file_is_refused(tmp_path, data):
    path = tmp_path / "broken.onnx"
    if data is not None:
        path.write_bytes(data)
    assert "an ONNX file" in refused(path)


def test_a_network_with_other_outputs_or_inputs_is_refused_with_them():
    words = refused(DETECTORS.parent / "other_outputs.onnx")
    assert "does not have the outputs of the YOLO or RT-DETR family" in words
    assert "heat [1, 2, 64, 64]" in words
    assert "docs/detectors.md" in words
    words = refused(Path(str(shipped_models())) / "network.onnx")
    assert "instead of one RGB image, float32" in words
    assert "[1, 0, 0, 3]" in words


def images(*shape, kind=FLOAT32):
    return NetworkInput("images", kind, shape)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"metadata": {"task": "segment"}}, "a network for the task 'segment'"),
        ({"inputs": (images(4, 3, 64, 64),)}, "float32 [4, 3, 64, 64]"),
        ({"inputs": (images(1, 1, 64, 64),)}, "[1, 1, 64, 64]"),
        ({"inputs": (images(1, 3, 64, 64, kind="tensor(float16)"),)}, "float16"),
        ({"inputs": (images(1, 3, 0, 64),)}, "both be fixed or both free"),
        ({"inputs": (images(1, 3, 64, 64), NetworkInput("mask", "", (1, 64, 64)))}, "mask"),
        ({"inputs": (images(1, 3, 10**9, 10**9),)}, "has an input of 1000000000 x 1000000000"),
        ({"inputs": (images(1, 3, 2**62, 2**62),)}, f"has an input of {2**62} x {2**62}"),
        ({"outputs": ("output7",)}, "cannot be run"),
    ],
)
def test_what_wayside_does_not_make_or_cannot_run_is_refused(monkeypatch, changes, words):
    network = OnnxNetwork(str(YOLO))
    vars(network).update(changes)  # the file says something else of itself
    monkeypatch.setattr(detector_file, "OnnxNetwork", lambda file: network)
    said = refused(YOLO)
    assert words in said
    assert ("output7" in said) == ("outputs" in changes)
