"""The box network learns, goes on from a checkpoint, and gives the same values as a file."""

from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayside.pipeline.learning.detector_images import FRONT, labelled_image
from wayside.pipeline.learning.face_drawings import FaceLibrary
from wayside.pipeline.model_files import shipped_models
from wayside.pipeline.onnx_header import read_onnx_header
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.errors import InputError
from wayside.stages.detection import BOX_VALUES, SIDE, drawn_patches
from wayside.stages.detection import BoxNetwork as InOnnxRuntime
from wayside.stages.imaging import pyramid


@pytest.fixture
def network(torch):
    from wayside.pipeline.learning import box_network

    return box_network


@pytest.fixture
def training(torch):
    from wayside.pipeline.learning import box_training

    return box_training


def batch(count=32, seed=0):
    """Every second patch shows a red square, the others nothing."""
    random = np.random.default_rng(seed)
    face = np.arange(count) % 2 == 0
    patch = random.integers(80, 140, (count, SIDE, SIDE, 3)).astype(np.uint8)
    patch[face, 6:26, 6:26] = (200, 40, 40)
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
    middle = colors[:, 0, 6:26, 6:26].mean((1, 2))
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


@pytest.mark.slow
def test_the_losses_of_a_batch_fall(network, training):
    from wayside.pipeline.learning.network_training import Training

    learner = Training(network.BoxNetwork, training.DESCENT, 1)
    first = learner.learn(training.batch_losses, batch(), 100000)
    for _ in range(25):
        learner.step += 20  # past the slow start
        last = learner.learn(training.batch_losses, batch(), 100000)
    assert first.keys() == {"panel", "offset", "color", "shape"}
    for name in ("panel", "color", "shape"):
        assert last[name] < 0.5 * first[name]


def numbered(first, count):
    numbers = np.arange(first, first + count)
    return {"patch": numbers * 1.0, "color": numbers, "shape": -numbers}


def test_batches_draw_whole_rows_and_take_new_boxes_as_fast_as_they_are_learned_from(training):
    taken = []

    def made():
        while True:
            taken.append(100)
            yield numbered(sum(taken[:-1]), 100)

    batches = training.batches_of(made(), 1, 0)
    for number in range(1, 13):
        drawn = next(batches)
        assert {len(column) for column in drawn.values()} == {training.BATCH}
        np.testing.assert_array_equal(drawn["patch"], drawn["color"])
        np.testing.assert_array_equal(drawn["shape"], -drawn["color"])
        assert abs(sum(taken) - number * training.BATCH) <= training.BATCH
    assert len(np.unique(drawn["color"])) > training.BATCH / 2


def test_of_a_full_pool_the_oldest_boxes_are_replaced(training, monkeypatch):
    monkeypatch.setattr(training, "POOL", 1000)
    made = (numbered(100 * k, 100) for k in range(10**6))
    batches = training.batches_of(made, 1, 0)
    for _ in range(40):
        drawn = next(batches)
    taken = next(made)["color"][0]
    assert drawn["color"].min() >= taken - 1100
    assert drawn["color"].max() < taken


def test_the_same_seed_and_step_draw_the_same_batches(training):
    def first(seed, step):
        made = (numbered(500 * k, 500) for k in range(9))
        return next(training.batches_of(made, seed, step))["color"]

    np.testing.assert_array_equal(first(1, 5), first(1, 5))
    assert (first(1, 5) != first(1, 6)).any()
    assert (first(1, 5) != first(2, 5)).any()


