"""The training of both networks: the crops that it draws, how it descends, stops and goes on, and what it writes."""

from pathlib import Path

import numpy as np
import pytest

from wayside.pipeline.learning import crop_processes
from wayside.pipeline.learning.crop_processes import COLUMNS, TOGETHER, TrainingSet, crops_made
from wayside.pipeline.learning.detector_crops import CROP_PX
from wayside.pipeline.learning.detector_images import FRONT, labelled_image
from wayside.pipeline.learning.face_drawings import FaceLibrary
from wayside.pipeline.model_files import shipped_models
from wayside.pipeline.provenance import onnx_metadata
from wayside.schemas.errors import InputError
from wayside.stages.detection import drawn_patches
from wayside.stages.imaging import pyramid

PROPOSING = Path(str(shipped_models() / "network.onnx"))


def image(source, brightness=90):
    rgb = np.full((300, 400, 3), brightness, np.uint8)
    rgb[100:140, 200:240] = (250, 200, 20)
    face = ([200, 100, 240, 140], FRONT, "yellow", "rectangle")
    return labelled_image(
        source, "one", rgb, [face], (), fronts_complete=True, backs_complete=False
    )


IMAGES = [image("scenes_mixed/ro"), image("ca_city_garmin", 160)]
TRAINING_SET = TrainingSet(IMAGES, np.array([False, True]), FaceLibrary((), ()))


def batches(processes, count, first=0):
    """So many batches of crops, copied, by column."""
    made = []
    with crops_made(TRAINING_SET, PROPOSING, processes, 1, first) as source:
        for _ in range(count):
            process, slot = source.taken()
            made.append({n: v[slot].copy() for n, v in source.columns[process].items()})
            source.free(process, slot)
    return made


def test_a_number_says_which_crops_are_made_however_many_processes_make_them(bits):
    one, two = batches(1, 3), batches(2, 3)
    assert bits(one) == bits(two)
    assert bits(one[0]) != bits(one[1])
    assert bits(batches(2, 1, first=2)[0]) == bits(one[2])


def test_a_crop_has_its_boxes_and_says_whether_it_is_held_out():
    (crops,) = batches(1, 1)
    assert {name: (v.dtype, v.shape[1:]) for name, v in crops.items()} == {
        name: (np.dtype(kind), shape) for name, (kind, shape) in COLUMNS.items()
    }
    assert 0 < crops["held_out"].sum() < TOGETHER
    for count, boxes, panel in zip(crops["count"], crops["boxes"], crops["panel"], strict=True):
        assert count > 4
        assert (boxes[:count, 2:] > boxes[:count, :2]).all()
        assert not boxes[count:].any()
        assert not panel[count:].any()
    assert crops["panel"].max() > 0.9


def test_the_end_of_a_process_ends_the_training(monkeypatch):
    monkeypatch.setattr(crop_processes, "LOOK_EVERY_S", 0.05)
    with crops_made(TRAINING_SET, Path("absent.onnx"), 1, 1) as source:
        with pytest.raises(RuntimeError, match="has died"):
            source.taken()


@pytest.fixture
def crop_buffer(torch):
    from wayside.pipeline.learning import crop_buffer

    return crop_buffer


def numbered(torch, first, count):
    """Crops whose every column says their number."""
    return {
        name: torch.arange(first, first + count)
        .reshape(-1, *(1 for _ in shape))
        .expand(count, *shape)
        .to(torch.from_numpy(np.zeros(1, kind)).dtype)
        for name, (kind, shape) in COLUMNS.items()
        if name != "held_out"
    }


def test_of_a_full_buffer_the_oldest_crops_are_replaced(torch, crop_buffer):
    held = crop_buffer.CropBuffer(torch.device("cpu"), (8, 4))
    for first in range(0, 40, 4):
        held.add(numbered(torch, first, 4), np.array([False, True, False, False]))
    drawn = held.drawn(0.5, 400)
    for name in ("cell", "box_color"):
        assert torch.equal(drawn[name][:, 0].long(), drawn["count"].long())
    numbers = set(drawn["count"].tolist())
    assert {n for n in numbers if n % 4 == 1} == {25, 29, 33, 37}  # held out, the last four
    assert {n for n in numbers if n % 4 != 1} == {30, 31, 32, 34, 35, 36, 38, 39}


