"""The detection network and the box network in PyTorch: their layers, losses and files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from training.detector_crops import DOUBTED, KNOWN, UNSURE, UNSURE_WEIGHTS
from training.quantization import LEVELS
from wayside.schemas.detections import LEARNED_COLORS, NONE, SHAPES
from wayside.stages.detection import (
    BOX_OUTPUT,
    BOX_VALUES,
    CENTRE_PX,
    COLOR_AT,
    IMAGE,
    INNER,
    MAPS,
    OFFSET_AT,
    OUTPUT,
    PATCHES,
    SHAPE_AT,
    SIDE,
    SIDE_PX,
    SIZES,
    STRIDE,
)


def layer(inputs: int, outputs: int, side: int = 3, stride: int = 1) -> nn.Sequential:
    """A convolution whose border is filled with zeros, and batch normalisation."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False), nn.BatchNorm2d(outputs)
    )


class Residual(nn.Module):  # type: ignore[misc]
    """Two 3 x 3 convolutions added to the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(layer(channels, channels), nn.ReLU(), layer(channels, channels))

    def forward(self, x: Tensor) -> Tensor:
        """The same shape."""
        return torch.relu(x + self.layers(x))


def write_onnx(
    network: nn.Module,
    path: Path,
    example: tuple[Tensor, ...],
    names: tuple[list[str], list[str]],
    free_axes: Mapping[str, Mapping[int, str]],
    properties: Mapping[str, Any],
) -> None:
    """Write a network as ONNX, in evaluation mode from then on; needs the package onnx.

    It is traced with an example. `names`: of inputs and of outputs. `free_axes`: axes of any length by input or output.
    """
    import onnx

    network.eval()
    torch.onnx.export(
        network,
        example,
        str(path),
        dynamo=False,
        input_names=names[0],
        output_names=names[1],
        dynamic_axes={name: dict(axes) for name, axes in free_axes.items()},
    )
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, {key: str(value) for key, value in properties.items()})
    onnx.save(model, str(path))


MAPS_CHANNELS, MAPS_BLOCKS, HEAD = (16, 40, 64, 80), (0, 2, 2, 2), 32
"""Filters and residual blocks at stride 4, 8, 16 and 32; filters of the head."""

PRIOR = 0.01
"""Probability of a middle that a cell starts with."""

CORNERS_WEIGHT, NAMES_WEIGHT = 2.0, 0.3
"""Weights of the loss of boxes, and of colour and shape, beside that of the heat map."""


class DetectionNetwork(nn.Module):  # type: ignore[misc]
    """RGB (n, height, width, 3) uint8, multiples of 32, to maps (n, `MAPS`, height / 4, width / 4)."""

    def __init__(self) -> None:
        super().__init__()
        first, *rest = MAPS_CHANNELS
        self.stem = nn.Sequential(
            layer(3, 16, 3, 2), nn.ReLU(), layer(16, first, 3, 2), nn.ReLU(), *_blocks(0)
        )
        self.down = nn.ModuleList(
            nn.Sequential(layer(before, after, 3, 2), nn.ReLU(), *_blocks(level + 1))
            for level, (before, after) in enumerate(zip(MAPS_CHANNELS, rest, strict=False))
        )
        self.across = nn.ModuleList(
            nn.Conv2d(after, before, 1) for before, after in zip(MAPS_CHANNELS, rest, strict=False)
        )
        self.smooth = nn.ModuleList(Residual(channels) for channels in MAPS_CHANNELS[1:-1])
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

    @staticmethod
    def losses(maps: Tensor, batch: Mapping[str, Tensor], *, sure: bool) -> dict[str, Tensor]:
        """Losses of heat, box, colour and shape by `Crop`, a face each; sure: negatives may be doubted."""
        faces = batch["weight"].sum().clamp(min=1.0)
        cell, weight = batch["cell"].long(), batch["weight"]
        box, color, shape = _at_cells(maps, cell)
        wide = maps.shape[-1]
        place = cell % (wide * maps.shape[-2])
        centre = torch.stack([place % wide, place // wide], -1).float() * STRIDE + STRIDE / 2
        overlap = _generalised_iou(_decoded(box, centre), batch["box"])
        return {
            "heat": _heat_loss(maps[:, :2], batch, sure=sure) / faces,
            "box": CORNERS_WEIGHT * ((1 - overlap) * weight).sum() / faces,
            "color": NAMES_WEIGHT * _weighted_class_loss(color, batch["color"], weight) / faces,
            "shape": NAMES_WEIGHT * _weighted_class_loss(shape, batch["shape"], weight) / faces,
        }

    def write(self, path: Path, provenance: Mapping[str, Any]) -> None:
        """Write the network as ONNX of free height and width, with its provenance as metadata."""
        write_onnx(
            self,
            path,
            (torch.zeros(1, 256, 512, 3, dtype=torch.uint8),),
            ([IMAGE], [OUTPUT]),
            {IMAGE: {1: "height", 2: "width"}, OUTPUT: {2: "rows", 3: "columns"}},
            provenance,
        )


def _blocks(level: int) -> list[Residual]:
    return [Residual(MAPS_CHANNELS[level]) for _ in range(MAPS_BLOCKS[level])]


def _heat_loss(heat: Tensor, batch: Mapping[str, Tensor], *, sure: bool) -> Tensor:
    """The focal loss of Zhou et al. with what is not known left out."""
    log_p, log_not = nn.functional.logsigmoid(heat), nn.functional.logsigmoid(-heat)
    p, target = log_p.exp(), batch["heat"].float()
    is_middle = target == 1
    known = (batch["doubt"] == KNOWN).float()
    below, above = UNSURE_WEIGHTS
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
    box, color, shape = rows.split([4, len(LEARNED_COLORS), len(SHAPES)], dim=-1)
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


def _weighted_class_loss(logits: Tensor, true: Tensor, weight: Tensor) -> Tensor:
    loss = nn.functional.cross_entropy(
        logits.flatten(0, 1), true.flatten(), ignore_index=NONE, reduction="none"
    )
    return (loss * weight.flatten()).sum()


CHANNELS, BLOCKS, HIDDEN, DROPOUT = (24, 48, 96, 128), (0, 1, 2, 1), 160, 0.2
"""Filters and residual blocks at 24, 12, 6 and 3 samples; units behind them, and the fraction dropped in training."""

USUAL_PX, USUAL_BRIGHTNESS = 24.0, 4.5
"""Height of a box, and logarithm of its brightness, that count as 0."""

OFFSET_WEIGHT, CLASS_WEIGHT, BEND = 0.5, 0.15, 0.05
"""Weights of the losses of offsets and of colour and shape; offset up to which its loss is a square."""


class BoxNetwork(nn.Module):  # type: ignore[misc]
    """Patches (n, 48, 48, 3) of log levels and sizes (n, 2) in pixels to values (n, `BOX_VALUES`)."""

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
        colors, brightness = relative_colors(patches)
        width, height = sizes.float().unbind(1)
        beside = [torch.log(height / USUAL_PX), torch.log(width / height)]
        beside.append(brightness - USUAL_BRIGHTNESS)
        seen = self.layers(colors).flatten(1)
        with torch.autocast(patches.device.type, enabled=False):
            return self.out(self.hidden(torch.cat([seen.float(), torch.stack(beside, 1)], 1)))

    @staticmethod
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

    def write(self, path: Path, provenance: Mapping[str, Any]) -> None:
        """Write the network as ONNX for any number of boxes, with its provenance as metadata."""
        write_onnx(
            self,
            path,
            (torch.zeros(2, SIDE, SIDE, 3), torch.ones(2, 2)),
            ([PATCHES, SIZES], [BOX_OUTPUT]),
            {name: {0: "boxes"} for name in (PATCHES, SIZES, BOX_OUTPUT)},
            provenance,
        )


def relative_colors(levels: Tensor) -> tuple[Tensor, Tensor]:
    """Colours (n, 3, 48, 48) of log levels (n, 48, 48, 3), and the log brightness (n,) of the box inside.

    Logarithms of red, green and blue over the mean of the box: illumination multiplies colours, so it is an offset of
    their logarithms.
    """
    edge = (SIDE - INNER) // 2
    inside = levels[:, edge : edge + INNER, edge : edge + INNER].mean((1, 2, 3))
    return (levels - inside[:, None, None, None]).permute(0, 3, 1, 2), inside


def _class_loss(scores: Tensor, true: Tensor) -> Tensor:
    loss = nn.functional.cross_entropy(scores, true, ignore_index=NONE, reduction="sum")
    return loss / (true != NONE).sum().clamp(min=1)
