"""Long training of a network in PyTorch: resumable, with its curve; what it learns from is made in a second process.

A folder holds `checkpoint.pt`, from which the same command goes on, and `curve.csv` (step; losses; seconds a step; of
these, waiting for samples; learning rate). Every checkpoint has averaged weights, so that it can be used whenever the
training is ended.
"""

from __future__ import annotations

import multiprocessing
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.queues import Queue
from pathlib import Path
from queue import Empty, Full
from typing import Any

import cv2
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wayside.pipeline.learning.network_weights import load_weights
from wayside.pipeline.provenance import onnx_metadata

REPORTED, SAVED = 200, 500
"""Steps between lines of the curve and between checkpoints."""

LOOK_EVERY_S = 10.0
"""While one process waits for the other, it looks whether that is alive."""

AVERAGED = 0.999
"""Weight of the past in the average of the weights."""

WAITING = 8
"""Batches that wait for the training, at most."""

Arrays = dict[str, NDArray[Any]]
Make = Callable[[int], Arrays]
"""A batch by its number."""

Losses = Callable[[nn.Module, Arrays, int], dict[str, Tensor]]
"""The losses of a network on a batch, at a step."""


@dataclass(frozen=True, slots=True)
class Descent:
    """How weights follow the gradient.

    rate: largest learning rate; warm_up: steps in which it rises; decay_from: fraction of the steps before it falls;
    largest_gradient: norm at which gradients are cut off.
    """

    rate: float
    weight_decay: float = 0.02
    warm_up: int = 500
    decay_from: float = 0.3
    largest_gradient: float = 10.0

    def rate_at(self, step: int, steps: int) -> float:
        """Rising, constant, then falling to a fiftieth."""
        start = min(1.0, (step + 1) / self.warm_up)
        left = (steps - step) / max(steps * (1 - self.decay_from), 1)
        return self.rate * start * min(1.0, max(left, 0.02))


class Training:
    """A network on its way, with its average."""

    def __init__(self, build: Callable[[], nn.Module], descent: Descent, seed: int) -> None:
        torch.manual_seed(seed)
        self.network = build().to(memory_format=torch.channels_last)
        self.average = build().requires_grad_(False)
        self.average.load_state_dict(self.network.state_dict())
        self.how = descent
        weights = [p for p in self.network.parameters() if p.ndim > 1]
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        self.descent = torch.optim.AdamW(
            [{"params": weights}, {"params": others, "weight_decay": 0.0}],
            lr=descent.rate,
            weight_decay=descent.weight_decay,
        )
        self.step = 0
        self.begun_from = ""

    def learn(self, losses: Losses, batch: Arrays, steps: int) -> dict[str, float]:
        """One step on a batch; its losses."""
        for group in self.descent.param_groups:
            group["lr"] = self.how.rate_at(self.step, steps)
        self.network.train()
        parts = losses(self.network, batch, self.step)
        self.descent.zero_grad(set_to_none=True)
        torch.stack(list(parts.values())).sum().backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.how.largest_gradient)
        self.descent.step()
        self.step += 1
        self._add_to_average()
        return {name: float(value.detach()) for name, value in parts.items()}

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _add_to_average(self) -> None:
        past = min(AVERAGED, (1 + self.step) / (10 + self.step))
        now = self.network.state_dict()
        for name, value in self.average.state_dict().items():
            if value.dtype.is_floating_point:
                value.lerp_(now[name], 1 - past)
            else:
                value.copy_(now[name])

    def begin_from(self, path: Path, *inputs: Tensor) -> None:
        """Begin with the weights of the network in a file, not at random; inputs: what it sees.

        Raises InputError where the file has other layers.
        """
        load_weights(self.network, path, *inputs)
        self.average.load_state_dict(self.network.state_dict())
        earlier = onnx_metadata(path.read_bytes())
        self.begun_from = "; ".join(f"{key}: {earlier[key]}" for key in sorted(earlier))

    def save(self, path: Path) -> None:
        """Write all that is needed to go on; never half a file."""
        state = {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "descent": self.descent.state_dict(),
            "step": self.step,
            "begun_from": self.begun_from,
        }
        torch.save(state, path.with_suffix(".new"))
        path.with_suffix(".new").replace(path)

    def load(self, path: Path) -> None:
        """Go on from a checkpoint."""
        state = torch.load(path, weights_only=True)
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.descent.load_state_dict(state["descent"])
        self.step, self.begun_from = state["step"], state["begun_from"]

    def run(
        self,
        losses: Losses,
        batches: Iterator[Arrays],
        folder: Path,
        steps: int,
    ) -> None:
        """Learn from the batches up to `steps`, with the curve and checkpoints in the folder."""
        totals: defaultdict[str, float] = defaultdict(float)
        reported, since, waited = self.step, time.monotonic(), 0.0
        while self.step < steps:
            before = time.monotonic()
            batch = next(batches)
            waited += time.monotonic() - before
            for name, value in self.learn(losses, batch, steps).items():
                totals[name] += value
            if self.step % REPORTED == 0:
                count, now = self.step - reported, time.monotonic()
                means = [value / count for value in totals.values()]
                cells = [f"{v:.4f}" for v in (*means, (now - since) / count, waited / count)]
                rate = f"{self.how.rate_at(self.step, steps):.2e}"
                with (folder / "curve.csv").open("a", encoding="utf-8") as curve:
                    curve.write(",".join([str(self.step), *cells, rate]) + "\n")
                totals.clear()
                reported, since, waited = self.step, now, 0.0
            if self.step % SAVED == 0:
                self.save(folder / "checkpoint.pt")
        self.save(folder / "checkpoint.pt")


def begun(build: Callable[[], nn.Module], descent: Descent, folder: Path, seed: int) -> Training:
    """A training at its checkpoint in the folder if there is one, else at its beginning."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    training = Training(build, descent, seed)
    checkpoint = folder / "checkpoint.pt"
    if checkpoint.is_file():
        training.load(checkpoint)
    return training


@contextmanager
def produced(maker: Callable[[], Make], first: int) -> Iterator[Iterator[Arrays]]:
    """Batches from number `first` on, made in a second process by what `maker` returns there."""
    context = multiprocessing.get_context("spawn")
    queue: Queue[Arrays] = context.Queue(WAITING)
    process = context.Process(target=_produce, args=(queue, maker, first), daemon=True)
    process.start()

    def batches() -> Iterator[Arrays]:
        while process.is_alive() or not queue.empty():
            try:
                batch = queue.get(timeout=LOOK_EVERY_S)
            except Empty:
                continue
            yield batch
        raise RuntimeError("the process that makes the training batches has died")

    try:
        yield batches()
    finally:
        process.terminate()


def _produce(queue: Queue[Arrays], maker: Callable[[], Make], first: int) -> None:
    cv2.setNumThreads(1)
    make, number = maker(), first
    parent = multiprocessing.parent_process()
    while True:
        batch = make(number)
        while True:
            try:
                queue.put(batch, timeout=LOOK_EVERY_S)
                break
            except Full:
                if parent is not None and not parent.is_alive():
                    queue.cancel_join_thread()  # nobody reads what it still holds
                    return
        number += 1
