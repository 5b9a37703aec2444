"""Training of the detection network on crops of rendered and real images.

    python -m wayside.pipeline.learn --drives FOLDER --real FOLDER -o FOLDER --network-steps N

Weights start at random, or with `--begin-from NETWORK.onnx` where those of an earlier network ended. The losses of
the curve are those of heat, box, colour and shape.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wayside.pipeline.learning.camera_effects import Noise, make_noise
from wayside.pipeline.learning.detector_crops import Crop, make_crop
from wayside.pipeline.learning.detector_images import LabelledImage, rendered_images
from wayside.pipeline.learning.detector_network import Batch, DetectionNetwork, export, losses
from wayside.pipeline.learning.face_drawings import FaceLibrary, read_face_library
from wayside.pipeline.learning.network_training import (
    Arrays,
    Descent,
    Make,
    Training,
    begun,
    produced,
)
from wayside.pipeline.learning.network_weights import move_halfway
from wayside.pipeline.learning.quantization import quantize
from wayside.pipeline.learning.scenes import real_sources

BATCH, DESCENT = 16, Descent(1.5e-3)
"""Crops of a batch, and how weights follow its gradient."""

SURE_FROM = 1000
"""Steps from which the network may doubt that a cell off the boxes of an incomplete image is a negative."""

REUSED_AFTER = 48
"""Batches until a batch is used for the second time: to make a crop costs as much as to learn from it."""

NORMALISED = 4
"""Batches that tell the mean and the deviation of each layer of a network that the training starts from."""

RANGED = 100
"""Images, about, that tell the range of values of the network in 8-bit integers."""

WEIGHTS = {
    "rendered": 0.35,
    "us_freeway_challenge": 0.03,
    "us_freeway_white_right": 0.03,
    "ca_city_garmin": 0.14,
    "scenes": 0.10,
    "scenes_speed_us": 0.12,
    "scenes_mixed": 0.23,
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


def training_images(
    drives: Path | None, real: Path | None, without: Collection[str] = ()
) -> list[LabelledImage]:
    """All images that are learned from; `without` names real sources that are held out."""
    images: list[LabelledImage] = []
    for log in sorted(drives.glob("learn_*.mcap")) if drives else []:
        images += rendered_images(log)
    for read in real_sources(real, without).values() if real else []:
        images += read()
    return images


def make_batch(
    images: Sequence[LabelledImage],
    probability: NDArray[np.float64],
    library: FaceLibrary,
    noise: Noise,
    rng: np.random.Generator,
) -> Arrays:
    """`BATCH` crops, field by field."""
    crops: list[Crop] = [make_crop(images, probability, library, noise, rng) for _ in range(BATCH)]
    return {name: np.stack([getattr(crop, name) for crop in crops]) for name in BATCH_FIELDS}


def batch_maker(drives: Path | None, real: Path, without: Collection[str], seed: int) -> Make:
    """What makes batches by their number: with its seed, a number says all."""
    images, library = training_images(drives, real, without), read_face_library(real)
    probability = drawing_probability(images)
    noise = make_noise(np.random.default_rng(seed))
    return lambda number: make_batch(
        images, probability, library, noise, np.random.default_rng([seed, number])
    )


def as_tensors(batch: dict[str, NDArray[Any]]) -> Batch:
    """A batch as the network wants it."""
    held = {name: torch.from_numpy(values) for name, values in batch.items()}
    return Batch(
        held["rgb"],
        held["heat"].float(),
        held["doubt"],
        held["cell"].long(),
        held["box"],
        held["weight"],
        held["color"],
        held["shape"],
    )


def batch_losses(network: nn.Module, batch: Arrays, step: int) -> dict[str, Tensor]:
    """The losses of a network on a batch."""
    held = as_tensors(batch)
    with torch.autocast("cpu", torch.bfloat16):
        maps = network(held.rgb)
    return losses(maps, held, sure=step >= SURE_FROM)


def used_twice(batches: Iterator[Arrays], step: int) -> Iterator[Arrays]:
    """The batches, each once more when `REUSED_AFTER` others have come."""
    past: deque[Arrays] = deque(maxlen=REUSED_AFTER)
    while True:
        if step % 2 and len(past) == REUSED_AFTER:
            yield past[0]
        else:
            past.append(next(batches))
            yield past[-1]
        step += 1


def train(
    drives: Path | None,
    real: Path,
    folder: Path,
    steps: int,
    seed: int,
    start: Path | None = None,
    without: Collection[str] = (),
) -> Training:
    """Train up to `steps`, from the checkpoint in the folder if there is one, else from the network of `start`."""
    training = begun(DetectionNetwork, DESCENT, folder, seed)
    with produced(partial(batch_maker, drives, real, without, seed), training.step // 2) as batches:
        if start is not None and training.step == 0:
            first = [as_tensors(next(batches)) for _ in range(NORMALISED)]
            training.begin_from(start, torch.cat([batch.rgb for batch in first]))
        training.run(batch_losses, used_twice(batches, training.step), folder, steps)
    return training


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
    without: Collection[str] = (),
) -> None:
    """Train up to `steps` and write the averaged network with what it was learned from.

    without: names of real sources that are held out. `float.onnx` is the network as it was learned, of one that began
    from another halfway between the two; `network.onnx` the same in 8-bit integers. A checkpoint of so many steps is
    written as it is.
    """
    training = train(drives, real, folder, steps, seed, start, without)
    images, library = training_images(drives, real, without), read_face_library(real)
    seen = provenance(images, library, seed, training.step)
    if training.begun_from:
        seen["begun from"] = training.begun_from
    export(training.average, folder / "float.onnx", seen)
    if start is not None:
        move_halfway(folder / "float.onnx", start)
    some = (image.rgb for image in images[:: max(1, len(images) // RANGED)])
    quantize(folder / "float.onnx", folder / "network.onnx", some)
