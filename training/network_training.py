"""Training of the detection network and the box network, on the processor or on an accelerator.

    python -m training.network_training --drives FOLDER --real FOLDER -o FOLDER --steps N

Processes make crops, and the last of them stay in a buffer on the device. Each step draws from there: the detection
network learns from the crops, the box network from boxes in them. `--without SOURCE` trains networks that see nothing
of a source, so that they can be measured on it.

The folder holds `checkpoint.pt`, from which the same command goes on, and `curve.csv`. Weights are averaged over the
last steps, so that a training can be ended whenever one likes.
"""

import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from training.crop_batches import TOGETHER, Columns, CropBatches, CropBuffer, boxes_of
from training.detector_images import LICENCES, LabelledImage, source_kind, training_images
from training.face_drawings import FaceLibrary, read_face_library
from training.networks import BoxNetwork, DetectionNetwork
from training.quantization import quantize, quantize_boxes
from training.truth import DRIVES, OUT, REAL, SEED, command
from wayside.pipeline.models.model_folder import shipped_models
from wayside.stages.detection import PATCH_DARK_LEVEL, log_levels

CROPS, BOXES_EACH = 128, 10
"""Crops of a step, and boxes of each of these."""

USES = 5
"""How often a crop is drawn, on average: to make one takes a core longer than an accelerator learns from it."""

FIRST = 4_096
"""Crops that are there when the training begins."""

RATE, WARM_UP, CONSTANT, LAST, WEIGHT_DECAY = 2.5e-3, 400, 0.25, 0.01, 0.03
"""Largest learning rate; steps in which it rises; fraction of the steps in which it stays, and of it at the end."""

SURE_FROM = 600
"""Steps from which a network may doubt that a cell off the boxes of an incomplete image is a negative."""

AVERAGED = 0.999
"""Weight of the past in the average of the weights."""

REPORTED, SAVED = 200, 1_000
"""Steps between lines of the curve and between checkpoints."""

RANGED, RANGED_CROPS = 100, 512
"""Images, about, and crops that tell the range of values of the networks in 8-bit integers."""