def test_the_file_gives_the_values_of_pytorch(torch, network, settled, tmp_path: Path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    with pytest.warns():
        network.export(settled, tmp_path / "box.onnx", {"sources": "demo: 3 images", "seed": 1})
    values = values_of(torch, settled, shown())
    found = InOnnxRuntime(str(tmp_path / "box.onnx")).scores(*scene())
    close = {"rtol": 1e-4, "atol": 1e-4}
    np.testing.assert_allclose(found.front, values[:, 0], **close)
    np.testing.assert_allclose(found.back, values[:, 1], **close)
    np.testing.assert_allclose(found.offset, values[:, 2:6], **close)
    colors, shapes = torch.log_softmax(values[:, 6:14], 1), torch.log_softmax(values[:, 14:], 1)
    np.testing.assert_allclose(found.color, colors, **close)
    np.testing.assert_allclose(found.shape, shapes, **close)
    said = read_onnx_header((tmp_path / "box.onnx").read_bytes()).metadata
    assert said == {"sources": "demo: 3 images", "seed": "1"}


def test_the_file_in_whole_numbers_gives_nearly_the_same_values(network, settled, tmp_path: Path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    from wayside.pipeline.learning.quantization import quantize_boxes

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
    said = read_onnx_header(other.read_bytes()).metadata
    assert said["sources"] == "demo: 3 images"
    assert "7 bits" in said["weights"]


@pytest.fixture
def made_up(training, monkeypatch):
    """A training on made-up boxes, without a second process; the numbers of the first boxes that it asked for."""
    asked = []

    @contextmanager
    def produced(maker, first):
        asked.append(first)
        yield (batch(300, seed) for seed in range(first, first + 99))

    monkeypatch.setattr(training, "produced", produced)
    monkeypatch.setattr(training, "RANGED", 2)
    monkeypatch.setattr(training, "BATCH", 32)
    monkeypatch.setattr(training, "training_images", lambda drives, real, without: [image()])
    monkeypatch.setattr(training, "read_face_library", lambda real: FaceLibrary((), ()))
    return asked


def image():
    rgb = np.full((300, 400, 3), 90, np.uint8)
    rgb[100:140, 200:240] = (250, 200, 20)
    face = ([200, 100, 240, 140], FRONT, "yellow", "rectangle")
    return labelled_image(
        "ca_city_garmin", "one", rgb, [face], (), fronts_complete=True, backs_complete=False
    )


def test_a_training_writes_both_networks_with_their_provenance_and_can_be_taken_up(
    training, made_up, tmp_path: Path
):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    steps = []
    for wanted in (1, 3):
        with pytest.warns():
            training.learn_box_network(None, tmp_path, tmp_path, wanted, 1, tmp_path)
        said = read_onnx_header((tmp_path / "box.onnx").read_bytes()).metadata
        steps.append(said["steps"])
    assert steps == ["1", "3"]
    assert made_up == [0, 1]
    assert said["sources"] == "ca_city_garmin: 1 images, 1 faces, MIT"
    assert "7 bits" in said["weights"]
    names = {"box.onnx", "box_float.onnx", "checkpoint.pt"}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_a_network_begun_from_a_file_says_what_the_file_says(
    torch, network, settled, tmp_path: Path
):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    from wayside.pipeline.learning.network_weights import load_weights

    with pytest.warns():
        network.export(settled, tmp_path / "box.onnx", {})
    begun = network.BoxNetwork()
    before = values_of(torch, begun, shown())
    load_weights(
        begun, tmp_path / "box.onnx", *(torch.from_numpy(v) for v in list(shown(2).values()))
    )
    expected = values_of(torch, settled, shown())
    torch.testing.assert_close(values_of(torch, begun, shown()), expected, rtol=1e-3, atol=1e-3)
    assert not torch.allclose(before, expected, atol=0.1)


def test_a_training_begins_from_a_network_of_the_same_layers_and_says_so(
    training, made_up, tmp_path: Path
):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    shipped = Path(str(shipped_models()))
    for name in ("begun", "refused"):
        (tmp_path / name).mkdir()
    with pytest.warns():
        training.learn_box_network(
            None, tmp_path, tmp_path / "begun", 1, 1, tmp_path, shipped / "box.onnx"
        )
    said = read_onnx_header((tmp_path / "begun" / "box.onnx").read_bytes()).metadata
    assert "scenes_mixed" in said["begun from"]
    with pytest.raises(InputError, match=r"network\.onnx"):
        training.learn_box_network(
            None, tmp_path, tmp_path / "refused", 1, 1, tmp_path, shipped / "network.onnx"
        )


def test_a_number_says_which_boxes_are_made(training, made_up, monkeypatch, tmp_path: Path, bits):
    monkeypatch.setattr(training, "CROPS", 2)
    proposing = Path(str(shipped_models() / "network.onnx"))
    make, again = (training.sample_maker(None, tmp_path, (), proposing, 1) for _ in range(2))
    first = make(0)
    assert bits(list(first.values())) == bits(list(again(0).values()))
    assert bits(list(first.values())) != bits(list(make(1).values()))
    assert first["panel"][:, FRONT].max() > 0.9
    assert len(first["patch"]) == len(first["color"]) > 4
