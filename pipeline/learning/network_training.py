"""Training of the detection network and the box network, on the processor or on an accelerator.

    python -m wayside.pipeline.learn --drives FOLDER --real FOLDER -o FOLDER --network-steps N

Processes make crops; the last of them stay in the memory of the device, and each step draws from there: the detection
network learns from the crops, the box network from boxes in them. Networks that see nothing of some sources learn from
the same crops beside, so that they can be measured on those.

The folder holds `checkpoint.pt`, from which the same command goes on, and `curve.csv`. Weights are averaged over the
last steps, so that a training can be ended whenever one likes.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from wayside.pipeline.learning import box_network, detector_network
from wayside.pipeline.learning.crop_memory import CropMemory, patches_of, random_rows
from wayside.pipeline.learning.crop_processes import (
    COLUMNS,
    TOGETHER,
    Columns,
    CropProcesses,
    Subject,
    crops_made,
)
from wayside.pipeline.learning.detector_images import LabelledImage
from wayside.pipeline.learning.detector_network import Batch
from wayside.pipeline.learning.face_drawings import FaceLibrary, read_face_library
from wayside.pipeline.learning.network_weights import load_weights
from wayside.pipeline.learning.quantization import quantize, quantize_boxes
from wayside.pipeline.learning.training_images import (
    drawing_probability,
    held_out_images,
    provenance,
    training_images,
)
from wayside.pipeline.provenance import onnx_metadata
from wayside.stages.detection import drawn_patches
from wayside.stages.imaging import pyramid

CROPS, BOXES_EACH = 128, 10
"""Crops of a step, and boxes of each of these."""

USES = 5
"""How often a crop is drawn, on average: to make one takes a core longer than an accelerator learns from it."""

KEPT, KEPT_SHARE = (8_000, 1_600), 0.6
"""Crops of 0.23 MB that are kept by a processor: of all images but those held out, and of those. An accelerator keeps
as many times these as fill this fraction of its free memory."""

FIRST = 4_096
"""Crops that are there when the training begins."""

WARM_UP, CONSTANT, LAST, WEIGHT_DECAY = 400, 0.25, 0.01, 0.03
"""Steps in which the learning rate rises; fraction of the steps in which it stays, and of the rate at which it ends."""

SURE_FROM = 600
"""Steps from which a network may doubt that a cell off the boxes of an incomplete image is a negative."""

AVERAGED = 0.999
"""Weight of the past in the average of the weights."""

REPORTED, SAVED = 200, 1_000
"""Steps between lines of the curve and between checkpoints."""

AHEAD = 4
"""Steps that wait in an accelerator, at most."""

BEGUN_BY, RANGED, RANGED_CROPS = 64, 100, 512
"""Crops that tell the range of each layer of a network that is begun from; images, about, and crops that tell the range
of values of the networks in 8-bit integers."""


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
    """A network on its way, with the average of its weights."""

    def __init__(self, kind: Kind, device: torch.device) -> None:
        self.kind = kind
        self.network = kind.build().to(device, memory_format=torch.channels_last).train()
        self.average = kind.build().to(device).requires_grad_(False).eval()
        self.average.load_state_dict(self.network.state_dict())
        weights = [p for p in self.network.parameters() if p.ndim > 1]
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        self.rate = torch.zeros((), device=device)
        on_accelerator = device.type == "cuda"
        self.descent = torch.optim.AdamW(
            [{"params": weights}, {"params": others, "weight_decay": 0.0}],
            lr=self.rate,
            weight_decay=WEIGHT_DECAY,
            capturable=on_accelerator,
            fused=on_accelerator,
            foreach=False,
        )

    def learn(self, losses: Mapping[str, Tensor], new: Tensor) -> Tensor:
        """One step down the gradient of the sum of the losses; new: weight of the new weights in the average.

        The losses, stacked.
        """
        parts = torch.stack([value.float() for value in losses.values()])
        parts.sum().backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self.kind.largest_gradient)
        self.descent.step()
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
            name: getattr(self, name).state_dict() for name in ("network", "average", "descent")
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""
        for name, held in state.items():
            getattr(self, name).load_state_dict(held)
        for group in self.descent.param_groups:
            group["lr"] = self.rate


class Pair:
    """A detection network and a box network that learn from the same crops, a share of them from images held out."""

    def __init__(self, share_held_out: float, memory: CropMemory, device: torch.device) -> None:
        self.share, self.memory, self.device = share_held_out, memory, device
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
            one.descent.zero_grad(set_to_none=True)
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
        crops = self.memory.drawn(self.share, CROPS)
        for one in self.learners.values():
            one.descent.zero_grad(set_to_none=True)
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
        boxes = _boxes_of(crops)
        # what is cast is not kept: a recorded graph would not cast it again
        with torch.autocast(self.device.type, torch.bfloat16, cache_enabled=False):
            maps = self.learners["network"].network(batch.rgb)
            values = self.learners["box"].network(boxes["patch"], boxes["size"])
        return {
            "network": detector_network.losses(maps.float(), batch, self.sure),
            "box": box_network.losses(values.float(), boxes),
        }


def _boxes_of(crops: Mapping[str, Tensor]) -> dict[str, Tensor]:
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


def _kept(device: torch.device) -> tuple[int, int]:
    """How many crops are kept on a device; see `KEPT`."""
    if device.type != "cuda":
        return KEPT
    each = sum(int(np.prod(shape)) * np.dtype(kind).itemsize for kind, shape in COLUMNS.values())
    free, _ = torch.cuda.mem_get_info(device)
    times = KEPT_SHARE * free / (each * sum(KEPT))
    return int(times * KEPT[0]), int(times * KEPT[1])


class _Arrivals:
    """Crops on their way from the processes that make them into the memory of a device."""

    def __init__(self, source: CropProcesses, memory: CropMemory, device: torch.device) -> None:
        self._source, self._memory, self._device = source, memory, device
        self._sent: deque[tuple[tuple[int, int], Any]] = deque()
        if device.type == "cuda":
            for columns in source.columns:
                for values in columns.values():
                    # an accelerator copies from memory that stays in its place while the processor goes on
                    torch.cuda.check_error(
                        torch.cuda.cudart().cudaHostRegister(values.ctypes.data, values.nbytes, 0)
                    )

    def take(self) -> None:
        """Wait for the next hand-over and send it; give back the places of those that have arrived."""
        while self._sent and self._sent[0][1].query():
            self._source.give_back(*self._sent.popleft()[0])
        process, place = self._source.taken()
        columns = self._source.columns[process]
        on_accelerator = self._device.type == "cuda"
        sent = {
            name: torch.from_numpy(values[place]).to(self._device, non_blocking=on_accelerator)
            for name, values in columns.items()
            if name != "held_out"
        }
        self._memory.add(sent, columns["held_out"][place].copy())
        if on_accelerator:
            event = torch.cuda.Event()
            event.record()
            self._sent.append(((process, place), event))
        else:
            self._source.give_back(process, place)


@dataclass(frozen=True, slots=True)
class Plan:
    """How networks are learned.

    steps: up to which they are trained; processes: that make crops; device: `cpu` or `cuda`; proposing: the detection
    network whose boxes the box network learns to classify; begin_from: folder of a `network.onnx` and a `box.onnx`
    whose weights are begun with, not with random ones; without: sources of real images that networks see nothing of
    which are learned beside.
    """

    steps: int
    seed: int
    proposing: Path
    processes: int = max(1, (os.cpu_count() or 2) - 1)
    device: str = "cuda" if torch.cuda.is_available() else "cpu"
    begin_from: Path | None = None
    without: Sequence[str] = ()


def learn_networks(drives: Path | None, real: Path, folder: Path, plan: Plan) -> None:
    """Train both networks and write them with what they were learned from, those of held-out sources into `without/`.

    `float.onnx` and `box_float.onnx` are the networks as they were learned, `network.onnx` and `box.onnx` the same in
    8-bit integers.
    """
    folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    checkpoint = folder / "checkpoint.pt"
    state = torch.load(checkpoint, weights_only=True) if checkpoint.is_file() else None
    first = 0 if state is None else state["made"]
    # nothing else keeps the images: they are held where the processes read them
    with crops_made(
        _subject(drives, real, plan.without), plan.proposing, plan.processes, plan.seed, first
    ) as source:
        training = _Training(source, plan, folder, state)
        training.run()
        feeds = training.some_boxes()
    subject = source.subject
    for pair in training.pairs:
        seen = [
            image
            for image, held_out in zip(subject.images, subject.held_out.tolist(), strict=True)
            if pair.share or not held_out
        ]
        target = folder if pair is training.pairs[0] else folder / "without"
        _write(target, pair, seen, subject.library, training, feeds)


def _subject(drives: Path | None, real: Path, without: Sequence[str]) -> Subject:
    """All images, those of the sources held out last."""
    rest = training_images(drives, real, without)
    images = [*rest, *held_out_images(real, without)]
    return Subject(images, np.arange(len(images)) >= len(rest), read_face_library(real))


class _Training:
    """Pairs of networks that learn side by side."""

    def __init__(
        self,
        source: CropProcesses,
        plan: Plan,
        folder: Path,
        state: Mapping[str, Any] | None,
    ) -> None:
        device = torch.device(plan.device)
        self.plan, self.folder, self.source, self.device = plan, folder, source, device
        self.step = 0 if state is None else int(state["step"])
        self.begun_from = "" if state is None else str(state["begun_from"])
        torch.manual_seed(plan.seed + self.step)
        self.memory = CropMemory(device, _kept(device))
        self._arrivals = _Arrivals(source, self.memory, device)
        subject = source.subject
        share = float(drawing_probability(subject.images)[subject.held_out].sum())
        self.pairs = [Pair(share, self.memory, device)]
        if subject.held_out.any():
            self.pairs.append(Pair(0.0, self.memory, device))
        while sum(self.memory.made) < FIRST:
            self._arrivals.take()
        if state is not None:
            for pair, held in zip(self.pairs, state["pairs"], strict=True):
                for name, learner in pair.learners.items():
                    learner.load(held[name])
        elif plan.begin_from is not None:
            self._begin_from(plan.begin_from)

    def _begin_from(self, folder: Path) -> None:
        crops = {name: values[:BEGUN_BY].cpu() for name, values in self.memory.columns.items()}
        boxes = _boxes_of(crops)
        inputs = {"network": (crops["rgb"],), "box": (boxes["patch"], boxes["size"])}
        said = []
        for pair in self.pairs:
            for name, learner in pair.learners.items():
                learner.begin_from(folder / f"{name}.onnx", *inputs[name])
        for name in KINDS:
            earlier = onnx_metadata((folder / f"{name}.onnx").read_bytes())
            said += [f"{key}: {earlier[key]}" for key in sorted(earlier)]
        self.begun_from = "; ".join(said)

    def run(self) -> None:
        """Learn up to the last step, with the curve and checkpoints in the folder."""
        if self.step >= self.plan.steps:
            return
        for pair in self.pairs:
            pair.record()
        begun, made = self.step, sum(self.memory.made)
        reported, since = self.step, time.monotonic()
        while self.step < self.plan.steps:
            while sum(self.memory.made) - made < (self.step - begun) * CROPS / USES:
                self._arrivals.take()
            for pair in self.pairs:
                pair.step(self.step, self.plan.steps)
            self.step += 1
            if self.device.type == "cuda" and self.step % AHEAD == 0:
                torch.cuda.synchronize()
            if self.step % REPORTED == 0:
                now = time.monotonic()
                self._report(self.step - reported, now - since)
                reported, since = self.step, now
            if self.step % SAVED == 0:
                self._save()
        self._save()

    def _report(self, steps: int, seconds: float) -> None:
        """A line of the curve: step, losses of each pair, seconds a step, learning rate, crops made."""
        cells = [str(self.step)]
        for pair in self.pairs:
            cells += [f"{value / steps:.4f}" for value in pair.losses.tolist()]
            pair.losses.zero_()
        rate = rate_at(self.step, self.plan.steps)
        cells += [f"{seconds / steps:.4f}", f"{rate:.4f}", str(self.source.number * TOGETHER)]
        with (self.folder / "curve.csv").open("a", encoding="utf-8") as curve:
            curve.write(",".join(cells) + "\n")

    def _save(self) -> None:
        """Write all that is needed to go on; never half a file."""
        state = {
            "step": self.step,
            "made": self.source.number,
            "begun_from": self.begun_from,
            "pairs": [
                {name: one.state() for name, one in pair.learners.items()} for pair in self.pairs
            ],
        }
        path = self.folder / "checkpoint.new"
        torch.save(state, path)
        path.replace(self.folder / "checkpoint.pt")

    def some_boxes(self) -> list[Columns]:
        """Boxes of crops of images that are not held out, as a box network sees them, some at a time."""
        return list(self._boxes(min(RANGED_CROPS, *self.memory.kept[:1])))

    def _boxes(self, crops: int) -> Iterator[Columns]:
        held = {
            name: self.memory.columns[name][:crops].cpu().numpy()
            for name in ("rgb", "boxes", "count")
        }
        for rgb, boxes, count in zip(held["rgb"], held["boxes"], held["count"], strict=True):
            if count:
                box = boxes[:count]
                yield {
                    "patch": drawn_patches(pyramid(rgb), box),
                    "size": box[:, 2:] - box[:, :2],
                }


def _write(
    folder: Path,
    pair: Pair,
    images: Sequence[LabelledImage],
    library: FaceLibrary,
    training: _Training,
    feeds: Sequence[Columns],
) -> None:
    """Write the averaged networks of a pair."""
    plan = training.plan
    said = provenance(images, library, plan.seed) | {
        "steps": str(training.step),
        "crops": f"{training.step * CROPS} drawn, some {training.step * CROPS // USES} made",
    }
    if training.begun_from:
        said["begun from"] = training.begun_from
    folder.mkdir(parents=True, exist_ok=True)
    network, box = (pair.learners[name].average.cpu() for name in ("network", "box"))
    detector_network.export(network, folder / "float.onnx", said)
    some = (image.rgb for image in images[:: max(1, len(images) // RANGED)])
    quantize(folder / "float.onnx", folder / "network.onnx", some)
    box_network.export(box, folder / "box_float.onnx", said)
    quantize_boxes(folder / "box_float.onnx", folder / "box.onnx", feeds)
