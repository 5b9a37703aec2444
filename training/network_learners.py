"""What learns in the training of the networks: a detection network and a box network on the crops in a buffer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from wayside.pipeline.learning import box_network, detector_network
from wayside.pipeline.learning.crop_buffer import CropBuffer, patches_of, random_rows
from wayside.pipeline.learning.detector_network import Batch
from wayside.pipeline.learning.network_weights import load_weights

CROPS, BOXES_EACH = 128, 10
"""Crops of a step, and boxes of each of these."""

WARM_UP, CONSTANT, LAST, WEIGHT_DECAY = 400, 0.25, 0.01, 0.03
"""Steps in which the learning rate rises; fraction of the steps in which it stays, and of the rate at which it ends."""

SURE_FROM = 600
"""Steps from which a network may doubt that a cell off the boxes of an incomplete image is a negative."""

AVERAGED = 0.999
"""Weight of the past in the average of the weights."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One of the two networks: how it is built, its largest learning rate, the largest norm of its gradient."""

    build: Callable[[], nn.Module]
    rate: float
    largest_gradient: float


KINDS = {
    "network": Kind(detector_network.DetectionNetwork, 2.5e-3, 10.0),
    "box": Kind(box_network.BoxNetwork, 2.5e-3, 5.0),
}


def rate_at(step: int, steps: int) -> float:
    """The learning rate as a fraction of the largest: rising, constant, then falling."""
    left = (steps - step) / max(steps * (1 - CONSTANT), 1)
    return min(1.0, (step + 1) / WARM_UP) * min(1.0, max(left, LAST))


class Learner:
    """A network in training, its optimizer, and the moving average of its weights."""

    def __init__(self, kind: Kind, device: torch.device) -> None:
        self.kind = kind
        self.network = kind.build().to(device, memory_format=torch.channels_last).train()
        self.average = kind.build().to(device).requires_grad_(False).eval()
        self.average.load_state_dict(self.network.state_dict())
        weights = [p for p in self.network.parameters() if p.ndim > 1]
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        self.rate = torch.zeros((), device=device)
        on_accelerator = device.type == "cuda"
        self.optimizer = torch.optim.AdamW(
            [{"params": weights}, {"params": others, "weight_decay": 0.0}],
            lr=self.rate,
            weight_decay=WEIGHT_DECAY,
            capturable=on_accelerator,
            fused=on_accelerator,
            foreach=False,
        )

    def learn(self, losses: Mapping[str, Tensor], new: Tensor) -> Tensor:
        """One step of the optimizer on the sum of the losses; new: weight of the new weights in the average.

        The losses, stacked.
        """
        parts = torch.stack([value.float() for value in losses.values()])
        parts.sum().backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self.kind.largest_gradient)
        self.optimizer.step()
        now = self.network.state_dict()
        with torch.no_grad():
            for name, past in self.average.state_dict().items():
                if past.dtype.is_floating_point:
                    past.add_((now[name] - past) * new)
        return parts.detach()

    def begin_from(self, path: Path, *inputs: Tensor) -> None:
        """Begin with the weights of a file, not at random; inputs: what the network sees.

        Raises InputError where the file has other layers.
        """
        begun = self.kind.build()
        load_weights(begun, path, *inputs)
        for network in (self.network, self.average):
            network.load_state_dict(begun.state_dict())

    def state(self) -> dict[str, Any]:
        """All that is needed to go on."""
        return {
            name: getattr(self, name).state_dict() for name in ("network", "average", "optimizer")
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""
        for name, held in state.items():
            getattr(self, name).load_state_dict(held)
        for group in self.optimizer.param_groups:
            group["lr"] = self.rate


class Pair:
    """A detection network and a box network that learn from the same crops, a share of them from images held out."""

    def __init__(self, share_held_out: float, buffer: CropBuffer, device: torch.device) -> None:
        self.share, self.buffer, self.device = share_held_out, buffer, device
        self.learners = {name: Learner(kind, device) for name, kind in KINDS.items()}
        self.sure = torch.zeros((), device=device)
        self.new = torch.ones((), device=device)
        self.losses = torch.zeros(8, device=device)
        self._again: Callable[[], None] = self._step

    def record(self) -> None:
        """On an accelerator, record one step as a graph: to start its operations one by one takes longer than they do.

        Nothing is learned from the steps that this takes.
        """
        if self.device.type != "cuda":
            return
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        before = [
            {name: value.clone() for name, value in network.state_dict().items()}
            for one in self.learners.values()
            for network in (one.network, one.average)
        ]
        with torch.cuda.stream(stream):
            for _ in range(3):
                self._step()
        torch.cuda.synchronize()
        for one in self.learners.values():
            one.optimizer.zero_grad(set_to_none=True)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._step()
        held = iter(before)
        for one in self.learners.values():
            for network in (one.network, one.average):
                network.load_state_dict(next(held))
        self.losses.zero_()
        self._again = graph.replay

    def step(self, step: int, steps: int) -> None:
        """Step number `step` of so many."""
        for one in self.learners.values():
            one.rate.fill_(one.kind.rate * rate_at(step, steps))
        self.sure.fill_(float(step >= SURE_FROM))
        self.new.fill_(1 - min(AVERAGED, (1 + step) / (10 + step)))
        self._again()

    def _step(self) -> None:
        crops = self.buffer.drawn(self.share, CROPS)
        for one in self.learners.values():
            one.optimizer.zero_grad(set_to_none=True)
        each = self._losses(crops)
        parts = [one.learn(each[name], self.new) for name, one in self.learners.items()]
        self.losses.add_(torch.cat(parts))

    def _losses(self, crops: Mapping[str, Tensor]) -> dict[str, dict[str, Tensor]]:
        """The losses of both networks on crops."""
        batch = Batch(
            crops["rgb"],
            crops["heat"].float(),
            crops["doubt"],
            crops["cell"].long(),
            crops["box"],
            crops["weight"],
            crops["color"],
            crops["shape"],
        )
        boxes = boxes_of(crops)
        # what is cast is not kept: a recorded graph would not cast it again
        with torch.autocast(self.device.type, torch.bfloat16, cache_enabled=False):
            maps = self.learners["network"].network(batch.rgb)
            values = self.learners["box"].network(boxes["patch"], boxes["size"])
        return {
            "network": detector_network.losses(maps.float(), batch, self.sure),
            "box": box_network.losses(values.float(), boxes),
        }


def boxes_of(crops: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """`BOXES_EACH` boxes of each crop, drawn at random, with their patches and targets, row by row."""
    names = {
        "boxes": "box",
        "panel": "panel",
        "panel_weight": "weight",
        "offset": "offset",
        "box_color": "color",
        "box_shape": "shape",
    }
    row = random_rows(crops["count"][:, None].expand(-1, BOXES_EACH))
    which = torch.arange(len(row), device=row.device)[:, None]
    drawn = {name: crops[column][which, row] for column, name in names.items()}
    patch = patches_of(crops["rgb"], drawn["box"])
    found = {name: values.flatten(0, 1) for name, values in drawn.items()}
    size = (found["box"][:, 2:] - found["box"][:, :2]).clamp(min=1)
    return found | {"patch": patch.flatten(0, 1), "size": size}
