"""Learning of the patch CNN from the boxes that score high enough by the trees; fitted by PyTorch.

Patches are augmented each time they are drawn: mirrored, brighter, paler, softer, noisier, moved. There are few faces,
and fewer kinds of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import needs
from wayside.pipeline.learning.samples import OFF, ON
from wayside.schemas.errors import InputError
from wayside.schemas.models import ConvolutionModel
from wayside.stages.detection import (
    INNER,
    PATCH_CNN_FEATURES,
    PATCH_DARK_LEVEL,
    SIDE,
    patch_log_odds,
)

FILTERS, POOLED, HIDDEN = (24, 32, 64), (True, True, True), 96
"""Filters of each layer, the layers that are halved, units behind them."""

BATCH, ROUNDS, LEARNING_RATE, WEIGHT_DECAY, DROPOUT = 256, 3.5, 4e-3, 1e-2, 0.3
"""Patches of a batch, epochs, largest learning rate, weight decay, fraction of hidden units dropped."""

TOGETHER = 4096
"""Boxes that are evaluated at once after the learning."""

REAL_FRACTION = 0.25
"""Fraction of the drawn patches that are of real images."""

WHOLE, NONE = 0.75, 0.25
"""Overlap (IoU) with a face from which a box is all right, and at which it would be all wrong."""

BRIGHTNESS = (4.5, 0.6)
"""Mean and scatter of the brightness of boxes, as `relative_colors` gives it: it is altered with the patch."""

FARTHEST = 4.0
"""Standard deviations at which a feature is cut off."""

EXPOSURE, CONTRAST, SATURATION, TINT, NOISE, SOFT_FRACTION = 0.25, 0.25, 0.25, 0.05, 6.0, 0.3
"""How patches are altered: sigmas of the logarithms of exposure, contrast, saturation, channel gains; noise in grey
values at most; fraction that is blurred."""
MOVED, STRETCHED, MIDDLE_GREY = 0.04, 0.05, 100.0
"""Sigmas of how far patches are moved and stretched, in half sides; the grey that contrast leaves."""


@dataclass(frozen=True, slots=True)
class PatchSamples:
    """Boxes of one drive, n rows: patches (n, 32, 32, 3) uint8, placement (n, 6), label, overlap and face.

    name: of the drive; rows (n,): which of its candidates; trees (n,): out-of-fold log odds by the trees.
    """

    name: str
    rows: NDArray[np.int64]
    patches: NDArray[np.uint8]
    placement: NDArray[np.float32]
    trees: NDArray[np.float32]
    label: NDArray[np.int8]
    overlap: NDArray[np.float32]
    face: NDArray[np.int32]
    real: bool


def fit_patch_cnn(samples: Sequence[PatchSamples], near: float, seed: int) -> ConvolutionModel:
    """Fit the network; as many faces as other boxes are drawn, so its log odds must be `calibrated`.

    A box counts as a face as far as it is drawn round it, so that the best of several boxes is the one that fits.

    Raises
    ------
    InputError
        Without boxes on faces, or off them.
    UsageError
        Without PyTorch, which only the learning needs.
    """
    torch = _torch()
    torch.manual_seed(seed)
    patches = torch.from_numpy(np.concatenate([one.patches for one in samples]))
    placement = np.concatenate([one.placement for one in samples])
    label = np.concatenate([one.label for one in samples])
    overlap = np.concatenate([one.overlap for one in samples])
    share = np.clip((overlap - NONE) / (WHOLE - NONE), 0, 1)
    target = torch.from_numpy(np.where(label == ON, share, 0).astype(np.float32))
    mean, scale = placement.mean(axis=0), placement.std(axis=0) + 1e-3
    mean, scale = np.append(mean, BRIGHTNESS[0]), np.append(scale, BRIGHTNESS[1])
    scaled = torch.from_numpy((placement - mean[:-1]) / scale[:-1])

    layers, head = _network(torch, placement.shape[1] + 1)
    weights = [*layers.parameters(), *head.parameters()]
    steps = max(round(ROUNDS * len(label) / BATCH), 1)
    descent = torch.optim.AdamW(weights, lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    learning_rate = torch.optim.lr_scheduler.OneCycleLR(
        descent, LEARNING_RATE, total_steps=steps, pct_start=0.15
    )
    rng = np.random.default_rng(seed)
    drawn = [
        rng.choice(len(label), (steps, BATCH // 2), p=probability)
        for probability in sampling_probabilities(samples)
    ]
    for rows in np.concatenate(drawn, axis=1):
        chosen = torch.from_numpy(rows)
        colors, bright = _relative(torch, _altered(torch, patches[chosen]))
        features = torch.cat([scaled[chosen], (bright[:, None] - mean[-1]) / scale[-1]], 1)
        joined = [
            layers(colors).permute(0, 2, 3, 1).flatten(1),
            features.clamp(-FARTHEST, FARTHEST),
        ]
        found = head(torch.cat(joined, 1).float())[:, 0]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(found, target[chosen])
        descent.zero_grad()
        loss.backward()
        descent.step()
        learning_rate.step()
    return _exported(layers, head, mean, scale, near)


def sampling_probabilities(
    samples: Sequence[PatchSamples],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probability (n,) of each box to be drawn as a face, and of each to be drawn as none; each sums to 1.

    A face of few boxes is drawn more often than its boxes would be; a box of a real image more often than one of a
    drive. Raises InputError where there is nothing of either kind.
    """
    faces, others = [], []
    for one in samples:
        on = one.label == ON
        weight = np.zeros(len(on))
        _, which, count = np.unique(one.face[on], return_inverse=True, return_counts=True)
        weight[on] = 1 / np.sqrt(count[which])
        faces.append(_of_source(weight, one))
        others.append(_of_source((one.label == OFF).astype(np.float64), one))
    real = np.concatenate([np.full(len(one.label), one.real) for one in samples])
    for what, weights in (("on faces", faces), ("off faces", others)):
        if not np.concatenate(weights).any():
            raise InputError(
                f"patch CNN: wanted boxes {what} that score high enough by the trees, found none; add drives"
            )
    return _even_sources(np.concatenate(faces), real), _even_sources(np.concatenate(others), real)


