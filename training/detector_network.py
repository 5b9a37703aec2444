"""The detection network in PyTorch: fully convolutional, one set of maps at a quarter of the image's size.

A residual network down to stride 32 and a feature pyramid back up to stride 4. For each cell, the network gives the
probability of the middle of a face seen from the front or from behind (centre points after Zhou, Wang and Kraehenbuehl
2019, "Objects as points"). It also gives the box of that face, and its colour and shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from training.detector_crops import KNOWN, UNSURE
from training.network_parts import Residual, layer, write_onnx
from training.onnx_rewriting import LEVELS
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.stages.detection import CENTRE_PX, IMAGE, MAPS, OUTPUT, SIDE_PX, STRIDE

CHANNELS, BLOCKS, HEAD = (16, 40, 64, 80), (0, 2, 2, 2), 32
"""Filters and residual blocks at stride 4, 8, 16 and 32; filters of the head."""

PRIOR = 0.01
"""Probability of a middle that a cell starts with."""

DOUBTED, DOUBTED_WEIGHTS = 0.3, (0.5, 0.2)
"""Where an image's boxes may be incomplete: probability from which a cell off them may show a sign without a box;
weights of the cell as a negative below and above it."""

BOX_WEIGHT, CLASS_WEIGHT = 2.0, 0.3
"""Weights of the loss of boxes, and of colour and shape, beside that of the heat map."""


class DetectionNetwork(nn.Module):  # type: ignore[misc]
    """RGB (n, height, width, 3) uint8, multiples of 32, to maps (n, `MAPS`, height / 4, width / 4)."""

    def __init__(self) -> None:
        super().__init__()
        first, *rest = CHANNELS
        self.stem = nn.Sequential(
            layer(3, 16, 3, 2), nn.ReLU(), layer(16, first, 3, 2), nn.ReLU(), *_blocks(0)
        )
        self.down = nn.ModuleList(
            nn.Sequential(layer(before, after, 3, 2), nn.ReLU(), *_blocks(level + 1))
            for level, (before, after) in enumerate(zip(CHANNELS, rest, strict=False))
        )
        self.across = nn.ModuleList(
            nn.Conv2d(after, before, 1) for before, after in zip(CHANNELS, rest, strict=False)
        )
        self.smooth = nn.ModuleList(Residual(channels) for channels in CHANNELS[1:-1])
        self.up = nn.Upsample(scale_factor=2, mode="nearest")
        self.head = nn.Sequential(layer(first, HEAD, 3), nn.ReLU())
        self.maps = nn.Conv2d(HEAD, MAPS, 1)
        with torch.no_grad():
            self.maps.weight.mul_(0.3)
            self.maps.bias.zero_()
            self.maps.bias[:2] = torch.logit(torch.tensor(PRIOR))

    def forward(self, x: Tensor) -> Tensor:
        """Maps in the order of `network_proposals`: heat of fronts and backs as log odds, box, colour, shape."""
        levels = [self.stem(x.permute(0, 3, 1, 2).float() / LEVELS)]
        for down in self.down:
            levels.append(down(levels[-1]))
        found = levels[-1]
        for level in (2, 1, 0):
            found = levels[level] + self.up(self.across[level](found))
            if level:
                found = self.smooth[level - 1](found)
        found = self.head(found)
        with torch.autocast(x.device.type, enabled=False):
            return self.maps(found.float())


def _blocks(level: int) -> list[Residual]:
    return [Residual(CHANNELS[level]) for _ in range(BLOCKS[level])]


def losses(maps: Tensor, batch: Mapping[str, Tensor], *, sure: bool) -> dict[str, Tensor]:
    """Heat, box, colour and shape losses, a face each. `batch`: fields of `Crop`. `sure`: negatives may be doubted."""
    faces = batch["weight"].sum().clamp(min=1.0)
    cell, weight = batch["cell"].long(), batch["weight"]
    box, color, shape = _at_cells(maps, cell)
    wide = maps.shape[-1]
    place = cell % (wide * maps.shape[-2])
    centre = torch.stack([place % wide, place // wide], -1).float() * STRIDE + STRIDE / 2
    overlap = _generalised_iou(_decoded(box, centre), batch["box"])
    return {
        "heat": _heat_loss(maps[:, :2], batch, sure=sure) / faces,
        "box": BOX_WEIGHT * ((1 - overlap) * weight).sum() / faces,
        "color": CLASS_WEIGHT * _class_loss(color, batch["color"], weight) / faces,
        "shape": CLASS_WEIGHT * _class_loss(shape, batch["shape"], weight) / faces,
    }


def _heat_loss(heat: Tensor, batch: Mapping[str, Tensor], *, sure: bool) -> Tensor:
    """The focal loss of Zhou et al. with what is not known left out."""
    log_p, log_not = nn.functional.logsigmoid(heat), nn.functional.logsigmoid(-heat)
    p, target = log_p.exp(), batch["heat"].float()
    is_middle = target == 1
    known = (batch["doubt"] == KNOWN).float()
    below, above = DOUBTED_WEIGHTS
    unsure = (batch["doubt"] == UNSURE).float() * below
    if sure:
        unsure = unsure * torch.where(p.detach() < DOUBTED, 1.0, above / below)
    negative = (1 - target) ** 4 * p**2 * log_not * (known + unsure)
    positive = (1 - p) ** 2 * log_p
    return -torch.where(is_middle, positive, negative).sum()


def _at_cells(maps: Tensor, cell: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Box (n, k, 4), colour (n, k, c) and shape (n, k, s) at the regressed cells."""
    place = cell % (maps.shape[-1] * maps.shape[-2])
    flat = maps[:, 2:].flatten(2)
    rows = flat.gather(2, place[:, None].expand(-1, flat.shape[1], -1)).transpose(1, 2)
    box, color, shape = rows.split([4, len(COLORS), len(SHAPES)], dim=-1)
    return box, color, shape