def test_of_images_held_out_only_their_share_is_drawn(torch, crop_buffer):
    held = crop_buffer.CropBuffer(torch.device("cpu"), (8, 4))
    held.add(numbered(torch, 0, 6), np.array([False, True, False, True, False, False]))
    assert set(held.drawn(0.0, 200)["count"].tolist()) == {0, 2, 4, 5}
    share = np.isin(held.drawn(0.25, 4000)["count"].numpy(), (1, 3)).mean()
    assert share == pytest.approx(0.25, abs=0.05)


def test_random_rows_are_below_their_counts(torch, crop_buffer):
    rows = crop_buffer.random_rows(torch.tensor([0, 1, 5]).repeat(300, 1))
    assert [set(column.tolist()) for column in rows.T] == [{0}, {0}, {0, 1, 2, 3, 4}]


def test_patches_are_those_that_the_detector_draws(torch, crop_buffer):
    rng = np.random.default_rng(2)
    rgb = rng.integers(0, 256, (2, CROP_PX, CROP_PX, 3)).astype(np.uint8)
    middle = rng.uniform(0, CROP_PX, (2, 40, 2))
    size = np.exp(rng.uniform(np.log(6), np.log(220), (2, 40, 2)))
    box = np.concatenate([middle - size / 2, middle + size / 2], 2).clip(0, CROP_PX)
    box = box.astype(np.float32)
    found = crop_buffer.patches_of(torch.from_numpy(rgb), torch.from_numpy(box)).numpy()
    for k in range(2):
        expected = drawn_patches(pyramid(rgb[k]), box[k]).astype(float)
        assert np.abs(found[k] - expected).max() <= 2  # its weights are whole 256ths
        assert np.abs(found[k] - expected).mean() < 0.2


@pytest.fixture
def learners(torch):
    from wayside.pipeline.learning import network_learners

    return network_learners


@pytest.fixture
def training(torch, monkeypatch):
    """The training, so small that a step takes no time to speak of."""
    from wayside.pipeline.learning import network_learners, network_training

    small = {"FIRST": 48, "CROPS": 8, "BOXES_EACH": 4, "KEPT": (64, 32)}
    small |= {"WARM_UP": 2, "REPORTED": 2, "BEGUN_BY": 8, "RANGED_CROPS": 16}
    for name, value in small.items():
        for module in (network_learners, network_training):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(network_training, "training_images", lambda *_: [IMAGES[0]])
    monkeypatch.setattr(
        network_training, "held_out_images", lambda _, names: IMAGES[1:][: len(names)]
    )
    monkeypatch.setattr(network_training, "read_face_library", lambda _: FaceLibrary((), ()))
    return network_training


def options(training, steps, **further):
    return training.TrainingOptions(steps, 1, PROPOSING, 1, "cpu", **further)


def test_the_learning_rate_rises_stays_and_falls(torch):
    from wayside.pipeline.learning.network_learners import rate_at

    rates = [rate_at(step, 10000) for step in (0, 250, 600, 2400, 8000, 9999)]
    assert rates[0] < rates[1] < rates[2] == rates[3] == 1 > rates[4] > rates[5] > 0


@pytest.mark.slow
def test_the_losses_fall_and_the_average_follows_the_weights(torch, learners, training):
    buffer = training.CropBuffer(torch.device("cpu"), (64, 32))
    crops = batches(1, 4)
    for one in crops:
        held_out = np.zeros_like(one.pop("held_out"))
        buffer.add({name: torch.from_numpy(values) for name, values in one.items()}, held_out)
    torch.manual_seed(1)
    pair = learners.Pair(0.0, buffer, torch.device("cpu"))
    pair.record()
    before = pair.learners["box"].average.out.weight.clone()
    losses = []
    for step in range(60):
        pair.losses.zero_()
        pair.step(20 + step, 1000)
        losses.append(pair.losses.clone())
    first, last = (torch.stack(part).mean(0) for part in (losses[:5], losses[-10:]))
    heat, box, panel = (last[k] / first[k] for k in (0, 1, 4))
    assert heat < 0.7
    assert box < 0.9
    assert panel < 0.7
    learner = pair.learners["box"]
    now, average = learner.network.out.weight, learner.average.out.weight
    assert 0 < (average - now).norm() < (average - before).norm()