def _of_source(weight: NDArray[np.float64], one: PatchSamples) -> NDArray[np.float64]:
    """Sources of real images differ much in size: a large one counts by the square root of it."""
    return weight / np.sqrt(max(weight.sum(), 1.0)) if one.real else weight


def _even_sources(weight: NDArray[np.float64], real: NDArray[np.bool_]) -> NDArray[np.float64]:
    probability = np.zeros_like(weight)
    for which, share in ((real, REAL_FRACTION), (~real, 1 - REAL_FRACTION)):
        probability[which] = share * weight[which] / max(weight[which].sum(), 1e-9)
    return np.asarray(probability / probability.sum())


def cnn_log_odds(model: ConvolutionModel, samples: PatchSamples) -> NDArray[np.float32]:
    """Output (n,) of a network for each box."""
    parts = [np.zeros(0, np.float32)]
    for first in range(0, len(samples.rows), TOGETHER):
        some = slice(first, first + TOGETHER)
        parts.append(patch_log_odds(model, samples.patches[some], samples.placement[some]))
    return np.concatenate(parts)


def calibrated(
    model: ConvolutionModel, tree_weight: float, slope: float, shift: float
) -> ConvolutionModel:
    """The network whose log odds are `slope` times as large, plus `shift`, beside that part of the trees'."""
    return replace(
        model,
        tree_weight=tree_weight,
        output=np.float32(slope) * model.output,
        output_bias=np.asarray(slope * model.output_bias + shift, np.float32),
    )


