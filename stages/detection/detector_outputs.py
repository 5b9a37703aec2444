"""Outputs of detectors that are not wayside's, read as boxes: the formats of the YOLO and RT-DETR families.

Each format is one function from the network's outputs to boxes, scores and classes. `recognised` names the format by
shapes and names, and only where no other format has them.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

Array = NDArray[np.float32]

STRIDES = ((8, 16, 32), (4, 8, 16, 32), (8, 16, 32, 64))
"""Strides of the heads of YOLO networks: usual, with P2, with P6."""
ANCHORS_A_CELL = {"yolov5": 3, "yolov8": 1}
MOST_QUERIES = 1000
"""No network without suppression gives more boxes; one with a box for every cell gives more."""
UNIT_MARGIN = 0.5
"""Boxes that are fractions of the image reach at most so far beyond it."""
WHOLE_IMAGE = ("detr", "detr_classes", "detr_pixels", "detr_logits")
"""Formats whose networks see the image stretched to their input; the others see it letterboxed."""
SUPPRESSED = ("yolov5", "yolov8")
"""Formats with several boxes on one object, of which the best stays."""


class RawBoxes(NamedTuple):
    """Boxes as a network gives them: box (n, 4) x0, y0, x1, y1. `score` (n,) 0 to 1. `number` (n,) of the class.

    The boxes of `WHOLE_IMAGE` are fractions of the image, except those of `detr_pixels`, which are pixels of the image;
    the others are pixels of the network's input.
    """

    box: Array
    score: Array
    number: NDArray[np.int64]


def recognised(
    outputs: Mapping[str, Array], input_size: tuple[int, int], head: str, classes: int
) -> str:
    """The format of the outputs of a network, by name, from one run on any image.

    `input_size`: height and width of the image that the network took. `head`, `classes`: name of its head and number of
    its classes in the file's metadata. Empty and 0: not stated.

    Raises ValueError, with the shapes that were found, where no format has them, or several have.
    """
    if {"labels", "boxes", "scores"} == set(outputs):
        return "detr_pixels"
    if {"logits", "pred_boxes"} == set(outputs):
        return "detr_logits"
    found = []
    if len(outputs) == 1:
        (values,) = outputs.values()
        if values.ndim == 3 and values.shape[0] == 1:
            found = [
                name
                for name in _of_one_output(values[0], input_size, head)
                if _fits(name, values, classes)
            ]
    if len(found) != 1:
        several = f"; it could be {' or '.join(found)}" if found else ""
        raise ValueError(
            f"outputs {_listed(outputs)} for an input of {input_size[1]} x {input_size[0]}{several}"
        )
    return found[0]


def _of_one_output(values: Array, input_size: tuple[int, int], head: str) -> list[str]:
    """Formats that have a table (rows, columns) of this shape and content."""
    rows, columns = values.shape
    cells = {sum(input_size[0] // s * (input_size[1] // s) for s in strides) for strides in STRIDES}
    found = []
    if columns in cells and rows > 4:
        found.append("yolov8")
    if columns > 5 and rows in {ANCHORS_A_CELL["yolov5"] * count for count in cells}:
        found.append("yolov5")
    if rows <= MOST_QUERIES and columns > 4 and not found:
        last = values[:, -1]
        numbered = columns == 6 and bool((last == np.round(last)).all())
        fractions = "detr" in head.lower() or (rows > 0 and _are_fractions(values))
        if numbered:
            found.append("detr" if fractions else "end_to_end")
        elif fractions:
            found.append("detr_classes")
    return found


def _are_fractions(values: Array) -> bool:
    """Whether all rows have boxes of some size that are fractions of the image."""
    middle, size = values[:, :2], values[:, 2:4]
    inside = (np.abs(middle - 0.5) <= 0.5 + UNIT_MARGIN).all()
    return bool(inside and (size > 0).all() and (size <= 1 + UNIT_MARGIN).all())


def _fits(name: str, values: Array, classes: int) -> bool:
    """Whether a format leaves as many scores as the network has classes, where that is known."""
    columns = {
        "yolov8": values.shape[1] - 4,
        "yolov5": values.shape[2] - 5,
        "detr_classes": values.shape[2] - 4,
    }
    return not classes or columns.get(name, classes) == classes


def _listed(outputs: Mapping[str, Array]) -> str:
    return ", ".join(f"{name} {list(value.shape)}" for name, value in outputs.items())


def read_outputs(outputs: Mapping[str, Array], form: str) -> RawBoxes:
    """The boxes in the outputs of a network of a format.

    Raises ValueError for outputs that the format does not have, or scores outside of 0 to 1.
    """
    if form == "detr_logits":
        scores = expit(_one(outputs, "logits", 3))
        found = _best(_corners(_one(outputs, "pred_boxes", 3)), scores)
    elif form == "detr_pixels":
        number = np.rint(_one(outputs, "labels", 2)).astype(np.int64)
        found = RawBoxes(_one(outputs, "boxes", 3), _one(outputs, "scores", 2), number)
    else:
        least = {"yolov5": (0, 6), "yolov8": (5, 0), "detr_classes": (0, 5)}.get(form, (0, 6))
        table = _one(outputs, next(iter(outputs)), 3)
        if len(outputs) > 1 or (np.array(table.shape) < least).any():
            raise ValueError(f"outputs {_listed(outputs)}")
        found = _from_table(table, form)
    if found.box.shape != (len(found.score), 4):
        raise ValueError(f"boxes {list(found.box.shape)} and scores {list(found.score.shape)}")
    if len(found.score) and not (-1e-3 <= found.score.min() and found.score.max() <= 1 + 1e-3):
        low, high = float(found.score.min()), float(found.score.max())
        raise ValueError(f"scores from {low:.3g} to {high:.3g}, not 0 to 1, as format {form}")
    return found


def _from_table(table: Array, form: str) -> RawBoxes:
    match form:
        case "yolov5":
            return _best(_corners(table[:, :4]), table[:, 5:] * table[:, 4:5])
        case "yolov8":
            return _best(_corners(table[:4].T), table[4:].T)
        case "detr_classes":
            return _best(_corners(table[:, :4]), table[:, 4:])
    box = _corners(table[:, :4]) if form == "detr" else table[:, :4]
    return RawBoxes(box, table[:, 4], np.rint(table[:, 5]).astype(np.int64))


def _one(outputs: Mapping[str, Array], name: str, axes: int) -> Array:
    value = outputs.get(name)
    if value is None or value.ndim != axes or value.shape[0] != 1:
        raise ValueError(f"outputs {_listed(outputs)}")
    return np.asarray(value[0])


def _best(box: Array, scores: Array) -> RawBoxes:
    """Boxes with their best class of `scores` (n, classes)."""
    number = scores.argmax(axis=1)
    return RawBoxes(box, scores[np.arange(len(scores)), number], number.astype(np.int64))


def _corners(box: Array) -> Array:
    """Boxes (n, 4) of middle and size as x0, y0, x1, y1."""
    half = box[:, 2:] / 2
    return np.concatenate([box[:, :2] - half, box[:, :2] + half], axis=1)
