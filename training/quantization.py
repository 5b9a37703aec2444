"""Networks in 8-bit integers: a third of the time of floating point, nearly the same output.

Every tensor between two layers is a scale times numbers of 0 to 255. Weights are a scale of their filter times numbers
of -64 to 63 (Jacob et al. 2018, "Quantization and training of neural networks for efficient integer-arithmetic-only
inference"). The scales come from the least and the largest value of a tensor over some of what the network was learned
from. The last layer stays as it is: its log odds would be steps of 0.1. The part between a `QuantizeLinear` and the
next `DequantizeLinear` is then rewritten on integers, with the same output to the last bit.
"""

from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.models.model_files import onnx_metadata
from wayside.stages import detection

LAST_LAYER = "/maps/Conv"
"""The last layer of the detection network, by the name that its export gives it."""

LAYERS = "/layers/"
"""Start of the names of the layers of the box network whose numbers are integers."""

Feed = dict[str, NDArray[Any]]


def quantize(source: Path, target: Path, images: Iterable[NDArray[np.uint8]]) -> None:
    """Write the detection network of an ONNX file in 8 bits, with the metadata of that file.

    `images`: (height, width, 3), any size, 32 px and more; needs the package onnx.
    """
    # without white the steps of the input are others
    white = np.full((detection.MULTIPLE, detection.MULTIPLE, 3), LEVELS, np.uint8)
    feeds = ({detection.IMAGE: detection.padded(rgb)} for rgb in chain([white], images))
    _quantize(source, target, feeds, lambda name: name == LAST_LAYER)


