"""The training of both networks: the crops that it draws, how it descends, stops and goes on, and what it writes."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from training.detector_images import FRONT, LabelledImage
from training.face_drawings import FaceLibrary
from wayside.pipeline.models.model_files import onnx_metadata
from wayside.pipeline.models.model_folder import shipped_models
from wayside.stages.detection import SIDE

PROPOSING = Path(str(shipped_models() / "network.onnx"))


def image(source, brightness=90):
    rgb = np.full((300, 400, 3), brightness, np.uint8)
    rgb[100:140, 200:240] = (250, 200, 20)
    face = ([200, 100, 240, 140], FRONT, "yellow", "rectangle")
    return LabelledImage.of((source, "one"), rgb, [face])


IMAGES = [image("scenes_mixed/ro"), image("ca_city_garmin", 160)]


@pytest.fixture
def crop_batches(torch):
    from training import crop_batches

    return crop_batches


@pytest.fixture
def batches(crop_batches):
    """So many batches of crops by so many processes, by column."""
    made = crop_batches.CropBatches(IMAGES, FaceLibrary((), ()), PROPOSING, 1)

    def taken(processes, count, first=0):
        found = islice(made.loader(processes, first, pinned=False), count)
        return [{name: values.numpy() for name, values in one.items()} for one in found]

    return taken


def test_a_number_says_which_crops_are_made_however_many_processes_make_them(bits, batches):
    one, two = batches(1, 3), batches(2, 3)
    assert bits(one) == bits(two)
    assert bits(one[0]) != bits(one[1])
    assert bits(batches(2, 1, first=2)[0]) == bits(one[2])


def test_a_crop_has_its_boxes_as_the_detector_draws_them(batches):
    (crops,) = batches(1, 1)
    names = ("count", "of_box_size", "of_box_panel", "of_box_patch")
    for count, size, panel, patch in zip(*(crops[name] for name in names), strict=True):
        assert count > 4
        assert (size[:count] > 0).all()
        assert patch[:count].any(axis=(1, 2, 3)).all()
        for values in (size, panel, patch):
            assert not values[count:].any()
    assert crops["of_box_panel"].max() > 0.9
    assert patch.shape[1:] == (SIDE, SIDE, 3)


def test_of_a_full_buffer_the_oldest_crops_are_replaced(torch, crop_batches):
    held = crop_batches.CropBuffer(torch.device("cpu"), 8)
    held.add({"count": torch.arange(1, 4), "cell": torch.zeros(3, 5, dtype=torch.int64)})
    assert set(held.drawn(200)["count"].tolist()) == {1, 2, 3}  # no more than is there
    for first in range(0, 40, 3):
        number = torch.arange(first, first + 3)
        held.add({"count": number, "cell": number[:, None].expand(-1, 5)})
    drawn = held.drawn(400)
    assert torch.equal(drawn["cell"][:, 4], drawn["count"])
    assert set(drawn["count"].tolist()) == set(range(34, 42))


def test_random_rows_are_below_their_counts(torch, crop_batches):
    rows = crop_batches.random_rows(torch.tensor([0, 1, 5]).repeat(300, 1))
    assert [set(column.tolist()) for column in rows.T] == [{0}, {0}, {0, 1, 2, 3, 4}]


@pytest.fixture
def training(torch, monkeypatch):
    """The training, so small that a step takes no time to speak of."""
    from training import network_training

    small = {"FIRST": 48, "CROPS": 8, "BOXES_EACH": 4, "WARM_UP": 2, "REPORTED": 2}
    for name, value in (small | {"RANGED_CROPS": 16}).items():
        monkeypatch.setattr(network_training, name, value)

    def chosen(_, __, without):
        return [one for one in IMAGES if one.source not in without]

    monkeypatch.setattr(network_training, "training_images", chosen)
    monkeypatch.setattr(network_training, "read_face_library", lambda _: FaceLibrary((), ()))
    return network_training


def options(training, steps, *without):
    return training.TrainingOptions(steps, 1, PROPOSING, 1, "cpu", without)


def test_the_learning_rate_rises_stays_and_falls(torch):
    from training.network_training import rate_at

    rates = [rate_at(step, 10000) for step in (0, 250, 600, 2400, 8000, 9999)]
    assert rates[0] < rates[1] < rates[2] == rates[3] == 1 > rates[4] > rates[5] > 0


def test_losses_fall_and_the_average_follows_the_weights(torch, crop_batches, training, tmp_path):
    made = crop_batches.CropBatches(IMAGES, FaceLibrary((), ()), PROPOSING, 1)
    learns = training.Training(made, options(training, 1000), tmp_path)
    learns.take_until(64)
    learns.step = 20
    learner = learns.learners["box"]
    before = learner.average.out.weight.clone()
    losses = []
    for _ in range(60):
        learns.losses.zero_()
        learns.learn()
        losses.append(learns.losses.clone())
    first, last = (torch.stack(part).mean(0) for part in (losses[:5], losses[-10:]))
    heat, box, panel = (last[k] / first[k] for k in (0, 1, 4))
    assert heat < 0.7
    assert box < 0.9
    assert panel < 0.7
    now, average = learner.network.out.weight, learner.average.out.weight
    assert 0 < (average - now).norm() < (average - before).norm()


def test_steps_are_no_longer_than_the_largest_gradient_allows(torch, training):
    from training.networks import BoxNetwork

    learner = training.Learner(BoxNetwork, 5.0, torch.device("cpu"))
    values = learner.network(torch.zeros(4, 48, 48, 3), torch.ones(4, 2))
    learner.learn({"steep": 1e6 * values.sum()}, 1e-3, 0.5)
    norms = [w.grad.norm() for w in learner.network.parameters() if w.grad is not None]
    assert torch.stack(norms).norm() == pytest.approx(5, rel=1e-3)


def test_a_training_writes_networks_with_their_provenance_and_can_be_taken_up(training, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    for wanted in (1, 3):
        with pytest.warns():
            training.learn_networks(
                None, tmp_path, tmp_path, options(training, wanted, "ca_city_garmin")
            )
        for name in ("network.onnx", "box.onnx"):
            said = onnx_metadata((tmp_path / name).read_bytes())
            assert said["steps"] == str(wanted)
            assert (
                said["sources"]
                == "scenes_mixed/ro: 1 images, 1 faces, CC0 1.0 (as published elsewhere), "
                "pictures 0-156 left out"
            )
            assert "7 bits" in said["weights"]
    networks = {"network.onnx", "float.onnx", "box.onnx", "box_float.onnx"}
    assert {one.name for one in tmp_path.iterdir()} == networks | {"checkpoint.pt", "curve.csv"}
    (line,) = (tmp_path / "curve.csv").read_text().splitlines()
    assert line.startswith("2,")
    assert len(line.split(",")) == 1 + 8 + 3


def test_the_same_seed_learns_the_same(torch, training, tmp_path):
    pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    for name in ("one", "same"):
        with pytest.warns():
            training.learn_networks(None, tmp_path, tmp_path / name, options(training, 2))
    one, same = ((tmp_path / name / "network.onnx").read_bytes() for name in ("one", "same"))
    assert one == same
