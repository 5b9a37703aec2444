"""Training of the box network on boxes of crops of rendered and real images.

    python -m wayside.pipeline.learn --drives FOLDER --real FOLDER -o FOLDER --box-steps N --network NETWORK.onnx

Weights start at random, or with `--begin-from BOX.onnx` where those of an earlier network ended. The losses of the
curve are those of the sides of a panel, of offsets, colour and shape.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wayside.pipeline.learning.box_network import BoxNetwork, export, losses
from wayside.pipeline.learning.box_samples import BoxSamples, samples_of
from wayside.pipeline.learning.camera_effects import make_noise
from wayside.pipeline.learning.detector_training import (
    drawing_probability,
    provenance,
    training_images,
)
from wayside.pipeline.learning.face_drawings import read_face_library
from wayside.pipeline.learning.network_training import Arrays, Descent, Make, begun, produced
from wayside.pipeline.learning.quantization import quantize_boxes
from wayside.stages.detection import DetectionNetwork

BATCH, DESCENT = 256, Descent(2e-3, warm_up=300, largest_gradient=5.0)
"""Boxes of a batch, and how weights follow its gradient."""

CROPS = 64
"""Crops whose boxes are made together; they give some 30 boxes each."""

SEEN = ("patch", "size")
"""Columns that the network sees."""

POOL = 120_000
"""The last boxes that were made, from which batches are drawn: boxes of one crop are alike."""

RANGED = 16
"""Sets of boxes that tell the range of values of the network in 8-bit integers."""


def sample_maker(
    drives: Path | None, real: Path, without: Collection[str], network: Path, seed: int
) -> Make:
    """What makes the boxes of `CROPS` crops by their number: with its seed, a number says all."""
    images, library = training_images(drives, real, without), read_face_library(real)
    probability = drawing_probability(images)
    noise = make_noise(np.random.default_rng(seed))
    proposing = DetectionNetwork(str(network))

    def make(number: int) -> Arrays:
        rng = np.random.default_rng([seed, number])
        drawn = rng.choice(len(images), CROPS, p=probability)
        return BoxSamples.joined(
            [samples_of(images[k], proposing, library, noise, rng) for k in drawn.tolist()]
        )

    return make


def batches_of(samples: Iterator[Arrays], seed: int, step: int) -> Iterator[Arrays]:
    """Batches drawn from the last `POOL` boxes; new ones are taken as fast as they are learned from."""
    rng = np.random.default_rng([seed, step])
    pool = next(samples)
    place: int | NDArray[np.int64]
    at, due = 0, 0
    while True:
        while due <= 0:
            new = next(samples)
            count, held = len(new["color"]), len(pool["color"])
            if held < POOL:
                pool = {name: np.concatenate([pool[name], new[name]]) for name in pool}
            else:
                place = (at + np.arange(count)) % held
                for name, column in pool.items():
                    column[place] = new[name]
                at = (at + count) % held
            due += count
        rows = rng.integers(0, len(pool["color"]), BATCH)
        yield {name: column[rows] for name, column in pool.items()}
        due -= BATCH


def batch_losses(network: nn.Module, batch: Arrays, step: int) -> dict[str, Tensor]:
    """The losses of a network on a batch."""
    held = {name: torch.from_numpy(column) for name, column in batch.items()}
    with torch.autocast("cpu", torch.bfloat16):
        values = network(*(held[name] for name in SEEN))
    return losses(values.float(), held)


def learn_box_network(
    drives: Path | None,
    real: Path,
    folder: Path,
    steps: int,
    seed: int,
    network: Path,
    start: Path | None = None,
    without: Collection[str] = (),
) -> None:
    """Train up to `steps` and write the averaged network with what it was learned from.

    network: the detection network whose boxes it learns to classify; start: the box network to begin from;
    without: names of real sources that are held out.
    `box_float.onnx` is the network as it was learned, `box.onnx` the same in 8-bit integers. A checkpoint of so many
    steps is written as it is.
    """
    training = begun(BoxNetwork, DESCENT, folder, seed)
    make = partial(sample_maker, drives, real, without, network, seed)
    with produced(make, training.step) as samples:
        ranges = [next(samples) for _ in range(RANGED)]
        if start is not None and training.step == 0:
            seen = (
                torch.from_numpy(np.concatenate([one[name] for one in ranges])) for name in SEEN
            )
            training.begin_from(start, *seen)
        training.run(batch_losses, batches_of(samples, seed, training.step), folder, steps)
    images, library = training_images(drives, real, without), read_face_library(real)
    said = provenance(images, library, seed, training.step)
    if training.begun_from:
        said["begun from"] = training.begun_from
    said["crops"] = f"boxes of about {training.step * BATCH // 30}"
    export(training.average, folder / "box_float.onnx", said)
    quantize_boxes(folder / "box_float.onnx", folder / "box.onnx", ranges)
