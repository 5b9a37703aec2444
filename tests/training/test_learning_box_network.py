"""The box network learns, begins from an earlier one, and gives the same values as a file."""

import cv2
import numpy as np
import pytest

from wayside.pipeline.models.model_files import onnx_metadata
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.stages.detection import BOX_VALUES, INNER, SIDE, drawn_patches
from wayside.stages.detection import BoxNetwork as InOnnxRuntime
from wayside.stages.imaging import pyramid

EDGE = (SIDE - INNER) // 2


@pytest.fixture
def network(torch):
    from training import box_network

    return box_network


def batch(count=32, seed=0):
    """Every second patch shows a red square, the others nothing."""
    random = np.random.default_rng(seed)
    face = np.arange(count) % 2 == 0
    patch = random.integers(80, 140, (count, SIDE, SIDE, 3)).astype(np.uint8)
    patch[face, EDGE:-EDGE, EDGE:-EDGE] = (200, 40, 40)
    offset = random.normal(0, 0.1, (count, 4)).astype(np.float32)
    offset[~face] = np.nan
    return {
        "patch": patch,
        "size": random.uniform(8, 60, (count, 2)).astype(np.float32),
        "panel": np.stack([face, 0 * face], 1).astype(np.float32),
        "weight": np.ones((count, 2), np.float32),
        "offset": offset,
        "color": np.where(face, COLORS.index("red"), NONE),
        "shape": np.where(face, SHAPES.index("rectangle"), NONE),
    }


def tensors(torch, held):
    return {name: torch.from_numpy(column) for name, column in held.items()}


def scene(seed=1):
    """Levels of a textured image, and boxes of it."""
    random = np.random.default_rng(seed)
    coarse = random.uniform(0, 255, (30, 40, 3)).astype(np.float32)
    rgb = cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC).clip(0, 255)
    corner, size = random.uniform(0, 200, (60, 2)), random.uniform(8, 60, (60, 2))
    levels = pyramid(np.ascontiguousarray(rgb.astype(np.uint8)))
    return levels, np.concatenate([corner, corner + size], 1).astype(np.float32)


def shown(seed=1):
    """Columns of the boxes of such an image that a network sees."""
    levels, box = scene(seed)
    return {"patch": drawn_patches(levels, box), "size": box[:, 2:] - box[:, :2]}


def values_of(torch, network, seen):
    return network(torch.from_numpy(seen["patch"]), torch.from_numpy(seen["size"])).detach()


@pytest.fixture
def settled(torch, network):
    """A network of random weights whose layers are normalised by images like those that it is asked about."""
    torch.manual_seed(3)
    made = network.BoxNetwork()
    for layer in made.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.momentum = None  # the mean over all batches
    for seed in range(2, 6):
        values_of(torch, made, shown(seed))
    return made.eval()


def test_every_box_has_its_values(torch, settled):
    for count in (1, 5):
        assert values_of(torch, settled, batch(count)).shape == (count, BOX_VALUES)


def test_colours_hold_whatever_the_exposure_and_the_brightness_tells_it(torch, network):
    patches = torch.from_numpy(shown()["patch"]).float() * 0.6 + 60
    (colors, bright), (dimmer, dark) = (
        network.relative_colors(patches * exposure) for exposure in (1.0, 0.5)
    )
    assert (colors - dimmer).abs().mean() < 0.06
    np.testing.assert_allclose(bright - dark, np.log(2), atol=0.15)
    middle = colors[:, :, EDGE:-EDGE, EDGE:-EDGE].mean((1, 2, 3))
    np.testing.assert_allclose(middle, 0, atol=1e-5)


def test_what_weighs_nothing_is_not_learned_from(torch, network):
    held = batch()
    values = torch.zeros(len(held["size"]), BOX_VALUES)
    unknown = batch() | {
        "weight": np.zeros_like(held["weight"]),
        "offset": np.full_like(held["offset"], np.nan),
        "color": np.full_like(held["color"], NONE),
        "shape": np.full_like(held["shape"], NONE),
    }
    assert all(value > 0 for value in network.losses(values, tensors(torch, held)).values())
    assert all(value == 0 for value in network.losses(values, tensors(torch, unknown)).values())


def test_right_values_have_no_loss(torch, network):
    held = batch()
    sure = np.zeros((len(held["size"]), BOX_VALUES), np.float32)
    sure[:, :2] = np.where(held["panel"] > 0, 30, -30)
    sure[:, 2:6] = np.nan_to_num(held["offset"])
    sure[:, 6 + COLORS.index("red")] = sure[:, 6 + len(COLORS) + SHAPES.index("rectangle")] = 30
    for value in network.losses(torch.from_numpy(sure), tensors(torch, held)).values():
        assert float(value) == pytest.approx(0, abs=1e-5)


def test_the_file_gives_the_values_of_pytorch(torch, network, settled, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    with pytest.warns():
        network.export(settled, tmp_path / "box.onnx", {"sources": "demo: 3 images", "seed": 1})
    values = values_of(torch, settled, shown())
    found = InOnnxRuntime(str(tmp_path / "box.onnx")).scores(*scene())
    close = {"rtol": 1e-4, "atol": 1e-4}
    np.testing.assert_allclose(found.front, values[:, 0], **close)
    np.testing.assert_allclose(found.back, values[:, 1], **close)
    np.testing.assert_allclose(found.offset, values[:, 2:6], **close)
    np.testing.assert_allclose(found.color, values[:, 6:14], **close)
    np.testing.assert_allclose(found.shape, values[:, 14:], **close)
    said = onnx_metadata((tmp_path / "box.onnx").read_bytes())
    assert said == {"sources": "demo: 3 images", "seed": "1"}


def test_the_file_in_whole_numbers_gives_nearly_the_same_values(network, settled, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    from training.quantization import quantize_boxes

    one, other = tmp_path / "box_float.onnx", tmp_path / "box.onnx"
    with pytest.warns():
        network.export(settled, one, {"sources": "demo: 3 images"})
    quantize_boxes(one, other, map(shown, range(2, 6)))
    exact, whole = (InOnnxRuntime(str(path)).scores(*scene()) for path in (one, other))
    for name in ("front", "back", "offset", "color", "shape"):
        kept, changed = getattr(exact, name), getattr(whole, name)
        assert np.abs(kept - changed).max() > 0
        assert np.std(kept - changed) < 0.15 * np.std(kept)
    assert other.stat().st_size < 0.8 * one.stat().st_size
    said = onnx_metadata(other.read_bytes())
    assert said["sources"] == "demo: 3 images"
    assert "7 bits" in said["weights"]
