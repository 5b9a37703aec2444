"""Training of the detection network and the box network, on the processor or on an accelerator.

    python -m wayside.pipeline.learn --drives FOLDER --real FOLDER -o FOLDER --network-steps N

Processes make crops; the last of them stay in a buffer on the device, and each step draws from there: the detection
network learns from the crops, the box network from boxes in them. Networks that see nothing of some sources learn from
the same crops beside, so that they can be measured on those.

The folder holds `checkpoint.pt`, from which the same command goes on, and `curve.csv`. Weights are averaged over the
last steps, so that a training can be ended whenever one likes.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from wayside.pipeline.learning import box_network, detector_network
from wayside.pipeline.learning.crop_buffer import CropBuffer
from wayside.pipeline.learning.crop_processes import (
    COLUMNS,
    TOGETHER,
    Columns,
    CropProcesses,
    TrainingSet,
    crops_made,
)
from wayside.pipeline.learning.detector_images import LabelledImage
from wayside.pipeline.learning.face_drawings import FaceLibrary, read_face_library
from wayside.pipeline.learning.network_learners import CROPS, KINDS, Pair, boxes_of, rate_at
from wayside.pipeline.learning.quantization import quantize, quantize_boxes
from wayside.pipeline.learning.training_images import (
    drawing_probability,
    held_out_images,
    provenance,
    training_images,
)
from wayside.pipeline.provenance import onnx_metadata
from wayside.schemas.errors import InputError
from wayside.stages.detection import drawn_patches
from wayside.stages.imaging import pyramid

USES = 5
"""How often a crop is drawn, on average: to make one takes a core longer than an accelerator learns from it."""

KEPT, KEPT_SHARE = (8_000, 1_600), 0.6
"""Crops of 0.23 MB that are kept by a processor: of all images but those held out, and of those. An accelerator keeps
as many times these as fill this fraction of its free memory."""

FIRST = 4_096
"""Crops that are there when the training begins."""

REPORTED, SAVED = 200, 1_000
"""Steps between lines of the curve and between checkpoints."""

AHEAD = 4
"""Steps that wait in an accelerator, at most."""

BEGUN_BY, RANGED, RANGED_CROPS = 64, 100, 512
"""Crops that tell the range of each layer of a network that is begun from; images, about, and crops that tell the range
of values of the networks in 8-bit integers."""


def _kept(device: torch.device) -> tuple[int, int]:
    """How many crops are kept on a device; see `KEPT`."""
    if device.type != "cuda":
        return KEPT
    each = sum(int(np.prod(shape)) * np.dtype(kind).itemsize for kind, shape in COLUMNS.values())
    free, _ = torch.cuda.mem_get_info(device)
    times = KEPT_SHARE * free / (each * sum(KEPT))
    return int(times * KEPT[0]), int(times * KEPT[1])


class _Transfer:
    """Copies crops from the processes that make them into the buffer of a device."""

    def __init__(self, source: CropProcesses, buffer: CropBuffer, device: torch.device) -> None:
        self._source, self._buffer, self._device = source, buffer, device
        self._copying: deque[tuple[tuple[int, int], Any]] = deque()
        if device.type == "cuda":
            for columns in source.columns:
                for values in columns.values():
                    # an accelerator copies from memory that stays in its place while the processor goes on
                    torch.cuda.check_error(
                        torch.cuda.cudart().cudaHostRegister(values.ctypes.data, values.nbytes, 0)
                    )

    def take(self) -> None:
        """Wait for the next batch and copy it; free the slots of those that are copied."""
        while self._copying and self._copying[0][1].query():
            self._source.free(*self._copying.popleft()[0])
        process, slot = self._source.taken()
        columns = self._source.columns[process]
        on_accelerator = self._device.type == "cuda"
        sent = {
            name: torch.from_numpy(values[slot]).to(self._device, non_blocking=on_accelerator)
            for name, values in columns.items()
            if name != "held_out"
        }
        self._buffer.add(sent, columns["held_out"][slot].copy())
        if on_accelerator:
            event = torch.cuda.Event()
            event.record()
            self._copying.append(((process, slot), event))
        else:
            self._source.free(process, slot)


@dataclass(frozen=True, slots=True)
class TrainingOptions:
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


def learn_networks(drives: Path | None, real: Path, folder: Path, options: TrainingOptions) -> None:
    """Train both networks and write them with what they were learned from, those without some sources into `without/`.

    `float.onnx` and `box_float.onnx` are the networks as they were learned, `network.onnx` and `box.onnx` the same in
    8-bit integers. Raises InputError where networks to begin from have other layers or have learned from a source that
    is held out.
    """
    if options.begin_from is not None:
        _require_without(options.begin_from, options.without)
    folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    checkpoint = folder / "checkpoint.pt"
    state = torch.load(checkpoint, weights_only=True) if checkpoint.is_file() else None
    first = 0 if state is None else state["made"]
    # nothing else keeps the images: they are held where the processes read them
    with crops_made(
        _training_set(drives, real, options.without),
        options.proposing,
        options.processes,
        options.seed,
        first,
    ) as source:
        training = _Training(source, options, folder, state)
        training.run()
        feeds = training.some_boxes()
    training_set = source.training_set
    for pair in training.pairs:
        seen = [
            image
            for image, held_out in zip(
                training_set.images, training_set.held_out.tolist(), strict=True
            )
            if pair.share or not held_out
        ]
        target = folder if pair is training.pairs[0] else folder / "without"
        _write(target, pair, seen, training_set.library, training, feeds)


def _require_without(folder: Path, sources: Sequence[str]) -> None:
    """Raises InputError where a network to begin from is missing, or it or a predecessor has learned from a source."""
    for name in KINDS:
        path = folder / f"{name}.onnx"
        if not path.is_file():
            raise InputError(f"{folder}: wanted {path.name} to begin from, found none")
        said = onnx_metadata(path.read_bytes()).values()
        for source in sources:
            if any(f"{source}: " in text for text in said):
                raise InputError(
                    f"{folder}: wanted networks that have not learned from {source}, "
                    f"found {path.name}, which has"
                )


def _training_set(drives: Path | None, real: Path, without: Sequence[str]) -> TrainingSet:
    """All images, those of the sources held out last."""
    rest = training_images(drives, real, without)
    images = [*rest, *held_out_images(real, without)]
    return TrainingSet(images, np.arange(len(images)) >= len(rest), read_face_library(real))


class _Training:
    """Pairs of networks that learn side by side."""

    def __init__(
        self,
        source: CropProcesses,
        options: TrainingOptions,
        folder: Path,
        state: Mapping[str, Any] | None,
    ) -> None:
        device = torch.device(options.device)
        self.options, self.folder, self.source, self.device = options, folder, source, device
        self.step = 0 if state is None else int(state["step"])
        self.begun_from = "" if state is None else str(state["begun_from"])
        torch.manual_seed(options.seed + self.step)
        self.buffer = CropBuffer(device, _kept(device))
        self._transfer = _Transfer(source, self.buffer, device)
        training_set = source.training_set
        share = float(drawing_probability(training_set.images)[training_set.held_out].sum())
        self.pairs = [Pair(share, self.buffer, device)]
        if training_set.held_out.any():
            self.pairs.append(Pair(0.0, self.buffer, device))
        while sum(self.buffer.made) < FIRST:
            self._transfer.take()
        if state is not None:
            for pair, held in zip(self.pairs, state["pairs"], strict=True):
                for name, learner in pair.learners.items():
                    learner.load(held[name])
        elif options.begin_from is not None:
            self._begin_from(options.begin_from)

    def _begin_from(self, folder: Path) -> None:
        crops = {name: values[:BEGUN_BY].cpu() for name, values in self.buffer.columns.items()}
        boxes = boxes_of(crops)
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
        if self.step >= self.options.steps:
            return
        for pair in self.pairs:
            pair.record()
        begun, made = self.step, sum(self.buffer.made)
        reported, since = self.step, time.monotonic()
        while self.step < self.options.steps:
            while sum(self.buffer.made) - made < (self.step - begun) * CROPS / USES:
                self._transfer.take()
            for pair in self.pairs:
                pair.step(self.step, self.options.steps)
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
        rate = rate_at(self.step, self.options.steps)
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
        """The boxes of some crops of images that are not held out, as a box network sees them, a crop each."""
        crops = min(RANGED_CROPS, self.buffer.kept[0])
        names = ("rgb", "boxes", "count")
        held = (self.buffer.columns[name][:crops].cpu().numpy() for name in names)
        return [
            {"patch": drawn_patches(pyramid(rgb), box), "size": box[:, 2:] - box[:, :2]}
            for rgb, boxes, count in zip(*held, strict=True)
            if len(box := boxes[:count])
        ]


def _write(
    folder: Path,
    pair: Pair,
    images: Sequence[LabelledImage],
    library: FaceLibrary,
    training: _Training,
    feeds: Sequence[Columns],
) -> None:
    """Write the averaged networks of a pair."""
    options = training.options
    said = provenance(images, library, options.seed) | {
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
