"""Both networks learn what their losses say, and say the same as a file, in floating point and in whole numbers."""

from dataclasses import fields

import cv2
import numpy as np
import pytest

from training.detector_crops import CROP_PX, KNOWN, STRIDE, UNKNOWN, UNSURE, targets
from training.detector_images import FRONT, LabelledImage
from wayside.pipeline.models.model_files import onnx_metadata
from wayside.schemas.detections import LEARNED_COLORS, NONE, SHAPES
from wayside.stages.detection import BOX_VALUES, INNER, MAPS, SIDE, drawn_patches, log_levels
from wayside.stages.detection import BoxNetwork as InOnnxRuntime

CELLS_WIDE = CROP_PX // STRIDE


@pytest.fixture
def networks(torch):
    from training import networks

    return networks


def test_maps_are_a_quarter_of_the_image_and_start_with_few_faces(torch, networks):
    rgb = torch.randint(0, 256, (1, 64, 128, 3), dtype=torch.uint8)
    with torch.no_grad():
        maps = networks.DetectionNetwork().eval()(rgb)
    assert maps.shape == (1, MAPS, 16, 32)
    assert maps[:, :2].sigmoid().max() < 0.2


def test_a_cell_that_may_show_a_sign_without_a_box_counts_less_where_the_network_sees_one(
    torch, networks
):
    rgb = np.full((CROP_PX, CROP_PX, 3), 80, np.uint8)
    rgb[112:144, 112:144] = (250, 200, 20)
    face = ([112, 112, 144, 144], FRONT, "yellow", "rectangle")
    crop = targets(LabelledImage.of(("set", "one"), rgb, [face]))
    two = {one.name: np.stack([getattr(crop, one.name)] * 2) for one in fields(crop)}
    batch = tensors(torch, two)
    maps = torch.zeros(2, MAPS, CELLS_WIDE, CELLS_WIDE)
    heat = {}
    for doubt in (KNOWN, UNSURE, UNKNOWN):
        held = batch | {"doubt": torch.full_like(batch["doubt"], doubt)}
        for sure in (False, True):
            losses = networks.DetectionNetwork.losses(maps, held, sure=sure)
            heat[doubt, sure] = float(losses["heat"])
    assert heat[UNKNOWN, True] < heat[UNSURE, True] < heat[UNSURE, False] < heat[KNOWN, True]
    assert heat[KNOWN, False] == heat[KNOWN, True]


def test_the_network_gives_the_same_maps_in_onnxruntime(torch, networks, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    from wayside.stages.detection import DetectionNetwork as InOnnxRuntime

    fresh = networks.DetectionNetwork()
    fresh.eval()
    with pytest.warns():
        fresh.write(tmp_path / "network.onnx", {"seed": 1})
    rgb = np.random.default_rng(0).integers(0, 256, (96, 128, 3)).astype(np.uint8)
    with torch.no_grad():
        expected = fresh(torch.from_numpy(rgb)[None])[0]
    found = InOnnxRuntime(str(tmp_path / "network.onnx")).maps(rgb).all()
    np.testing.assert_allclose(found, expected, atol=1e-3)


EDGE = (SIDE - INNER) // 2


def boxes(count=32, seed=0):
    """Every second patch shows a red square, the others nothing."""
    random = np.random.default_rng(seed)
    face = np.arange(count) % 2 == 0
    patch = random.integers(80, 140, (count, SIDE, SIDE, 3)).astype(np.uint8)
    patch[face, EDGE:-EDGE, EDGE:-EDGE] = (200, 40, 40)
    offset = random.normal(0, 0.1, (count, 4)).astype(np.float32)
    offset[~face] = np.nan
    look = {"color": LEARNED_COLORS.index("red"), "shape": SHAPES.index("rectangle")}
    look = {name: np.where(face, number, NONE) for name, number in look.items()}
    size, panel = random.uniform(8, 60, (count, 2)), np.stack([face, 0 * face], 1)
    known = {"size": size, "panel": panel, "weight": np.ones((count, 2)), "offset": offset}
    return {"patch": patch} | look | {name: v.astype(np.float32) for name, v in known.items()}


def tensors(torch, held):
    return {name: torch.from_numpy(column) for name, column in held.items()}


def scene(seed=1):
    """A textured image, and boxes of it."""
    random = np.random.default_rng(seed)
    coarse = random.uniform(0, 255, (30, 40, 3)).astype(np.float32)
    rgb = cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC).clip(0, 255)
    corner, size = random.uniform(0, 200, (60, 2)), random.uniform(8, 60, (60, 2))
    return rgb.astype(np.uint8), np.concatenate([corner, corner + size], 1).astype(np.float32)


def shown(seed=1):
    """Columns of the boxes of such an image that a network sees."""
    rgb, box = scene(seed)
    return {"patch": log_levels(drawn_patches(rgb, box)), "size": box[:, 2:] - box[:, :2]}


def values_of(torch, asked, seen):
    return asked(torch.from_numpy(seen["patch"]), torch.from_numpy(seen["size"])).detach()


@pytest.fixture
def settled(torch, networks):
    """A network of random weights whose layers are normalised by images like those that it is asked about."""
    torch.manual_seed(3)
    made = networks.BoxNetwork()
    for layer in made.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.momentum = None  # the mean over all batches
    for seed in range(2, 6):
        values_of(torch, made, shown(seed))
    return made.eval()


def test_colours_hold_whatever_the_exposure_and_the_brightness_tells_it(torch, networks):
    patches = drawn_patches(*scene()) * 0.6 + 60
    seen = [torch.from_numpy(log_levels((k * patches).astype(np.uint8))) for k in (1.0, 0.5)]
    (colors, bright), (dimmer, dark) = map(networks.relative_colors, seen)
    assert (colors - dimmer).abs().mean() < 0.06
    np.testing.assert_allclose(bright - dark, np.log(2), atol=0.15)
    np.testing.assert_allclose(colors[:, :, EDGE:-EDGE, EDGE:-EDGE].mean((1, 2, 3)), 0, atol=1e-5)


def test_what_weighs_nothing_is_not_learned_from(torch, networks):
    known = tensors(torch, boxes())
    names = {"color": NONE, "shape": NONE, "weight": 0, "offset": np.nan}
    unknown = known | {name: torch.full_like(known[name], none) for name, none in names.items()}
    values = torch.zeros(len(known["size"]), BOX_VALUES)
    losses, nothing = (networks.BoxNetwork.losses(values, held) for held in (known, unknown))
    assert all(value > 0 for value in losses.values())
    assert all(value == 0 for value in nothing.values())


def test_right_values_have_no_loss(torch, networks):
    held = boxes()
    sure = np.zeros((len(held["size"]), BOX_VALUES), np.float32)
    sure[:, :2] = np.where(held["panel"] > 0, 30, -30)
    sure[:, 2:6] = np.nan_to_num(held["offset"])
    sure[:, 6 + LEARNED_COLORS.index("red")] = sure[
        :, 6 + len(LEARNED_COLORS) + SHAPES.index("rectangle")
    ] = 30
    for value in networks.BoxNetwork.losses(torch.from_numpy(sure), tensors(torch, held)).values():
        assert float(value) == pytest.approx(0, abs=1e-5)


def test_the_file_gives_the_values_of_pytorch(torch, settled, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    with pytest.warns():
        settled.write(tmp_path / "box.onnx", {"sources": "demo: 3 images", "seed": 1})
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