def _network(torch: Any, placement: int) -> tuple[Any, Any]:
    nn, layers, channels = torch.nn, [], 3
    for filters, pooled in zip(FILTERS, POOLED, strict=True):
        layers += [nn.Conv2d(channels, filters, 3, padding=1, bias=False), nn.BatchNorm2d(filters)]
        layers += [nn.ReLU(), *([nn.MaxPool2d(2)] if pooled else [])]
        channels = filters
    samples = channels * (SIDE // 2 ** sum(POOLED)) ** 2
    head = nn.Sequential(
        nn.Linear(samples + placement, HIDDEN), nn.ReLU(), nn.Dropout(DROPOUT), nn.Linear(HIDDEN, 1)
    )
    return nn.Sequential(*layers), head


def _relative(torch: Any, patches: Any) -> tuple[Any, Any]:
    """What `relative_colors` does, on patches (n, 3, 32, 32) of numbers."""
    red, green, blue = torch.log(patches + PATCH_DARK_LEVEL).unbind(1)
    bright = torch.log(patches.mean(1) + PATCH_DARK_LEVEL)
    edge = (SIDE - INNER) // 2
    middle = bright[:, edge : edge + INNER, edge : edge + INNER].mean((1, 2))
    return torch.stack([bright - middle[:, None, None], red - green, blue - green], 1), middle


def _altered(torch: Any, patches: Any) -> Any:
    """Patches (n, 32, 32, 3) of bytes, each augmented: (n, 3, 32, 32) numbers."""
    shown = patches.permute(0, 3, 1, 2).float()
    n = len(shown)

    def factor(sigma: float, channels: int = 1) -> Any:
        return torch.exp(torch.randn(n, channels, 1, 1) * sigma)

    mirrored = torch.rand(n) < 0.5
    shown[mirrored] = shown[mirrored].flip(3)
    shown = shown * factor(EXPOSURE) * factor(TINT, 3)
    shown = (shown - MIDDLE_GREY) * factor(CONTRAST) + MIDDLE_GREY
    grey = shown.mean(1, keepdim=True)
    shown = grey + (shown - grey) * factor(SATURATION)
    soft = torch.rand(n) < SOFT_FRACTION
    line = torch.tensor([0.25, 0.5, 0.25])
    kernel = (line[:, None] * line)[None, None].repeat(3, 1, 1, 1)
    wide = torch.nn.functional.pad(shown[soft], (1, 1, 1, 1), mode="replicate")
    shown[soft] = torch.nn.functional.conv2d(wide, kernel, groups=3)
    shown = shown + torch.randn(shown.shape) * torch.rand(n, 1, 1, 1) * NOISE
    motion = torch.zeros(n, 2, 3)
    motion[:, 0, 0] = 1 + torch.randn(n) * STRETCHED
    motion[:, 1, 1] = 1 + torch.randn(n) * STRETCHED
    motion[:, :, 2] = torch.randn(n, 2) * MOVED
    grid = torch.nn.functional.affine_grid(motion, shown.shape, align_corners=False)
    return torch.nn.functional.grid_sample(
        shown.clamp(0, 255), grid, padding_mode="border", align_corners=False
    )


def _exported(
    layers: Any, head: Any, mean: NDArray[Any], scale: NDArray[Any], near: float
) -> ConvolutionModel:
    """The fitted network as a model of ours."""
    filters, biases = folded_filters(layers)
    first, last = head[0], head[3]
    return ConvolutionModel(
        PATCH_CNN_FEATURES,
        SIDE,
        near,
        0.0,
        FARTHEST,
        filters,
        biases,
        POOLED,
        np.asarray(mean, np.float32),
        np.asarray(scale, np.float32),
        _array(first.weight.T),
        _array(first.bias),
        _array(last.weight[0]),
        _array(last.bias[0]),
        "",
    )


def folded_filters(
    layers: Any,
) -> tuple[tuple[NDArray[np.float32], ...], tuple[NDArray[np.float32], ...]]:
    """Filters (3, 3, in, out) and biases (out,) of layers: what they normalise by is part of their filters."""
    filters, biases = [], []
    pairs = [layer for layer in layers if hasattr(layer, "weight")]
    for convolution, norm in zip(pairs[::2], pairs[1::2], strict=True):
        gain = norm.weight / (norm.running_var + norm.eps).sqrt()
        folded = (convolution.weight * gain[:, None, None, None]).permute(2, 3, 1, 0)
        filters.append(_array(folded))
        biases.append(_array(norm.bias - norm.running_mean * gain))
    return tuple(filters), tuple(biases)


def _array(tensor: Any) -> NDArray[np.float32]:
    return np.array(tensor.detach().numpy(), np.float32, order="C")


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise needs("PyTorch") from error
    return torch
