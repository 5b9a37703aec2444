"""The detection network learns, begins from an earlier one, and gives the same maps as a file."""

import numpy as np
import pytest

from training.detector_crops import (
    CELLS,
    CROP_PX,
    KNOWN,
    STRIDE,
    UNKNOWN,
    UNSURE,
)
from training.training_images import source_kind
from wayside.schemas.detections import NONE
from wayside.stages.detection import MAPS

SIDE = CROP_PX // STRIDE


@pytest.fixture
def network(torch):
    from training import detector_network

    return detector_network


@pytest.fixture
def batch(torch, network):
    """Yellow squares of 32 px, each in the middle of its crop."""
    count = 2
    rgb = np.full((count, CROP_PX, CROP_PX, 3), 80, np.uint8)
    rgb[:, 112:144, 112:144] = (250, 200, 20)
    heat = np.zeros((count, 2, SIDE, SIDE), np.float16)
    heat[:, 0, 32, 32] = 1
    held = {
        "rgb": rgb,
        "heat": heat,
        "doubt": np.zeros((count, 2, SIDE, SIDE), np.uint8),
        "cell": np.full((count, CELLS), 32 * SIDE + 32),
        "box": np.tile(np.array([112, 112, 144, 144], np.float32), (count, CELLS, 1)),
        "weight": np.eye(1, CELLS, dtype=np.float32).repeat(count, axis=0),
        "color": np.full((count, CELLS), NONE, np.int64),
        "shape": np.full((count, CELLS), NONE, np.int64),
    }
    held["color"][:, 0], held["shape"][:, 0] = 1, 2
    return {name: torch.from_numpy(values) for name, values in held.items()}


def noise(torch, count, height, width):
    return torch.randint(0, 256, (count, height, width, 3), dtype=torch.uint8)


def test_maps_are_a_quarter_of_the_image_and_start_with_few_faces(torch, network):
    with torch.no_grad():
        maps = network.DetectionNetwork().eval()(noise(torch, 1, 64, 128))
    assert maps.shape == (1, MAPS, 16, 32)
    assert maps[:, :2].sigmoid().max() < 0.2


def test_a_cell_that_may_show_a_sign_without_a_box_counts_less_where_the_network_sees_one(
    torch, network, batch
):
    maps = torch.zeros(2, MAPS, SIDE, SIDE)
    heat = {}
    for doubt in (KNOWN, UNSURE, UNKNOWN):
        held = batch | {"doubt": torch.full_like(batch["doubt"], doubt)}
        for sure in (False, True):
            losses = network.losses(maps, held, sure=sure)
            heat[doubt, sure] = float(losses["heat"])
    assert heat[UNKNOWN, True] < heat[UNSURE, True] < heat[UNSURE, False] < heat[KNOWN, True]
    assert heat[KNOWN, False] == heat[KNOWN, True]


def test_drives_and_sets_are_kinds_of_their_own():
    assert source_kind("ca_city_garmin") == "ca_city_garmin"
    assert source_kind("rendered/learn_alley") == "rendered"
    assert source_kind("scenes_mixed/ro") == "scenes_mixed"


def test_the_network_gives_the_same_maps_in_onnxruntime(torch, network, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    from wayside.stages.detection import DetectionNetwork as InOnnxRuntime

    fresh = network.DetectionNetwork()
    fresh.eval()
    with pytest.warns():
        network.export(fresh, tmp_path / "network.onnx", {"seed": 1})
    rgb = np.random.default_rng(0).integers(0, 256, (96, 128, 3)).astype(np.uint8)
    with torch.no_grad():
        expected = fresh(torch.from_numpy(rgb)[None])[0]
    found = InOnnxRuntime(str(tmp_path / "network.onnx")).maps(rgb).all()
    np.testing.assert_allclose(found, expected, atol=1e-3)
