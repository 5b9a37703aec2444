"""Writes the networks of `detectors/`, one of each format and one of no format; needs the package onnx.

All see the same: a face is a red cell (class 0) or a blue cell (class 1) of 16 px of an input of 64 x 64. Its score is
how red (blue) the cell is. Each format says so in its own words.
"""

import re
import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import helper, numpy_helper

SIDE, STRIDES = 64, (8, 16, 32)
COUNTS = [(SIDE // stride) ** 2 for stride in STRIDES]

SCORE = """
    ink = Conv <kernel_shape = [1, 1]> (images, weights)
    mean8 = AveragePool <kernel_shape = [8, 8], strides = [8, 8]> (ink)
    mean16 = AveragePool <kernel_shape = [16, 16], strides = [16, 16]> (ink)
    mean32 = AveragePool <kernel_shape = [32, 32], strides = [32, 32]> (ink)
    row8 = Reshape (mean8, flat)
    row16 = Reshape (mean16, flat)
    row32 = Reshape (mean32, flat)
    every = Concat <axis = 2> (row8, row16, row32)
    only = Mul (every, seen)
    score = Clip (only, low, high)
    rows = Transpose <perm = [0, 2, 1]> (score)
"""
"""Scores (1, 2, cells), 0 to 1: red less green, blue less red."""

BEST = """
    best = ReduceMax <axes = [1], keepdims = 0> (score)
    top, cell = TopK <axis = 1> (best, five)
    cells = Squeeze (cell, first)
    chosen = Gather <axis = 1> (rows, cells)
    box = Gather <axis = 1> (PLACES, cells)
    number = ArgMax <axis = 2, keepdims = 1> (chosen)
    confidence = Unsqueeze (top, last)
"""
"""The best five cells, as the formats without suppression give them."""

NUMBERED = """
    class = Cast <to = 1> (number)
    output0 = Concat <axis = 2> (box, confidence, class)
"""

FORMATS = {
    "yolov8": ("float[a,b,c] output0", "output0 = Concat <axis = 1> (columns, score)"),
    "yolov5": (
        "float[a,b,c] output0",
        """thrice = Concat <axis = 1> (rows, rows, rows)
        output0 = Concat <axis = 2> (repeated, objectness, thrice)""",
    ),
    "end_to_end": ("float[a,b,c] output0", BEST.replace("PLACES", "corners") + NUMBERED),
    "detr": ("float[a,b,c] output0", BEST.replace("PLACES", "fractions") + NUMBERED),
    "detr_classes": (
        "float[a,b,c] output0",
        BEST.replace("PLACES", "fractions") + "output0 = Concat <axis = 2> (box, chosen)",
    ),
    "detr_logits": (
        "float[a,b,c] logits, float[a,b,d] pred_boxes",
        BEST.replace("PLACES", "fractions")
        + """pred_boxes = Identity (box)
        limited = Clip (chosen, least, most)
        rest = Sub (high, limited)
        odds = Div (limited, rest)
        logits = Log (odds)""",
    ),
    "detr_pixels": (
        "int64[a,b] labels, float[a,b,c] boxes, float[a,b] scores",
        BEST.replace("PLACES", "corner_fractions")
        + """size = Cast <to = 1> (orig_target_sizes)
        twice = Concat <axis = 1> (size, size)
        boxes = Mul (box, twice)
        scores = Squeeze (confidence, last)
        labels = Squeeze (number, last)""",
    ),
    "other_outputs": ("float[a,b,c,d] heat", "heat = Identity (ink)"),  # of neither family
}
"""Outputs and nodes of each format."""


def constants():
    """Constants by name; the places of the cells are middle and size, or the corners."""
    steps = [(s, (np.arange(SIDE // s) + 0.5) * s) for s in STRIDES]
    places = np.array([[[x, y, s, s] for s, at in steps for y in at for x in at]], np.float32)
    corners = places @ np.array([[1, 0, 1, 0], [0, 1, 0, 1], [-0.5, 0, 0.5, 0], [0, -0.5, 0, 0.5]])
    real = {
        "weights": np.reshape([[1, -1, 0], [-1, 0, 1]], (2, 3, 1, 1)),
        "seen": np.repeat([0, 1, 0], COUNTS)[None, None],
        **{"low": 0.01, "high": 1.0, "least": 1e-6, "most": 1 - 1e-6},
        "columns": places.swapaxes(1, 2),
        "repeated": np.tile(places, (1, 3, 1)),
        "objectness": np.repeat([1.0, 0.75, 0.5], sum(COUNTS)).reshape(1, -1, 1),
        "corners": corners,
        "fractions": places / SIDE,
        "corner_fractions": corners / SIDE,
    }
    whole = {"flat": [1, 2, -1], "five": [5], "first": [0], "last": [2]}
    return {
        **{name: np.asarray(value, np.float32) for name, value in real.items()},
        **{name: np.asarray(value, np.int64) for name, value in whole.items()},
    }


def network(name):
    """The network of a format as an ONNX model."""
    outputs, nodes = FORMATS[name]
    sizes = ", int64[1,2] orig_target_sizes" if "orig_target_sizes" in nodes else ""
    model = onnx.parser.parse_model(
        f'<ir_version: 8, opset_import: ["": 17]> {name} (float[1,3,{SIDE},{SIDE}] images{sizes})'
        f"=> ({outputs}) {{ {SCORE} {nodes} }}"
    )
    used = set(re.findall(r"\w+", SCORE + nodes))
    tensors = [numpy_helper.from_array(v, k) for k, v in constants().items() if k in used]
    model.graph.initializer.extend(tensors)
    helper.set_model_props(model, {"names": "{0: 'red', 1: 'blue'}", "task": "detect"})
    onnx.checker.check_model(model)
    return model


def main(folder):
    for name in FORMATS:
        at = folder if name != "other_outputs" else folder.parent
        onnx.save(network(name), str(at / f"{name}.onnx"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "detectors")
