"""The weights of a network from its ONNX file, in floating point or in 8-bit integers.

A file for running has no batch normalisation any more: its factors are part of the convolutions. To learn on, each
normalisation gets the mean and the deviation that its layer has on some images, and the factors that undo them, so that
the network says what the file says.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wayside.pipeline.learning.onnx_rewriting import is_paired, single_kernel
from wayside.schemas.errors import InputError
from wayside.stages.detection import BIAS, WEIGHT

LAYERS = ("Conv", "Gemm")
"""Operators of an ONNX file that have weights: convolutions and full layers."""


def read_layers(path: Path) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Weights (outputs, inputs, k, k) or (outputs, inputs) and biases (outputs,) of an ONNX file, in its order."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load(str(path)).graph
    stored = {one.name: numpy_helper.to_array(one) for one in graph.initializer}
    scaled = {
        node.output[0]: [stored[name] for name in node.input]
        for node in graph.node
        if node.op_type == "DequantizeLinear" and node.input[0] in stored
    }

    def values(name: str) -> NDArray[np.float32]:
        if name not in scaled:
            return np.array(stored[name], np.float32)
        number, scale, zero = scaled[name]
        axes = (-1,) + (1,) * (number.ndim - 1)
        centred = number.astype(np.float32) - zero.astype(np.float32).reshape(axes)
        return np.asarray(centred * scale.astype(np.float32).reshape(axes), np.float32)

    layers = [
        _single(values(node.input[1]), values(node.input[2]))
        for node in graph.node
        if node.op_type in LAYERS
    ]
    if WEIGHT in stored:  # the last layer is split
        layers.append((stored[WEIGHT][:, :, None, None], stored[BIAS]))
    return layers


def _single(
    weight: NDArray[np.float32], bias: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Weights and biases of a layer as it was learned, if it was rewritten to make two columns at once."""
    if not is_paired(weight):
        return weight, bias
    kernel = single_kernel(weight)
    return kernel, bias[: len(kernel)]


def load_weights(network: nn.Module, path: Path, *inputs: Tensor) -> None:
    """Give a network the weights of an ONNX file of the same layers, in place.

    inputs: what the network sees, by which the normalisations are set. The layers are taken in the order in which that
    passes them.

    Raises
    ------
    InputError
        Where the file has other layers.
    """
    stored = read_layers(path)
    taken = 0
    bias: Tensor | None = None

    def before(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        nonlocal taken, bias
        if taken >= len(stored) or stored[taken][0].shape != tuple(module.weight.shape):
            raise InputError(f"{path}: wanted the layers of this network, found others")
        weights, biases = stored[taken]  # of a file, which may not be written
        module.weight.copy_(torch.tensor(weights))
        bias = torch.tensor(biases)
        if module.bias is not None:
            module.bias.copy_(bias)
        taken += 1

    def normalise(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        mean = inputs[0].mean((0, 2, 3))
        variance = inputs[0].var((0, 2, 3), correction=0)
        module.running_mean.copy_(mean)
        module.running_var.copy_(variance)
        module.weight.copy_((variance + module.eps).sqrt())
        module.bias.copy_(mean + bias)

    hooks = [
        module.register_forward_pre_hook(
            normalise if isinstance(module, nn.BatchNorm2d) else before
        )
        for module in network.modules()
        if isinstance(module, nn.Conv2d | nn.Linear | nn.BatchNorm2d)
    ]
    try:
        with torch.no_grad():
            network.eval()
            network(*inputs)
    finally:
        for hook in hooks:
            hook.remove()
    if taken != len(stored):
        raise InputError(f"{path}: wanted {taken} layers, found {len(stored)}")
