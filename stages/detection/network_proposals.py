"""Boxes of sign faces by the detection network: heat map of middles, boxes, colours and shapes at stride 4."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES, NetworkBoxes
from wayside.stages.detection.onnx_detector import OnnxNetwork
from wayside.stages.geometry import non_maximum_suppression

STRIDE, MULTIPLE = 4, 32
"""Pixels a cell of the maps; height and width of what the network sees are multiples of this."""

CENTRE_PX, SIDE_PX = 8.0, 16.0
"""A box at a cell: middle = centre of the cell + `CENTRE_PX` * (a, b), width and height = `SIDE_PX` * exp(c, d)."""

MAPS = 2 + 4 + len(COLORS) + len(SHAPES)
"""Maps: log odds of fronts and of backs, box (a, b, c, d), log odds of colours, of shapes."""

MAXIMA = 4
"""Boxes are made of so many times the maxima that are wanted: most of the others are next to better ones."""

IMAGE, OUTPUT = "image", "maps"
"""Names of the input and of the output of a network."""


class DetectionNetwork:
    """A network from an ONNX file; raises ValueError where it cannot be run."""

    def __init__(self, path: str) -> None:
        self._network = OnnxNetwork(path, (OUTPUT,))

    def maps(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Maps (`MAPS`, rows, columns) of an image, padded at the right and below to whole multiples of 32."""
        return np.asarray(self._network.run({IMAGE: as_blob(rgb)})[OUTPUT][0], np.float32)


def as_blob(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """An image as the network takes it: (1, 3, height, width), 0 to 1, padded to whole multiples of 32."""
    height, width = rgb.shape[:2]
    padded = cv2.copyMakeBorder(
        rgb, 0, -height % MULTIPLE, 0, -width % MULTIPLE, cv2.BORDER_REPLICATE
    )
    return np.asarray(cv2.dnn.blobFromImage(padded, 1 / 255), np.float32)


def boxes_of_maps(
    maps: NDArray[np.float32],
    size: tuple[int, int],
    least_score: float,
    most: int,
    same_iou: float,
) -> NetworkBoxes:
    """Faces with log odds of `least_score` and more: the best `most`, none overlapping a better one by more.

    Local maxima of the heat maps (`MAPS`, rows, columns), clipped to the image of `size` (height, width).
    """
    heat = maps[:2]
    best = np.stack([cv2.dilate(one, np.ones((3, 3), np.uint8)) for one in heat])
    side, row, column = np.nonzero((heat >= best) & (heat >= least_score))
    score = heat[side, row, column]
    order = np.argsort(-score, kind="stable")[: MAXIMA * most]
    side, row, column, score = side[order], row[order], column[order], score[order]
    values = maps[2:, row, column].T
    middle = np.stack([column, row], 1) * STRIDE + STRIDE / 2 + CENTRE_PX * values[:, :2]
    half = SIDE_PX / 2 * np.exp(np.clip(values[:, 2:4], -4, 5))
    height, width = size
    box = np.concatenate([middle - half, middle + half], 1)
    box = np.clip(box, 0, [width, height, width, height]).astype(np.float32)
    fits = np.flatnonzero((box[:, 2] - box[:, 0] >= 2) & (box[:, 3] - box[:, 1] >= 2))
    every = fits[non_maximum_suppression(box[fits], same_iou)]
    kept = every[:most]
    color, shape = np.split(values[kept, 4:], [len(COLORS)], axis=1)
    return NetworkBoxes(
        box[kept],
        score[kept],
        side[kept] == 1,
        _log_softmax(color),
        _log_softmax(shape),
        len(every) - len(kept),
    )


def middle_scores(
    maps: NDArray[np.float32], box: NDArray[np.float32], least: float
) -> NDArray[np.float32]:
    """Log odds (n,) of fronts at the middles of boxes (n, 4) of the image of `maps`, no lower than `least`.

    The best of the cell and its neighbours: a box may be off by some pixels. `least` outside the maps.
    """
    heat = cv2.dilate(maps[0], np.ones((3, 3), np.uint8))
    column, row = np.floor((box[:, :2] + box[:, 2:]) / (2 * STRIDE)).astype(int).T
    inside = (row >= 0) & (row < heat.shape[0]) & (column >= 0) & (column < heat.shape[1])
    scores = np.full(len(box), least, np.float32)
    scores[inside] = np.maximum(heat[row[inside], column[inside]], least)
    return scores


def _log_softmax(values: NDArray[np.float32]) -> NDArray[np.float32]:
    above = values - values.max(axis=1, keepdims=True)
    return np.asarray(above - np.log(np.exp(above).sum(axis=1, keepdims=True)), np.float32)
