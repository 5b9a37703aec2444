from hashlib import sha256
from pathlib import Path

import pytest

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models import detector_file
from wayside.pipeline.models.detector_file import FLOAT32, load_detector
from wayside.pipeline.models.model_files import shipped_models
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.settings import ModelSettings
from wayside.stages.classifiers import NetworkInput, OnnxNetwork

DETECTORS = Path(__file__).parents[1] / "stages" / "detection" / "detectors"
YOLO = DETECTORS / "yolov8.onnx"


def test_a_network_has_inputs_outputs_and_metadata():
    network = OnnxNetwork(str(DETECTORS / "detr_pixels.onnx"))
    assert [(one.name, one.shape) for one in network.inputs] == [
        ("images", (1, 3, 64, 64)),
        ("orig_target_sizes", (1, 2)),
    ]
    assert network.inputs[0].type == FLOAT32
    assert network.outputs == ("labels", "boxes", "scores")
    assert network.metadata["names"] == "{0: 'red', 1: 'blue'}"


@pytest.mark.parametrize("data", [b"", b"no network", b"\x08\x01" * 20, b"\xff" * 100])
def test_bytes_that_are_no_network_are_none(data):
    with pytest.raises(ValueError, match=r"."):
        OnnxNetwork(data)


def refused(path, **settings):
    with pytest.raises(InputError, match=r"models\.detector: ") as caught:
        load_detector(ModelSettings(detector=str(path), **settings))
    return str(caught.value)


def test_what_is_no_onnx_file_is_refused(tmp_path):
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    assert "an ONNX file" in refused(broken)
    assert "an ONNX file" in refused(tmp_path / "missing.onnx")
    cut = tmp_path / "cut.onnx"
    cut.write_bytes(YOLO.read_bytes()[:-400])
    assert "an ONNX file" in refused(cut)


def test_a_network_with_other_outputs_is_refused_with_them():
    words = refused(DETECTORS.parent / "other_outputs.onnx")
    assert "does not have the outputs of the YOLO or RT-DETR family" in words
    assert "heat [1, 2, 64, 64]" in words
    assert "docs/detectors.md" in words


def test_a_network_that_takes_no_floating_point_is_refused_with_what_it_takes():
    words = refused(Path(str(shipped_models())) / "network.onnx")
    assert "instead of one RGB image, float32" in words
    assert "[1, 0, 0, 3]" in words


def with_header(monkeypatch, **changes):
    """Let a file say something else of itself."""

    class Other(OnnxNetwork):
        def __init__(self, file):
            super().__init__(file)
            vars(self).update(changes)

    monkeypatch.setattr(detector_file, "OnnxNetwork", Other)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"metadata": {"task": "segment"}}, "a network for the task 'segment'"),
        ({"inputs": (NetworkInput("a", FLOAT32, (4, 3, 64, 64)),)}, r"float32 [4, 3, 64, 64]"),
        ({"inputs": (NetworkInput("a", FLOAT32, (1, 1, 64, 64)),)}, r"[1, 1, 64, 64]"),
        ({"inputs": (NetworkInput("a", "tensor(float16)", (1, 3, 64, 64)),)}, "float16"),
        ({"inputs": (NetworkInput("a", FLOAT32, (1, 3, 0, 64)),)}, "both be fixed or both free"),
        ({"inputs": (NetworkInput("a", FLOAT32, (1, 3, 2**62, 9)),)}, f"input of 9 x {2**62}"),
        (
            {
                "inputs": (
                    NetworkInput("pixel_values", FLOAT32, (1, 3, 64, 64)),
                    NetworkInput("pixel_mask", "tensor(int64)", (1, 64, 64)),
                )
            },
            "pixel_mask",
        ),
    ],
)
def test_inputs_that_wayside_does_not_make_are_refused(monkeypatch, changes, words):
    with_header(monkeypatch, **changes)
    assert words in refused(YOLO)


def test_a_network_that_does_not_run_is_refused_with_the_words_of_the_engine(monkeypatch):
    with_header(monkeypatch, outputs=("output7",))
    words = refused(YOLO)
    assert "cannot be run" in words
    assert "output7" in words


def test_a_format_can_be_said_and_the_digest_is_that_of_the_file():
    found = load_detector(ModelSettings(detector=str(YOLO), detector_format="yolov5"))
    assert found.format == "yolov5"
    assert found.onnx.sha256 == sha256(YOLO.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"models.detector": "a.onnx", "models.detections": "b.parquet"}, "Give one"),
        ({"models.classes": "a.toml"}, "give --detector or --detections"),
        ({"models.detector": "a.onnx", "report.on": True}, "preset default"),
    ],
)
def test_options_that_exclude_each_other_are_refused(options, words):
    with pytest.raises(UsageError, match=words):
        load_settings("default", None, [], options)