LARGEST_GRADIENT = {"network": 10.0, "box": 5.0}
"""Largest norm of the gradient of each network."""


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How networks are learned.

    `steps`: up to which they are trained. `proposing`: the detection network whose boxes the box network learns to
    classify. `processes`: that make crops. `device`: `cpu` or `cuda`. `without`: sources that they see nothing of.
    """

    steps: int
    seed: int
    proposing: Path
    processes: int
    device: str
    without: Collection[str] = ()


def rate_at(step: int, steps: int) -> float:
    """The learning rate as a fraction of the largest: rising, constant, then falling."""
    left = (steps - step) / max(steps * (1 - CONSTANT), 1)
    return min(1.0, (step + 1) / WARM_UP) * min(1.0, max(left, LAST))


class Learner:
    """A network in training, its optimizer, and the moving average of its weights."""

    def __init__(
        self, build: Callable[[], nn.Module], largest_gradient: float, device: torch.device
    ) -> None:
        self.largest_gradient = largest_gradient
        self.network = build().to(device, memory_format=torch.channels_last).train()
        self.average = build().to(device).requires_grad_(False).eval()
        self.average.load_state_dict(self.network.state_dict())
        weights = [p for p in self.network.parameters() if p.ndim > 1]
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        self.optimizer = torch.optim.AdamW(
            [{"params": weights}, {"params": others, "weight_decay": 0.0}],
            weight_decay=WEIGHT_DECAY,
        )

    def learn(self, losses: Mapping[str, Tensor], rate: float, new: float) -> Tensor:
        """One step of the optimizer on the sum of the losses; new: weight of the new weights in the average.

        The losses, stacked.
        """
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.zero_grad()
        parts = torch.stack([value.float() for value in losses.values()])
        parts.sum().backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self.largest_gradient)
        self.optimizer.step()
        now = self.network.state_dict()
        with torch.no_grad():
            for name, past in self.average.state_dict().items():
                if past.dtype.is_floating_point:
                    past.lerp_(now[name], new)
        return parts.detach()

    def state(self) -> dict[str, Any]:
        """All that is needed to go on."""
        names = ("network", "average", "optimizer")
        return {name: getattr(self, name).state_dict() for name in names}

    def load(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""
        for name, held in state.items():
            getattr(self, name).load_state_dict(held)


class Training:
    """Both networks, which learn from the same crops; step: how many were taken."""

    def __init__(self, batches: CropBatches, options: TrainingOptions, folder: Path) -> None:
        path = folder / "checkpoint.pt"
        state: dict[str, Any] = {"step": 0, "number": 0, "learners": {}}
        if path.is_file():
            state = torch.load(path, weights_only=True)
        self.batches, self.options, self.folder = batches, options, folder
        self.step, self.number = int(state["step"]), int(state["number"])
        on_accelerator = options.device == "cuda"
        self._made: Iterator[dict[str, Tensor]] = iter(
            batches.loader(options.processes, self.number, pinned=on_accelerator)
        )
        torch.manual_seed(options.seed + self.step)
        device = torch.device(options.device)
        self.buffer, self.losses = CropBuffer(device), torch.zeros(8, device=device)
        built = {"network": DetectionNetwork, "box": BoxNetwork}
        self.learners = {
            name: Learner(build, LARGEST_GRADIENT[name], device) for name, build in built.items()
        }
        for name, held in state["learners"].items():
            self.learners[name].load(held)

    def take_until(self, crops: float) -> None:
        """Wait until the buffer was given so many crops."""
        while self.buffer.made < crops:
            self.buffer.add(next(self._made))
            self.number += 1

    def run(self) -> None:
        """Learn up to the last step, with the curve and checkpoints in the folder."""
        self.take_until(FIRST)
        begun, made, reported, since = self.step, self.buffer.made, self.step, time.monotonic()
        while self.step < self.options.steps:
            self.take_until(made + (self.step - begun) * CROPS / USES)
            self.learn()
            if self.step % REPORTED == 0:
                now = time.monotonic()
                self._report(self.step - reported, now - since)
                reported, since = self.step, now
            if self.step % SAVED == 0 or self.step == self.options.steps:
                self._save()

    def learn(self) -> None:
        """One step on crops drawn from the buffer."""
        rate = RATE * rate_at(self.step, self.options.steps)
        new = 1 - min(AVERAGED, (1 + self.step) / (10 + self.step))
        crops = self.buffer.drawn(CROPS)
        boxes = boxes_of(crops, BOXES_EACH)
        network, box = self.learners["network"], self.learners["box"]
        with torch.autocast(self.options.device, torch.bfloat16):
            maps = network.network(crops["rgb"])
            values = box.network(torch.log(boxes["patch"] + PATCH_DARK_LEVEL), boxes["size"])
        sure = self.step >= SURE_FROM
        parts = [
            network.learn(DetectionNetwork.losses(maps.float(), crops, sure=sure), rate, new),
            box.learn(BoxNetwork.losses(values.float(), boxes), rate, new),
        ]
        self.losses.add_(torch.cat(parts))
        self.step += 1

    def _report(self, steps: int, seconds: float) -> None:
        """A line of the curve: step, losses, seconds a step, learning rate, crops made."""
        losses = (self.losses / steps).tolist()
        rate = rate_at(self.step, self.options.steps)
        cells = [f"{value:.4f}" for value in (*losses, seconds / steps, rate)]
        with (self.folder / "curve.csv").open("a", encoding="utf-8") as curve:
            curve.write(",".join([str(self.step), *cells, str(self.number * TOGETHER)]) + "\n")
        self.losses.zero_()

    def _save(self) -> None:
        """Write all that is needed to go on; never half a file."""
        learners = {name: one.state() for name, one in self.learners.items()}
        state = {"step": self.step, "number": self.number, "learners": learners}
        path = self.folder / "checkpoint.new"
        torch.save(state, path)
        path.replace(self.folder / "checkpoint.pt")

    def some_boxes(self) -> Iterator[Columns]:
        """The boxes of some crops, as a box network sees them, a crop each."""
        names = ("of_box_patch", "of_box_size", "count")
        held = (self.buffer.columns[name][:RANGED_CROPS].cpu().numpy() for name in names)
        return (
            {"patch": log_levels(patch[:count]), "size": size[:count]}
            for patch, size, count in zip(*held, strict=True)
            if count
        )

    def write(self) -> None:
        """Write the averaged networks: as they were learned, and in 8-bit integers."""
        images, folder = self.batches.images, self.folder
        said = provenance(images, self.batches.library, self.options.seed) | {
            "steps": str(self.step),
            "crops": f"{self.step * CROPS} drawn, some {self.step * CROPS // USES} made",
        }
        network, box = (self.learners[name].average.cpu() for name in ("network", "box"))
        network.write(folder / "float.onnx", said)
        some = (image.rgb for image in images[:: max(1, len(images) // RANGED)])
        quantize(folder / "float.onnx", folder / "network.onnx", some)
        box.write(folder / "box_float.onnx", said)
        quantize_boxes(folder / "box_float.onnx", folder / "box.onnx", self.some_boxes())


def learn_networks(drives: Path | None, real: Path, folder: Path, options: TrainingOptions) -> None:
    """Train both networks and write them into a folder with what they were learned from.

    `float.onnx` and `box_float.onnx` are the networks as they were learned, `network.onnx` and `box.onnx` the same in
    8-bit integers. Raises InputError if a source to leave out is unknown.
    """
    torch.set_num_threads(1)
    images = training_images(drives, real, options.without)
    batches = CropBatches(images, read_face_library(real), options.proposing, options.seed)
    folder.mkdir(parents=True, exist_ok=True)
    training = Training(batches, options, folder)
    training.run()
    training.write()


def provenance(images: Sequence[LabelledImage], library: FaceLibrary, seed: int) -> dict[str, str]:
    """What networks were learned from."""
    count = Counter(image.source for image in images)
    faces: Counter[str] = Counter()
    for image in images:
        faces[image.source] += len(image.box)
    sources = [
        f"{name}: {count[name]} images, {faces[name]} faces, {LICENCES[source_kind(name)]}"
        for name in sorted(count)
    ]
    return {
        "sources": "; ".join(sources),
        "faces drawn in": f"{len(library.vector)} vector faces, MIT (mapillary_sprite_source, mutcd-ts); "
        f"{len(library.cut)} crops of GTSRB, public research set",
        "seed": str(seed),
    }


main = command(
    __doc__,
    lambda drives, real, out, **given: learn_networks(drives, real, out, TrainingOptions(**given)),
    drives=DRIVES,
    real=REAL,
    out=OUT,
    steps=("--steps", {"type": int, "required": True, "help": "steps up to which is trained"}),
    seed=SEED,
    without=("--without", {"action": "append", "default": [], "metavar": "SOURCE"}),
    proposing=(
        "--proposing",
        {"type": Path, "default": shipped_models() / "network.onnx", "metavar": "NETWORK.onnx"},
    ),
    processes=("--processes", {"type": int, "default": max(1, (os.cpu_count() or 2) - 1)}),
    device=("--device", {"default": "cuda" if torch.cuda.is_available() else "cpu"}),
)

if __name__ == "__main__":
    sys.exit(main())
