"""Long training of the detection network: resumable, with its curve.

    python -m wayside.pipeline.learn --drives FOLDER --real FOLDER -o FOLDER --network-steps N

Weights start at random, or with `--network-from NETWORK.onnx` where those of an earlier network ended. Crops are made
in a second process. The folder holds `checkpoint.pt`, from which the same command goes on, and `curve.csv` (step;
losses of heat, box, colour, shape; seconds a step; of these, waiting for crops; learning rate).
Every checkpoint has averaged weights, so that it can be used whenever the training is ended.
"""

from __future__ import annotations

import multiprocessing
import time
from collections import Counter, defaultdict, deque
from collections.abc import Sequence
from multiprocessing.queues import Queue
from pathlib import Path
from queue import Full
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wayside.pipeline.learning.detector_crops import Crop, Noise, make_crop, make_noise
from wayside.pipeline.learning.detector_images import LabelledImage, rendered_images
from wayside.pipeline.learning.detector_network import Batch, DetectionNetwork, export, losses
from wayside.pipeline.learning.detector_weights import load_weights
from wayside.pipeline.learning.face_drawings import FaceLibrary, read_face_library
from wayside.pipeline.learning.quantization import quantize
from wayside.pipeline.learning.scenes import real_sources
from wayside.pipeline.provenance import onnx_metadata

BATCH, LEARNING_RATE, WEIGHT_DECAY, WARM_UP, DECAY_FROM = 16, 1.5e-3, 0.02, 500, 0.3
"""Crops of a batch; largest learning rate; weight decay; steps of rising rate; fraction of steps before it falls."""

SURE_FROM = 1000
"""Steps from which the network may doubt that a cell off the boxes of an incomplete image is a negative."""

AVERAGED = 0.999
"""Weight of the past in the average of the weights."""

LARGEST_GRADIENT = 10.0
REPORTED, SAVED = 200, 500
"""Steps between lines of the curve and between checkpoints."""

REUSED_AFTER = 48
"""Batches until a batch is used for the second time: to make a crop costs as much as to learn from it."""

MOST_WAIT_S = 300.0
"""A batch that takes longer will never come: the second process has died."""

NORMALISED = 4
"""Batches that tell the mean and the deviation of each layer of a network that the training starts from."""

RANGED = 100
"""Images, about, that tell the range of values of the network in 8-bit integers."""

WEIGHTS = {
    "rendered": 0.38,
    "us_freeway_challenge": 0.04,
    "us_freeway_white_right": 0.04,
    "ca_city_garmin": 0.14,
    "scenes": 0.14,
    "scenes_speed_us": 0.12,
    "scenes_mixed": 0.14,
}
"""How often an image of a kind of source is drawn; within a kind, sources are alike."""

LICENCES = {
    "rendered": "own",
    "us_freeway_challenge": "MIT (upstream)",
    "us_freeway_white_right": "MIT (upstream)",
    "ca_city_garmin": "MIT",
    "scenes": "MIT (named by the source)",
    "scenes_speed_us": "GPL-3.0 (file of the source)",
    "scenes_mixed": "CC0 1.0 (as published elsewhere), pictures 0-156 left out",
}
"""Licences of the kinds of sources, as found; those of the drawn faces are stated with them."""

BATCH_FIELDS = ("rgb", "heat", "doubt", "cell", "box", "weight", "color", "shape")


def source_kind(source: str) -> str:
    """The kind of a source, a key of `WEIGHTS`."""
    return source.split("/")[0]


def drawing_probability(images: Sequence[LabelledImage]) -> NDArray[np.float64]:
    """How often each image is drawn, (images,)."""
    count = Counter(image.source for image in images)
    per_kind = Counter(source_kind(source) for source in count)
    share = [
        WEIGHTS[source_kind(i.source)] / per_kind[source_kind(i.source)] / count[i.source]
        for i in images
    ]
    return np.asarray(np.array(share) / np.sum(share), np.float64)


def training_images(drives: Path | None, real: Path | None) -> list[LabelledImage]:
    """All images that are learned from."""
    images: list[LabelledImage] = []
    for log in sorted(drives.glob("learn_*.mcap")) if drives else []:
        images += rendered_images(log)
    for read in real_sources(real).values() if real else []:
        images += read()
    return images


def make_batch(
    images: Sequence[LabelledImage],
    probability: NDArray[np.float64],
    library: FaceLibrary,
    noise: Noise,
    rng: np.random.Generator,
) -> dict[str, NDArray[Any]]:
    """`BATCH` crops, field by field."""
    crops: list[Crop] = [make_crop(images, probability, library, noise, rng) for _ in range(BATCH)]
    return {name: np.stack([getattr(crop, name) for crop in crops]) for name in BATCH_FIELDS}


def _produce(queue: Queue[Any], drives: Path | None, real: Path, seed: int, first: int) -> None:
    cv2.setNumThreads(1)
    images, library = training_images(drives, real), read_face_library(real)
    probability = drawing_probability(images)
    noise = make_noise(np.random.default_rng(seed))
    number = first
    parent = multiprocessing.parent_process()
    while True:
        rng = np.random.default_rng([seed, number])
        batch = make_batch(images, probability, library, noise, rng)
        while True:
            try:
                queue.put(batch, timeout=10.0)
                break
            except Full:
                if parent is not None and not parent.is_alive():
                    return
        number += 1


def as_tensors(batch: dict[str, NDArray[Any]]) -> Batch:
    """A batch as the network wants it."""
    held = {name: torch.from_numpy(values) for name, values in batch.items()}
    rgb = held["rgb"].permute(0, 3, 1, 2).to(torch.float32).mul_(1 / 255)
    return Batch(
        rgb.contiguous(memory_format=torch.channels_last),
        held["heat"].float(),
        held["doubt"],
        held["cell"].long(),
        held["box"],
        held["weight"],
        held["color"],
        held["shape"],
    )


