"""Networks in 8-bit integers: a third of the time of floating point, nearly the same output.

Every tensor between two layers is a scale times numbers of 0 to 255. Weights are a scale of their filter times numbers
of -64 to 63 (Jacob et al. 2018, "Quantization and training of neural networks for efficient integer-arithmetic-only
inference"). The scales come from the least and the largest value of a tensor over some of what the network was learned
from. The last layer stays as it is: its log odds would be steps of 0.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from training.onnx_rewriting import LEVELS, rewrite
from wayside.pipeline.models.model_files import onnx_metadata
from wayside.stages.detection import IMAGE, MULTIPLE, PATCHES, SIZES, padded

LAST_LAYER = "/maps/Conv"
"""The last layer of the detection network, by the name that its export gives it."""

LAYERS = "/layers/"
"""Start of the names of the layers of the box network whose numbers are integers."""

Feed = dict[str, NDArray[Any]]


class _Feeds:
    """Inputs of a network one after the other; a `CalibrationDataReader` of onnxruntime."""

    def __init__(self, feeds: Iterable[Feed]) -> None:
        self._feeds = iter(feeds)

    def get_next(self) -> Feed | None:
        """The next input; None after the last."""
        return next(self._feeds, None)


def quantize(source: Path, target: Path, images: Iterable[NDArray[np.uint8]]) -> None:
    """Write the detection network of an ONNX file in 8 bits, with the metadata of that file.

    images: (height, width, 3), any size, 32 px and more; needs the package onnx.
    """
    # without white the steps of the input are others
    white = np.full((MULTIPLE, MULTIPLE, 3), LEVELS, np.uint8)
    feeds = ({IMAGE: padded(rgb)} for rgb in chain([white], images))
    _quantize(source, target, feeds, lambda name: name == LAST_LAYER)


def quantize_boxes(source: Path, target: Path, samples: Iterable[Feed]) -> None:
    """The same of a box network; samples: `patch` and `size` of boxes, few at a time: all layers are held at once."""
    feeds = ({PATCHES: one["patch"], SIZES: one["size"]} for one in samples)
    _quantize(source, target, feeds, lambda name: not name.startswith(LAYERS))


def _quantize(
    source: Path, target: Path, feeds: Iterable[Feed], excluded: Callable[[str], bool]
) -> None:
    """Write a network in 8 bits, but for what is excluded by name.

    Weights have 7 bits of the 8: products of two numbers of 8 bits overflow the 16 bits in which processors without
    VNNI add pairs of them.
    """
    import onnx
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static

    nodes = onnx.load(str(source)).graph.node
    quantize_static(
        source,
        target,
        _Feeds(feeds),
        quant_format=QuantFormat.QDQ,
        per_channel=True,
        reduce_range=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        nodes_to_exclude=[node.name for node in nodes if excluded(node.name)],
    )
    model = onnx.load(str(target))
    rewrite(model.graph)
    said = onnx_metadata(source.read_bytes()) | {"weights": "7 bits, ranges by images learned from"}
    onnx.helper.set_model_props(model, said)
    onnx.save(model, str(target))
