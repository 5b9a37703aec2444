"""A detector that is not wayside's, run from its ONNX file: the image to its input, its boxes back to the image."""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.detectors import DetectorFile, ExternalBoxes, SignClass
from wayside.schemas.errors import InputError
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.detection.detector_outputs import (
    SUPPRESSED,
    WHOLE_IMAGE,
    RawBoxes,
    read_outputs,
)
from wayside.stages.geometry import non_maximum_suppression

SUREST = 0.999
"""Largest score of a box, and 1 minus the smallest: no detector is sure beyond all evidence."""
MULTIPLE = 32
"""Height and width of what a network of free input size sees are multiples of this."""
GREY = 114
"""Level of the border of a letterboxed image, as in the training of the YOLO networks."""


class OnnxDetector:
    """A detector that is run on images; threads may share it."""

    def __init__(self, file: DetectorFile) -> None:
        self._file = file
        self._network = OnnxNetwork(file.onnx.path, file.outputs)

    def boxes(self, rgb: NDArray[np.uint8], least_score: float, same_iou: float) -> ExternalBoxes:
        """Boxes of signs in an image (height, width, 3), best first, those below `least_score` left out.

        `same_iou`: where the network does not suppress boxes itself, those that overlap a better one more are.

        Raises InputError where the outputs are not those of the file's format.
        """
        file = self._file
        height, width = rgb.shape[:2]
        free = height + -height % MULTIPLE, width + -width % MULTIPLE
        whole = file.format in WHOLE_IMAGE
        seen, scale, border = fitted(rgb, file.input_size or free, whole=whole)
        pixels = np.ascontiguousarray(seen.transpose(2, 0, 1)[None], np.float32) / np.float32(255)
        inputs: dict[str, NDArray[Any]] = {file.image_input: pixels}
        if file.size_input:
            inputs[file.size_input] = np.array([[width, height]], np.int64)
        try:
            raw = read_outputs(self._network.run(inputs), file.format)
        except ValueError as error:
            raise InputError(
                f"models.detector: the outputs of {file.onnx.path} are not boxes of format {file.format}: {error}. "
                "See docs/detectors.md for the formats, and set one with --set models.detector_format."
            ) from error
        if whole:
            unit = 1 if file.format == "detr_pixels" else np.array([width, height] * 2)
            box = raw.box * unit
        else:
            box = (raw.box - np.tile(border, 2)) / np.tile(scale, 2)
        raw = raw._replace(box=np.asarray(box, np.float32))
        iou = same_iou if file.format in SUPPRESSED else None
        return sign_boxes(raw, (height, width), file.signs, least_score, iou)


def fitted(
    rgb: NDArray[np.uint8], size: tuple[int, int], *, whole: bool
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
    """The image at a size (height, width), the scale (2,) of x and y, and the border (2,) left and above.

    `whole`: stretched to all of it; else as large as fits with its aspect, in the middle of a grey border.
    """
    height, width = rgb.shape[:2]
    if whole:
        scale = np.array([size[1] / width, size[0] / height], np.float32)
        stretched = np.asarray(cv2.resize(rgb, (size[1], size[0])), np.uint8)
        return stretched, scale, np.zeros(2, np.float32)
    factor = min(size[0] / height, size[1] / width)
    tall, wide = round(height * factor), round(width * factor)
    scaled = rgb if (tall, wide) == (height, width) else cv2.resize(rgb, (wide, tall))
    top, left = (size[0] - tall) // 2, (size[1] - wide) // 2
    seen = np.full((*size, 3), GREY, np.uint8)
    seen[top : top + tall, left : left + wide] = scaled
    scale = np.array([wide / width, tall / height], np.float32)
    return seen, scale, np.array([left, top], np.float32)


def sign_boxes(
    raw: RawBoxes,
    size: tuple[int, int],
    signs: Mapping[int, SignClass] | None,
    least_score: float,
    same_iou: float | None,
) -> ExternalBoxes:
    """Boxes of signs, best first, cut at the border of the image of `size` (height, width).

    Whatever their classes, of boxes that overlap more than `same_iou` the best stays: one panel is one sign.
    """
    height, width = size
    box = np.clip(raw.box, 0, np.array([width, height] * 2, np.float32)).astype(np.float32)
    good = (raw.score >= least_score) & np.isfinite(raw.box).all(axis=1)
    good &= (box[:, 2:] > box[:, :2]).all(axis=1)
    rows = np.flatnonzero(good)
    rows = rows[np.argsort(-raw.score[rows], kind="stable")]
    if same_iou is not None:
        rows = rows[non_maximum_suppression(box[rows], same_iou)]
    return named_boxes(box[rows], raw.score[rows], raw.number[rows], signs)


def named_boxes(
    box: NDArray[np.float32],
    score: NDArray[np.float32],
    number: NDArray[np.int64],
    signs: Mapping[int, SignClass] | None,
) -> ExternalBoxes:
    """Those boxes (n, 4) whose classes are signs, with what these say of colour and shape."""
    if signs is None:
        signs = dict.fromkeys(number.tolist(), SignClass())
    rows = np.flatnonzero([k in signs for k in number.tolist()])
    known = [signs[k] for k in number[rows].tolist()]
    color = [NONE if one.color is None else COLORS.index(one.color) for one in known]
    shape = [NONE if one.shape is None else SHAPES.index(one.shape) for one in known]
    return ExternalBoxes(
        box[rows],
        score_log_odds(score[rows]),
        np.array(color, np.int8),
        np.array(shape, np.int8),
        len(number),
    )


def score_log_odds(score: NDArray[np.floating]) -> NDArray[np.float32]:
    """Log odds of scores (n,) between 0 and 1, which are cut off at `SUREST`."""
    limited = np.clip(np.asarray(score, np.float64), 1 - SUREST, SUREST)
    return np.asarray(np.log(limited / (1 - limited)), np.float32)