def learning_rate(step: int, steps: int) -> float:
    """Rising, constant, then falling to a fiftieth."""
    start = min(1.0, (step + 1) / WARM_UP)
    left = (steps - step) / max(steps * (1 - DECAY_FROM), 1)
    return LEARNING_RATE * start * min(1.0, max(left, 0.02))


class Training:
    """A network on its way, with its average."""

    def __init__(self, seed: int) -> None:
        torch.manual_seed(seed)
        self.network = DetectionNetwork().to(memory_format=torch.channels_last)
        self.average = DetectionNetwork().requires_grad_(False)
        self.average.load_state_dict(self.network.state_dict())
        weights = [p for p in self.network.parameters() if p.ndim > 1]
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        self.descent = torch.optim.AdamW(
            [{"params": weights}, {"params": others, "weight_decay": 0.0}],
            lr=LEARNING_RATE,
            weight_decay=WEIGHT_DECAY,
        )
        self.step = 0
        self.begun_from = ""

    def learn(self, batch: Batch, steps: int) -> dict[str, float]:
        """One step; the losses."""
        for group in self.descent.param_groups:
            group["lr"] = learning_rate(self.step, steps)
        self.network.train()
        with torch.autocast("cpu", torch.bfloat16):
            maps = self.network(batch.rgb)
        parts = losses(maps, batch, sure=self.step >= SURE_FROM)
        self.descent.zero_grad(set_to_none=True)
        torch.stack(list(parts.values())).sum().backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT)
        self.descent.step()
        self.step += 1
        self._add_to_average()
        return {name: float(value.detach()) for name, value in parts.items()}

    def start_from(self, path: Path, images: Tensor) -> None:
        """Begin with the weights of a network in a file, not at random; images: what it sees."""
        load_weights(self.network, path, images)
        self.average.load_state_dict(self.network.state_dict())
        earlier = onnx_metadata(path.read_bytes())
        self.begun_from = "; ".join(f"{key}: {earlier[key]}" for key in sorted(earlier))

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _add_to_average(self) -> None:
        past = min(AVERAGED, (1 + self.step) / (10 + self.step))
        now = self.network.state_dict()
        for name, value in self.average.state_dict().items():
            if value.dtype.is_floating_point:
                value.lerp_(now[name], 1 - past)
            else:
                value.copy_(now[name])

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


def train(
    drives: Path | None,
    real: Path,
    folder: Path,
    steps: int,
    seed: int,
    start: Path | None = None,
) -> Training:
    """Train up to `steps`, from the checkpoint in the folder if there is one, else from the network of `start`."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    training = Training(seed)
    checkpoint = folder / "checkpoint.pt"
    if checkpoint.is_file():
        training.load(checkpoint)
    context = multiprocessing.get_context("spawn")
    queue: Queue[Any] = context.Queue(8)
    process = context.Process(
        target=_produce, args=(queue, drives, real, seed, training.step // 2), daemon=True
    )
    process.start()
    try:
        if start is not None and training.step == 0:
            first = [as_tensors(queue.get(timeout=MOST_WAIT_S)) for _ in range(NORMALISED)]
            training.start_from(start, torch.cat([batch.rgb for batch in first]))
        _run(training, queue, folder, steps)
    finally:
        process.terminate()
    training.save(checkpoint)
    return training


def _run(training: Training, queue: Queue[Any], folder: Path, steps: int) -> None:
    past: deque[Batch] = deque(maxlen=REUSED_AFTER)
    totals: defaultdict[str, float] = defaultdict(float)
    reported = training.step
    since = time.monotonic()
    while training.step < steps:
        if training.step % 2 and len(past) == REUSED_AFTER:
            batch = past[0]
        else:
            before = time.monotonic()
            batch = as_tensors(queue.get(timeout=MOST_WAIT_S))
            past.append(batch)
            totals["wait"] += time.monotonic() - before
        for name, value in training.learn(batch, steps).items():
            totals[name] += value
        if training.step % REPORTED == 0:
            count, now = training.step - reported, time.monotonic()
            means = [totals[name] / count for name in ("heat", "box", "color", "shape")]
            rate = learning_rate(training.step, steps)
            times = (now - since) / count, totals["wait"] / count
            cells = [f"{value:.4f}" for value in (*means, *times)]
            with (folder / "curve.csv").open("a", encoding="utf-8") as curve:
                curve.write(",".join([str(training.step), *cells, f"{rate:.2e}"]) + "\n")
            totals.clear()
            reported, since = training.step, now
        if training.step % SAVED == 0:
            training.save(folder / "checkpoint.pt")


def provenance(
    images: Sequence[LabelledImage], library: FaceLibrary, seed: int, step: int
) -> dict[str, Any]:
    """What a network was learned from."""
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
        "seed": seed,
        "steps": step,
        "crops": step * BATCH,
    }


def learn_network(
    drives: Path | None,
    real: Path,
    folder: Path,
    steps: int,
    seed: int,
    start: Path | None = None,
) -> None:
    """Train up to `steps` and write the averaged network with what it was learned from.

    `float.onnx` is the network as it was learned, `network.onnx` the same in 8-bit integers. A checkpoint of so many
    steps is written as it is.
    """
    training = train(drives, real, folder, steps, seed, start)
    images, library = training_images(drives, real), read_face_library(real)
    seen = provenance(images, library, seed, training.step)
    if training.begun_from:
        seen["begun from"] = training.begun_from
    export(training.average, folder / "float.onnx", seen)
    some = (image.rgb for image in images[:: max(1, len(images) // RANGED)])
    quantize(folder / "float.onnx", folder / "network.onnx", some)
