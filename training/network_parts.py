"""Layers that the networks are made of, and how they are written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn


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
    """Write a network as ONNX; needs the package onnx.

    Parameters
    ----------
    network, path
        The network, which is in evaluation mode afterwards, and the file.
    example
        Inputs that it is traced with.
    names
        Of the inputs and of the outputs.
    free_axes
        Axes of any length, by name of input or output.
    properties
        Metadata of the file.
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