def quantize_boxes(source: Path, target: Path, samples: Iterable[Feed]) -> None:
    """The same of a box network; samples: `patch` and `size` of boxes, few at a time: all layers are held at once."""
    feeds = ({detection.PATCHES: one["patch"], detection.SIZES: one["size"]} for one in samples)
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

    given = iter(feeds)
    nodes = onnx.load(str(source)).graph.node
    quantize_static(
        source,
        target,
        SimpleNamespace(get_next=lambda: next(given, None)),  # a `CalibrationDataReader`
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


LEVELS = 255
"""Steps of a colour of an image from none to full: the networks see 0 to 1."""

COLORS, TOGETHER = 3, 4
"""Colours of an image; columns of it that are one for a first layer that is rewritten, and columns that it makes."""

DIGIT = 128
"""Values of a digit of a weight of the last layer, from -64 to 63."""

TO_NHWC, TO_NCHW = (0, 2, 3, 1), (0, 3, 1, 2)
"""Orders of dimensions: (n, channels, rows, columns) to (n, rows, columns, channels), in which integers lie in memory,
and back. Onnxruntime joins such transpositions with those that it makes itself, so that none is left."""


class _Graph:
    """A graph of the package onnx with its tensors by name."""

    def __init__(self, graph: Any) -> None:
        self.graph = graph
        self._stored = {one.name: one for one in graph.initializer}

    def nodes(self, kind: str) -> list[Any]:
        """All nodes of an operation."""
        return [node for node in self.graph.node if node.op_type == kind]

    def before(self, node: Any, kind: str | None = None, at: int = 0) -> Any:
        """What makes an input of a node; None where that is no node, or not of that kind, or there is no node."""
        for one in self.graph.node:
            if node is not None and node.input[at] in one.output:
                return one if kind in (None, one.op_type) else None
        return None

    def after(self, node: Any) -> list[Any]:
        """What takes the output of a node."""
        return [one for one in self.graph.node if node.output[0] in one.input]

    def array(self, name: str) -> NDArray[Any]:
        """A stored tensor."""
        from onnx import numpy_helper

        return np.asarray(numpy_helper.to_array(self._stored[name]))

    def store(self, name: str, values: NDArray[Any]) -> str:
        """Store a tensor, in place of an earlier one of its name; returns the name."""
        from onnx import numpy_helper

        tensor = numpy_helper.from_array(np.ascontiguousarray(values), name)
        if name in self._stored:
            self._stored[name].CopyFrom(tensor)
        else:
            self.graph.initializer.append(tensor)
            self._stored[name] = self.graph.initializer[-1]
        return name

    def insert(
        self, before: Any, kind: str, inputs: Sequence[str], output: str = "", **attributes: Any
    ) -> str:
        """Put a node before another one; returns its output, which is named after the first input by default."""
        from onnx import helper

        output = output or f"{inputs[0]}/{kind}"
        node = helper.make_node(kind, list(inputs), [output], **attributes)
        self.graph.node.insert(list(self.graph.node).index(before), node)
        return output

    def remove_unused(self) -> None:
        """Take out nodes and stored tensors that nothing takes."""
        outputs = {one.name for one in self.graph.output}
        while True:
            used = outputs.union(*(node.input for node in self.graph.node))
            unused = [node for node in self.graph.node if used.isdisjoint(node.output)]
            if not unused:
                break
            for node in unused:
                self.graph.node.remove(node)
        for name in self._stored.keys() - used:
            self.graph.initializer.remove(self._stored.pop(name))


def rewrite(graph: Any) -> None:
    """Apply every rewrite of this module, in place, where the graph has what it is for."""
    tensors = _Graph(graph)
    _join_levels(tensors)
    _widen_first_layer(tensors)
    _upsample_by_rows(tensors)
    _split_last_layer(tensors)
    tensors.remove_unused()
    del graph.value_info[:]  # shapes of tensors that are there no more


def _join_levels(graph: _Graph) -> None:
    """Let the levels 0 to 255 of an image be the integers of the first layer, where they are the same.

    An image divided by 255 and quantised in steps of 1 / 255 is that image.
    """
    for node in graph.nodes("DequantizeLinear"):
        cast = graph.before(graph.before(graph.before(node, "QuantizeLinear"), "Div"), "Cast")
        if cast is None:
            continue
        if np.isclose(graph.array(node.input[1]), 1 / LEVELS) and graph.array(node.input[2]) == 0:
            node.input[0] = cast.input[0]


def _widen_first_layer(graph: _Graph) -> None:
    """Let a first layer make four columns of its output at once, of four columns of the image in one (space to depth).

    Four columns of three colours are one of twelve channels, so that fewer and wider products are summed, some of them
    with weights of 0. The width of an image has to be a multiple of eight from then on.
    """
    layer = graph.nodes("Conv")[0]
    image, weight = (graph.before(layer, "DequantizeLinear", at) for at in range(2))
    if None in (image, weight, _rounding_after(layer, graph)):
        return
    if graph.array(weight.input[0]).shape[1] == COLORS:
        _widen(layer, TOGETHER, TOGETHER, 1, graph)
        shape = 0, 0, -1, TOGETHER * COLORS
        image.input[0] = _reshaped(image.input[0], shape, image, graph)


def _upsample_by_rows(graph: _Graph) -> None:
    """Let the layer before upsampling to twice as many samples make each column twice, and copy rows of them.

    Onnxruntime copies the channels of every sample by themselves otherwise.
    """
    for resize in graph.nodes("Resize"):
        values, rounded = graph.before(resize, "DequantizeLinear"), _rounding_after(resize, graph)
        layer = graph.before(graph.before(values, "QuantizeLinear"), "Conv")
        if None in (layer, rounded) or values.input[1:] != rounded.input[1:]:
            continue
        channels = _widen(layer, 2, 1, 2, graph)
        each = _reshaped(values.input[0], (-1, 1, 0, channels), values, graph)
        twice = graph.insert(values, "Concat", [each, each], axis=2)
        larger = _reshaped(twice, (1, -1, 0, channels), values, graph)
        for user in graph.after(rounded):
            user.input[0] = larger


def _widen(layer: Any, together: int, joined: int, upsampled: int, graph: _Graph) -> int:
    """Let a layer make `together` columns of its output at once, of `joined` columns of its input in one.

    Where numbers lie in memory stays as it is. `upsampled`: how often each column comes. Returns the number of filters.
    """
    shape = {one.name: one.ints for one in layer.attribute}
    weight, bias = (graph.before(layer, at=at) for at in (1, 2))
    kernel, stride = graph.array(weight.input[0]), shape["strides"][1] / upsampled
    wide, left = widened_kernel(kernel, stride, together, joined)
    step, seen = int(together * stride) // joined, wide.shape[3]
    shape["strides"][1], shape["kernel_shape"][1] = step, seen
    shape["pads"][1], shape["pads"][3] = left, seen - step - left
    # what another layer takes as well stays as it is
    for at, node in enumerate((weight, bias), 1):
        several = [graph.store(f"{k}/wide", np.tile(graph.array(k), together)) for k in node.input]
        layer.input[at] = graph.insert(layer, node.op_type, several, axis=0)
    graph.store(f"{weight.input[0]}/wide", wide)
    rounded = _rounding_after(layer, graph)
    users = graph.after(rounded)
    apart = _reshaped(rounded.output[0], (0, 0, -1, len(kernel)), users[0], graph)
    for user in users:
        user.input[0] = apart
    return len(kernel)


def widened_kernel(
    kernel: NDArray[Any], stride: float, together: int, joined: int
) -> tuple[NDArray[Any], int]:
    """The kernel that makes, of `joined` columns in one, `together` columns of what (n, c, rows, k) makes.

    (`together` n, `joined` c, rows, columns), weights that are not used 0, and how far left it begins.
    """
    filters, channels, rows, columns = kernel.shape
    reach = columns // 2
    left, right = -(-reach // joined), (int((together - 1) * stride) + reach) // joined
    wide = np.zeros((together, filters, joined, channels, rows, left + 1 + right), kernel.dtype)
    for column in range(together):
        for k in range(columns):
            group, at = divmod(int(column * stride) + k - reach, joined)
            wide[column, :, at, :, :, left + group] = kernel[:, :, :, k]
    return wide.reshape(together * filters, joined * channels, rows, -1), left


def _rounding_after(layer: Any, graph: _Graph) -> Any:
    """What makes integers of a layer; None where that does not come next."""
    users = graph.after(layer)
    if len(users) == 1 and users[0].op_type == "Relu":
        users = graph.after(users[0])
    return users[0] if len(users) == 1 and users[0].op_type == "QuantizeLinear" else None


def _reshaped(tensor: str, shape: Sequence[int], before: Any, graph: _Graph) -> str:
    """The same bytes in another shape (n, rows, columns, channels); 0: as before, -1: what is left."""
    nhwc = graph.insert(before, "Transpose", [tensor], perm=TO_NHWC)
    stored = graph.store(f"{tensor}/shape", np.array(shape))
    reshaped = graph.insert(before, "Reshape", [nhwc, stored])
    return graph.insert(before, "Transpose", [reshaped], perm=TO_NCHW)


def _split_last_layer(graph: _Graph) -> None:
    """Split the last layer of the detection network: the log odds of all cells stay in the graph, the rest is left out.

    In floating point that layer takes 7 % of the time of the network, most of it for the boxes and classes of 50,000
    cells, of which some hundred are read. Whoever reads them applies the layer to those cells: the outputs become
    `HEAT`, `FEATURES`, `SCALE`, `WEIGHT` and `BIAS`. The weights of the log odds are two digits of 7 bits each, to be
    computed as sums of integers. Their bias is left out, because onnxruntime takes longer to add it than for the sums.
    """
    from onnx import TensorProto, helper

    layer = graph.nodes("Conv")[-1]
    cast = graph.before(layer, "Cast")  # that the layer is in floating point, as the export says it
    seen = graph.before(cast or layer, "DequantizeLinear")
    if [one.name for one in graph.graph.output] != [detection.OUTPUT] or seen is None:
        return
    weight, bias = (graph.array(name) for name in layer.input[1:])
    if weight.shape[2:] != (1, 1) or graph.array(seen.input[2]) != 0:
        return
    scale = float(graph.array(seen.input[1]))
    digits, sums = _two_digits(weight[: detection.ODDS, :, 0, 0])
    stored: dict[str, NDArray[Any]] = {
        "digits": digits,
        "sums": np.asarray(sums * scale, np.float32),
        detection.SCALE: np.array([scale], np.float32),
        detection.WEIGHT: weight[:, :, 0, 0],
        detection.BIAS: bias,
    }
    for name, values in stored.items():
        graph.store(name, values)
    features = graph.insert(layer, "Transpose", [seen.input[0]], detection.FEATURES, perm=TO_NHWC)
    summed = graph.insert(layer, "MatMulInteger", [features, "digits"])
    number = graph.insert(layer, "Cast", [summed], to=TensorProto.FLOAT)
    joined = graph.insert(layer, "MatMul", [number, "sums"])
    graph.insert(layer, "Transpose", [joined], detection.HEAT, perm=TO_NCHW)
    del graph.graph.output[:]
    shapes = {
        detection.HEAT: (1, detection.ODDS, "rows", "columns"),
        detection.FEATURES: (1, "rows", "columns", weight.shape[1]),
        detection.SCALE: (1,),
        detection.WEIGHT: weight.shape[:2],
        detection.BIAS: bias.shape,
    }
    for name, shape in shapes.items():
        kind = TensorProto.UINT8 if name == detection.FEATURES else TensorProto.FLOAT
        graph.graph.output.append(helper.make_tensor_value_info(name, kind, shape))


def _two_digits(weight: NDArray[np.float32]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Weights (n, c) as integers (c, 2 n) of 7 bits, and what joins their sums (2 n, n): their product is weight.T.

    An integer of 13 bits and a sign is 128 times one and another.
    """
    count = len(weight)
    step = np.abs(weight).max(axis=1, keepdims=True).astype(np.float64) / (DIGIT * (DIGIT // 2 - 1))
    number = np.rint(weight / step).astype(np.int64)
    high = (number + DIGIT // 2) // DIGIT
    digits = np.concatenate([high, number - DIGIT * high]).T.astype(np.int8)
    joins = np.concatenate([DIGIT * np.eye(count), np.eye(count)]) * step.T
    return digits, joins
