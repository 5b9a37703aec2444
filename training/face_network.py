"""The face classifier in PyTorch: its learning, the temperature of its scores, and its export."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from training.network_parts import write_onnx
from wayside.stages.sign_codes import (
    CLASSES,
    FACE_OUTPUT,
    FACES,
    OTHER_FACE,
    OTHER_SHARE,
    PATCH_SIDE,
    face_samples,
)

FILTERS, HIDDEN = (16, 32, 64), 64
"""Filters of each layer, whose output is halved each way; units behind them."""

BATCH, EPOCHS, LEARNING_RATE, WEIGHT_DECAY, DROPOUT = 128, 6, 5e-3, 1e-2, 0.2
"""Patches of a batch, epochs, largest learning rate, weight decay, fraction of hidden units dropped."""

GREY, RESPONSE = 64, (2.0, 3.0, 1.5)
"""So many patches of a batch are seen once more by a grey sensor, whose response to red, green and blue is drawn from a
Dirichlet distribution: one that sees infrared shows red as white."""

SMOOTHING = 0.02
"""Part of the probability that is given to all classes alike."""

TEMPERATURES = tuple(np.geomspace(0.5, 4.0, 25).tolist())
"""By which log odds may be divided; the one of the best likelihood of the validated tracks is taken."""


class FaceNetwork(nn.Module):  # type: ignore[misc]
    """Samples (n, 3, 32, 32) of `face_samples` to scores (n, classes)."""

    def __init__(self, classes: Sequence[str]) -> None:
        super().__init__()
        self.classes = tuple(classes)
        layers: list[nn.Module] = []
        for before, after in zip((3, *FILTERS), FILTERS, strict=False):
            layers += [nn.Conv2d(before, after, 3, padding=1, bias=False), nn.BatchNorm2d(after)]
            layers += [nn.ReLU(), nn.MaxPool2d(2)]
        self.layers = nn.Sequential(*layers)
        samples = FILTERS[-1] * (PATCH_SIDE // 2 ** len(FILTERS)) ** 2
        self.hidden = nn.Sequential(nn.Linear(samples, HIDDEN), nn.ReLU(), nn.Dropout(DROPOUT))
        self.out = nn.Linear(HIDDEN, len(self.classes))

    def forward(self, samples: Tensor) -> Tensor:
        """Scores whose softmax is the probability of each class."""
        return self.out(self.hidden(self.layers(samples).flatten(1)))

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def log_probabilities(self, patches: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Log probability (n, classes) of each class for patches (n, 32, 32, 3)."""
        self.eval()
        scores = self(torch.from_numpy(face_samples(patches)))
        return np.asarray(torch.log_softmax(scores.double(), dim=1).numpy(), np.float64)


def fit(patches: NDArray[np.uint8], names: NDArray[np.str_], seed: int) -> FaceNetwork:
    """Fit the network to patches (n, 32, 32, 3) in colour and grey, and their classes (n,), drawn alike but `other`."""
    torch.manual_seed(seed)
    classes, target = np.unique(names, return_inverse=True)
    network = FaceNetwork(tuple(map(str, classes)))
    steps = round(EPOCHS * len(names) / BATCH)
    descent = torch.optim.AdamW(network.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    rate = torch.optim.lr_scheduler.OneCycleLR(
        descent, LEARNING_RATE, total_steps=steps, pct_start=0.15
    )
    other = OTHER_SHARE
    share = np.where(classes == OTHER_FACE, other, (1 - other) / max(len(classes) - 1, 1))
    weight = (share / np.bincount(target))[target]
    random = np.random.default_rng(seed)
    drawn = random.choice(len(names), (steps, BATCH), p=weight / weight.sum())
    for batch in drawn:
        rows = np.append(batch, batch[:GREY])
        seen = np.concatenate([patches[batch], in_grey(patches[batch[:GREY]], random)])
        found = network(torch.from_numpy(face_samples(seen)))
        loss = nn.functional.cross_entropy(
            found, torch.from_numpy(target[rows]), label_smoothing=SMOOTHING
        )
        descent.zero_grad()
        loss.backward()
        descent.step()
        rate.step()
    return network


def in_grey(patches: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
    """Patches (n, h, w, 3) as grey sensors of any response see them: three equal channels."""
    response = random.dirichlet(RESPONSE, len(patches))
    grey = np.rint(np.einsum("nhwc,nc->nhw", patches, response)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


@torch.no_grad()  # type: ignore[untyped-decorator]
def at_temperature(
    network: FaceNetwork, patches: NDArray[np.uint8], truth: NDArray[np.str_]
) -> None:
    """Divide its scores by the temperature of the best likelihood (Guo et al. 2017)."""
    column = [network.classes.index(name) for name in truth]
    scores = network.log_probabilities(patches)

    def likelihood(temperature: float) -> float:
        divided = scores / temperature
        return float(
            (divided[range(len(column)), column] - np.logaddexp.reduce(divided, axis=1)).mean()
        )

    best = max(TEMPERATURES, key=likelihood)
    for values in network.out.parameters():
        values.div_(best)


def export(network: FaceNetwork, path: Path, provenance: str) -> None:
    """Write the network as ONNX, with its classes and provenance as metadata; needs the package onnx."""
    write_onnx(
        network,
        path,
        (torch.zeros(2, 3, PATCH_SIDE, PATCH_SIDE),),
        ([FACES], [FACE_OUTPUT]),
        {name: {0: "faces"} for name in (FACES, FACE_OUTPUT)},
        {"provenance": provenance, CLASSES: "\n".join(network.classes)},
    )
