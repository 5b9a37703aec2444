"""The training that both networks share: how it descends, stops, and goes on as if it had not stopped."""

from functools import partial
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def module(torch):
    from wayside.pipeline.learning import network_training

    return network_training


@pytest.fixture
def small(torch):
    """A network of two layers, to be built."""
    nn = torch.nn
    return lambda: nn.Sequential(
        nn.Linear(3, 8), nn.BatchNorm1d(8), nn.Dropout(0.0), nn.Linear(8, 1)
    )


@pytest.fixture
def losses(torch):
    """How far a network is from the sum of its inputs."""

    def compute(network, batch, step):
        values = network(torch.from_numpy(batch["x"]))[:, 0]
        return {"sum": ((values - torch.from_numpy(batch["x"]).sum(1)) ** 2).mean()}

    return compute


@pytest.fixture
def training(module, small):
    return lambda seed=1, **how: module.Training(small, module.Descent(0.02, **how), seed)


def batch(seed=0):
    return {"x": np.random.default_rng(seed).normal(0, 1, (32, 3)).astype(np.float32)}


def test_the_learning_rate_rises_stays_and_falls(module):
    how = module.Descent(1.5e-3)
    rates = [how.rate_at(step, 10000) for step in (0, 250, 600, 2900, 8000, 9999)]
    assert rates[0] < rates[1] < rates[2] == rates[3] > rates[4] > rates[5] > 0
    assert max(rates) == how.rate


def test_the_loss_falls(training, losses):
    learner = training(warm_up=5)
    first = learner.learn(losses, batch(), 1000)["sum"]
    for _ in range(60):
        last = learner.learn(losses, batch(), 1000)["sum"]
    assert last < 0.3 * first


def test_the_average_follows_the_weights(torch, training, losses):
    learner = training(warm_up=1)
    before = learner.average[0].weight.clone()
    for _ in range(20):
        learner.learn(losses, batch(), 1000)
    now, average = learner.network[0].weight, learner.average[0].weight
    assert 0 < (average - now).norm() < (average - before).norm()
    assert not average.requires_grad


def test_the_same_seed_begins_with_the_same_weights(torch, training):
    one, same, other = (training(seed).network[0].weight for seed in (1, 1, 2))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_training_goes_on_from_a_checkpoint_as_if_it_had_not_stopped(
    torch, training, losses, tmp_path: Path
):
    whole = training()
    for k in range(8):
        whole.learn(losses, batch(k), 10)
    half = training()
    for k in range(4):
        half.learn(losses, batch(k), 10)
    half.save(tmp_path / "checkpoint.pt")
    resumed = training(2)
    resumed.load(tmp_path / "checkpoint.pt")
    for k in range(4, 8):
        resumed.learn(losses, batch(k), 10)
    assert resumed.step == 8
    for one, other in zip(
        whole.average.state_dict().values(), resumed.average.state_dict().values(), strict=True
    ):
        torch.testing.assert_close(one, other)


def test_a_run_ends_at_its_steps_and_the_next_goes_on_from_there(
    module, small, losses, tmp_path: Path, monkeypatch
):
    monkeypatch.setattr(module, "REPORTED", 2)
    taken = []

    def batches():
        for k in range(99):
            taken.append(k)
            yield batch(k)

    for steps in (4, 7):
        learner = module.begun(small, module.Descent(0.02), tmp_path / "out", 1)
        began = learner.step
        learner.run(losses, batches(), tmp_path / "out", steps)
        assert learner.step == steps
    assert began == 4
    assert taken == [0, 1, 2, 3, 0, 1, 2]
    curve = [line.split(",") for line in (tmp_path / "out" / "curve.csv").read_text().splitlines()]
    assert [line[0] for line in curve] == ["2", "4", "6"]
    assert {len(line) for line in curve} == {5}  # step, loss, seconds, waiting, learning rate
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "checkpoint.pt",
        "curve.csv",
    ]


def test_a_finished_training_stays_as_it_is(module, small, losses, tmp_path: Path):
    module.begun(small, module.Descent(0.02), tmp_path, 1).run(losses, repeat(batch()), tmp_path, 3)
    learner = module.begun(small, module.Descent(0.02), tmp_path, 1)
    learner.run(losses, iter(()), tmp_path, 3)
    assert learner.step == 3


def test_steps_are_no_longer_than_the_largest_gradient_allows(torch, training):
    learner = training(largest_gradient=0.5)

    def steep(network, _, __):
        return {"sum": 1e6 * network(torch.ones(4, 3)).sum()}

    learner.learn(steep, {}, 10)
    norms = [weight.grad.norm() for weight in learner.network.parameters()]
    assert torch.stack(norms).norm() == pytest.approx(0.5, rel=1e-3)


@pytest.mark.slow
def test_batches_are_made_in_order_by_a_second_process(module):
    made = [{"number": np.array(k)} for k in range(40)]
    with module.produced(partial(getattr, made, "__getitem__"), 3) as batches:
        assert [int(next(batches)["number"]) for _ in range(5)] == [3, 4, 5, 6, 7]


@pytest.mark.slow
def test_the_end_of_the_second_process_ends_the_training(module, monkeypatch):
    monkeypatch.setattr(module, "LOOK_EVERY_S", 0.1)
    one = [{"number": np.array(0)}]
    with module.produced(partial(getattr, one, "__getitem__"), 0) as batches:
        assert int(next(batches)["number"]) == 0
        with pytest.raises(RuntimeError, match="has died"):
            next(batches)
