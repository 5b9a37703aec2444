"""Writes the networks of `detectors/`, one of each format, and one of none beside them; needs the package onnx.

All see the same: a face is a red cell (class 0) or a blue cell (class 1) of 16 px of an input of 64 x 64; its score is
how red (blue) the cell is. Each format says so in its own words.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

SIDE = 64
STRIDES = (8, 16, 32)
CELLS = sum((SIDE // stride) ** 2 for stride in STRIDES)
TOP = 5
"""Boxes that the formats without suppression give."""


class Builder:
    """Nodes and constants of a network."""

    def __init__(self):
        self.nodes, self.constants = [], []

    def constant(self, name, values, kind=np.float32):
        self.constants.append(numpy_helper.from_array(np.asarray(values, kind), name))
        return name

    def node(self, kind, inputs, output, **attributes):
        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def scores(self, image):
        """(1, 2, cells), 0 to 1: red less green, blue less red."""
        weights = np.array([[1, -1, 0], [-1, 0, 1]], np.float32).reshape(2, 3, 1, 1)
        ink = self.node(
            "Conv", [image, self.constant("weights", weights)], "ink", kernel_shape=[1, 1]
        )
        flat = self.constant("flat", [1, 2, -1], np.int64)
        parts = []
        for stride in STRIDES:
            sides = [stride, stride]
            mean = self.node(
                "AveragePool", [ink], f"mean{stride}", kernel_shape=sides, strides=sides
            )
            parts.append(self.node("Reshape", [mean, flat], f"row{stride}"))
        every = self.node("Concat", parts, "every", axis=2)
        seen = self.constant(
            "seen", np.repeat([0, 1, 0], [(SIDE // s) ** 2 for s in STRIDES])[None, None]
        )
        only = self.node("Mul", [every, seen], "only")
        return self.node(
            "Clip", [only, self.constant("low", 0.01), self.constant("high", 1.0)], "score"
        )

    def rows(self, values, name):
        """(1, n, m) of (1, m, n)."""
        return self.node("Transpose", [values], name, perm=[0, 2, 1])

    def best(self, boxes):
        """The best `TOP` cells: boxes (1, k, 4), scores (1, k, 1), numbers (1, k, 1), all scores (1, k, 2)."""
        best = self.node("ReduceMax", ["score"], "best", axes=[1], keepdims=0)
        self.nodes.append(
            helper.make_node(
                "TopK", [best, self.constant("k", [TOP], np.int64)], ["top", "cell"], axis=1
            )
        )
        first = self.constant("first", [0], np.int64)
        cells = self.node("Squeeze", ["cell", first], "cells")
        last = self.constant("last", [2], np.int64)
        table = self.rows("score", "score_rows")
        chosen = self.node("Gather", [table, cells], "chosen", axis=1)
        box = self.node("Gather", [boxes, cells], "box", axis=1)
        number = self.node("ArgMax", [chosen], "number", axis=2, keepdims=1)
        return box, self.node("Unsqueeze", ["top", last], "confidence"), number, chosen


def middles():
    """Middle and size (cells, 4) of every cell, pixels."""
    rows = []
    for stride in STRIDES:
        for y in range(SIDE // stride):
            for x in range(SIDE // stride):
                rows.append([(x + 0.5) * stride, (y + 0.5) * stride, stride, stride])
    return np.array(rows, np.float32)


def corners(boxes):
    return np.concatenate(
        [boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], axis=1
    )


def yolov8(b):
    b.constant("places", middles().T[None])
    b.node("Concat", ["places", "score"], "output0", axis=1)
    return ["output0"]


def yolov5(b):
    box = b.constant("places", np.tile(middles(), (3, 1))[None])
    rows = b.rows("score", "rows")
    thrice = b.node("Concat", [rows, rows, rows], "thrice", axis=1)
    objectness = b.constant("objectness", np.repeat([1.0, 0.75, 0.5], CELLS).reshape(1, -1, 1))
    b.node("Concat", [box, objectness, thrice], "output0", axis=2)
    return ["output0"]


def numbered_rows(b, boxes):
    box, score, number, _ = b.best(b.constant("places", boxes[None]))
    number = b.node("Cast", [number], "class", to=TensorProto.FLOAT)
    b.node("Concat", [box, score, number], "output0", axis=2)
    return ["output0"]


def end_to_end(b):
    return numbered_rows(b, corners(middles()))


def detr(b):
    return numbered_rows(b, middles() / SIDE)


def detr_classes(b):
    box, _, _, scores = b.best(b.constant("places", middles()[None] / SIDE))
    b.node("Concat", [box, scores], "output0", axis=2)
    return ["output0"]


def detr_logits(b):
    box, _, _, scores = b.best(b.constant("places", middles()[None] / SIDE))
    b.node("Identity", [box], "pred_boxes")
    limited = b.node(
        "Clip", [scores, b.constant("least", 1e-6), b.constant("most", 1 - 1e-6)], "limited"
    )
    rest = b.node("Sub", [b.constant("one", 1.0), limited], "rest")
    odds = b.node("Div", [limited, rest], "odds")
    b.node("Log", [odds], "logits")
    return ["logits", "pred_boxes"]


def detr_pixels(b):
    box, score, number, _ = b.best(b.constant("places", corners(middles())[None] / SIDE))
    size = b.node("Cast", ["orig_target_sizes"], "size", to=TensorProto.FLOAT)
    twice = b.node("Concat", [size, size], "twice", axis=1)
    b.node("Mul", [box, twice], "boxes_px")
    b.node("Identity", ["boxes_px"], "boxes")
    b.node("Squeeze", [score, "last"], "scores")
    b.node("Squeeze", [number, "last"], "labels")
    return ["labels", "boxes", "scores"]


def other(b):
    """Heat maps: a format of neither family."""
    return [b.node("Identity", ["ink"], "heat")]


FORMATS = (yolov5, yolov8, end_to_end, detr, detr_classes, detr_logits, detr_pixels)


def network(make, metadata=None):
    """A network of a format as an ONNX model."""
    b = Builder()
    b.scores("images")
    outputs = make(b)
    inputs = [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, SIDE, SIDE])]
    if make is detr_pixels:
        inputs.append(helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, [1, 2]))
    kinds, axes = {"labels": TensorProto.INT64}, {"labels": 2, "scores": 2, "heat": 4}
    values = [
        helper.make_tensor_value_info(o, kinds.get(o, TensorProto.FLOAT), [None] * axes.get(o, 3))
        for o in outputs
    ]
    graph = helper.make_graph(b.nodes, make.__name__, inputs, values, b.constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata or {"names": "{0: 'red', 1: 'blue'}", "task": "detect"})
    onnx.checker.check_model(model)
    return model


def main(folder):
    for make in FORMATS:
        onnx.save(network(make), str(folder / f"{make.__name__}.onnx"))
    onnx.save(network(other), str(folder.parent / "other_outputs.onnx"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "detectors")