def _decoded(box: Tensor, centre: Tensor) -> Tensor:
    """Corners, pixels, of boxes as the maps give them; see `network_proposals`."""
    middle = centre + CENTRE_PX * box[..., :2]
    half = SIDE_PX / 2 * box[..., 2:].clamp(-4, 5).exp()
    return torch.cat([middle - half, middle + half], -1)


def _generalised_iou(found: Tensor, true: Tensor) -> Tensor:
    """IoU less the part of the enclosing box that neither fills (Rezatofighi et al. 2019)."""
    shared = _area(
        torch.maximum(found[..., :2], true[..., :2]), torch.minimum(found[..., 2:], true[..., 2:])
    )
    around = _area(
        torch.minimum(found[..., :2], true[..., :2]), torch.maximum(found[..., 2:], true[..., 2:])
    )
    both = _area(found[..., :2], found[..., 2:]) + _area(true[..., :2], true[..., 2:]) - shared
    return shared / both.clamp(min=1e-3) - 1 + both / around.clamp(min=1e-3)


def _area(low: Tensor, high: Tensor) -> Tensor:
    wide, tall = (high - low).clamp(min=0).unbind(-1)
    return wide * tall  # prod() asks the processor for zeros on its way back


def _class_loss(logits: Tensor, true: Tensor, weight: Tensor) -> Tensor:
    loss = nn.functional.cross_entropy(
        logits.flatten(0, 1), true.flatten(), ignore_index=NONE, reduction="none"
    )
    return (loss * weight.flatten()).sum()


def export(network: DetectionNetwork, path: Path, provenance: dict[str, Any]) -> None:
    """Write the network as ONNX of free height and width, with its provenance as metadata; needs the package onnx."""
    write_onnx(
        network,
        path,
        (torch.zeros(1, 256, 512, 3, dtype=torch.uint8),),
        ([IMAGE], [OUTPUT]),
        {IMAGE: {1: "height", 2: "width"}, OUTPUT: {2: "rows", 3: "columns"}},
        provenance,
    )
