"""A network in whole numbers against the same in floating point."""

from pathlib import Path

import numpy as np
import pytest

from training.detector_images import rendered_images
from training.quantization import quantize
from wayside.pipeline.models.model_files import onnx_metadata
from wayside.stages.detection import DetectionNetwork

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"


@pytest.fixture(scope="module")
def images():
    return [one.rgb for one in rendered_images(DEMO, 8)]


@pytest.fixture(scope="module")
def written(images, tmp_path_factory):
    """A network that was never trained, as a file in floating point and as one in whole numbers."""
    torch = pytest.importorskip("torch", reason="PyTorch is only needed for learning")
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    from training import detector_network

    torch.manual_seed(1)
    folder = tmp_path_factory.mktemp("networks")
    one, other = folder / "float.onnx", folder / "network.onnx"
    network = detector_network.DetectionNetwork()
    with pytest.warns():
        detector_network.export(network, one, {"sources": "demo: 3 images"})
    quantize(one, other, images)
    return one, other


def test_whole_numbers_give_nearly_the_same_maps(written, images):
    exact, whole = (DetectionNetwork(str(path)).maps(images[0]).all() for path in written)
    assert whole.shape == exact.shape
    assert np.abs(whole - exact).max() > 0
    assert np.std(whole - exact) < 0.1 * np.std(exact)


def test_a_file_in_whole_numbers_is_small_and_says_what_it_was_learned_from(written):
    one, other = written
    assert other.stat().st_size < 0.4 * one.stat().st_size
    said = onnx_metadata(other.read_bytes())
    assert said["sources"] == "demo: 3 images"
    assert "7 bits" in said["weights"]