def test_steps_are_no_longer_than_the_largest_gradient_allows(torch, learners):
    learner = learners.Learner(learners.KINDS["box"], torch.device("cpu"))
    values = learner.network(torch.zeros(4, 48, 48, 3), torch.ones(4, 2))
    learner.learn({"steep": 1e6 * values.sum()}, torch.tensor(0.5))
    norms = [w.grad.norm() for w in learner.network.parameters() if w.grad is not None]
    largest = learners.KINDS["box"].largest_gradient
    assert torch.stack(norms).norm() == pytest.approx(largest, rel=1e-3)


def test_a_training_writes_networks_with_their_provenance_and_can_be_taken_up(
    training, tmp_path: Path
):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    for wanted in (1, 3):
        with pytest.warns():
            training.learn_networks(
                None, tmp_path, tmp_path, options(training, wanted, without=("ca_city_garmin",))
            )
        for name in ("network.onnx", "box.onnx"):
            said = onnx_metadata((tmp_path / name).read_bytes())
            assert said["steps"] == str(wanted)
            assert "ca_city_garmin: 1 images, 1 faces, MIT" in said["sources"]
            assert "7 bits" in said["weights"]
            beside = onnx_metadata((tmp_path / "without" / name).read_bytes())
            assert "ca_city_garmin" not in beside["sources"]
    networks = {"network.onnx", "float.onnx", "box.onnx", "box_float.onnx"}
    assert {path.name for path in (tmp_path / "without").iterdir()} == networks
    rest = {"without", "checkpoint.pt", "curve.csv"}
    assert {path.name for path in tmp_path.iterdir()} == networks | rest
    (line,) = (tmp_path / "curve.csv").read_text().splitlines()
    assert line.startswith("2,")
    assert len(line.split(",")) == 1 + 2 * 8 + 3


def test_the_same_seed_learns_the_same(torch, training, tmp_path: Path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    for name in ("one", "same"):
        with pytest.warns():
            training.learn_networks(None, tmp_path, tmp_path / name, options(training, 2))
    one, same = ((tmp_path / name / "network.onnx").read_bytes() for name in ("one", "same"))
    assert one == same


def assert_refused(training, folder: Path, match: str, **given):
    with pytest.raises(InputError, match=match):
        training.learn_networks(None, folder, folder / "refused", options(training, 1, **given))


def test_a_training_begins_from_networks_of_the_same_layers_and_says_so(training, tmp_path: Path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    shipped = Path(str(shipped_models()))
    with pytest.warns():
        training.learn_networks(
            None, tmp_path, tmp_path / "begun", options(training, 1, begin_from=shipped)
        )
    said = onnx_metadata((tmp_path / "begun" / "box.onnx").read_bytes())
    assert "scenes_mixed" in said["begun from"]
    (tmp_path / "other").mkdir()
    for name in ("network.onnx", "box.onnx"):
        (tmp_path / "other" / name).write_bytes((shipped / "network.onnx").read_bytes())
    assert_refused(training, tmp_path, r"box\.onnx", begin_from=tmp_path / "other")


def test_networks_to_begin_from_are_there_and_have_not_seen_what_is_held_out(
    training, tmp_path: Path
):
    shipped = Path(str(shipped_models()))
    seen = r"have not learned from ca_city_garmin, found network\.onnx"
    assert_refused(training, tmp_path, seen, begin_from=shipped, without=("ca_city_garmin",))
    assert not (tmp_path / "refused").exists()
    (tmp_path / "empty").mkdir()
    none = r"wanted network\.onnx to begin from, found none"
    assert_refused(training, tmp_path, none, begin_from=tmp_path / "empty")
