"""The box network in PyTorch: a residual network on a patch, its losses, and its export."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from training.network_parts import Residual, layer, write_onnx
from wayside.schemas.detections import NONE
from wayside.stages.detection import (
    BOX_OUTPUT,
    BOX_VALUES,
    COLOR_AT,
    INNER,
    OFFSET_AT,
    PATCHES,
    SHAPE_AT,
    SIDE,
    SIZES,
)

CHANNELS, BLOCKS, HIDDEN, DROPOUT = (24, 48, 96, 128), (0, 1, 2, 1), 160, 0.2
"""Filters and residual blocks at 24, 12, 6 and 3 samples; units behind them, and the fraction dropped in training."""

PATCH_DARK_LEVEL = 16.0
"""Added to a grey value before its logarithm, so that noise of dark pixels is no contrast."""

USUAL_PX, USUAL_BRIGHTNESS = 24.0, 4.5
"""Height of a box, and logarithm of its brightness, that count as 0."""

OFFSET_WEIGHT, CLASS_WEIGHT, BEND = 0.5, 0.15, 0.05
"""Weights of the losses of offsets and of colour and shape; offset up to which its loss is a square."""


class BoxNetwork(nn.Module):  # type: ignore[misc]
    """Patches (n, 48, 48, 3) of levels 0 to 255 and sizes (n, 2) in pixels to values (n, `BOX_VALUES`)."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for level, (before, after) in enumerate(zip((3, *CHANNELS), CHANNELS, strict=False)):
            layers += [layer(before, after, stride=2), nn.ReLU()]
            layers += [Residual(after) for _ in range(BLOCKS[level])]
        self.layers = nn.Sequential(*layers)
        samples = CHANNELS[-1] * (SIDE // 16) ** 2
        self.hidden = nn.Sequential(nn.Linear(samples + 3, HIDDEN), nn.ReLU(), nn.Dropout(DROPOUT))
        self.out = nn.Linear(HIDDEN, BOX_VALUES)

    def forward(self, patches: Tensor, sizes: Tensor) -> Tensor:
        """Values in the order of `stages.detection.box_network`."""
        colors, brightness = relative_colors(patches.float())
        width, height = sizes.float().unbind(1)
        beside = [torch.log(height / USUAL_PX), torch.log(width / height)]
        beside.append(brightness - USUAL_BRIGHTNESS)
        seen = self.layers(colors).flatten(1)
        with torch.autocast(patches.device.type, enabled=False):
            return self.out(self.hidden(torch.cat([seen.float(), torch.stack(beside, 1)], 1)))


def relative_colors(patches: Tensor) -> tuple[Tensor, Tensor]:
    """Colours (n, 3, 48, 48) of patches (n, 48, 48, 3), and the log brightness (n,) of the box inside.

    Logarithms of red, green and blue over the mean of the box: illumination multiplies colours, so it is an offset of
    their logarithms.
    """
    levels = torch.log(patches + PATCH_DARK_LEVEL)
    edge = (SIDE - INNER) // 2
    inside = levels[:, edge : edge + INNER, edge : edge + INNER].mean((1, 2, 3))
    return (levels - inside[:, None, None, None]).permute(0, 3, 1, 2), inside


def losses(values: Tensor, batch: dict[str, Tensor]) -> dict[str, Tensor]:
    """Losses of the sides of a panel, of offsets, of colour and of shape; the columns of `BoxTargets`."""
    panel = nn.functional.binary_cross_entropy_with_logits(
        values[:, :OFFSET_AT], batch["panel"], reduction="none"
    )
    near = ~torch.isnan(batch["offset"][:, 0])
    wanted = torch.nan_to_num(batch["offset"])
    moved = nn.functional.smooth_l1_loss(
        values[:, OFFSET_AT:COLOR_AT], wanted, reduction="none", beta=BEND
    )
    return {
        "panel": (panel * batch["weight"]).sum() / len(values),
        "offset": OFFSET_WEIGHT * (moved.sum(1) * near).sum() / near.sum().clamp(min=1),
        "color": CLASS_WEIGHT * _class_loss(values[:, COLOR_AT:SHAPE_AT], batch["color"]),
        "shape": CLASS_WEIGHT * _class_loss(values[:, SHAPE_AT:], batch["shape"]),
    }


def _class_loss(scores: Tensor, true: Tensor) -> Tensor:
    loss = nn.functional.cross_entropy(scores, true, ignore_index=NONE, reduction="sum")
    return loss / (true != NONE).sum().clamp(min=1)


def export(network: BoxNetwork, path: Path, provenance: dict[str, Any]) -> None:
    """Write the network as ONNX for any number of boxes, with its provenance as metadata; needs the package onnx."""
    write_onnx(
        network,
        path,
        (torch.zeros(2, SIDE, SIDE, 3, dtype=torch.uint8), torch.ones(2, 2)),
        ([PATCHES, SIZES], [BOX_OUTPUT]),
        {name: {0: "boxes"} for name in (PATCHES, SIZES, BOX_OUTPUT)},
        provenance,
    )
