"""The box network: what a box shows, by its pixels and those around it.

A small convolutional network on a patch of each box. Outputs are the log odds of the front and of the back of a panel,
and the colour and shape of the face. They also give the offsets of its sides (box regression; Girshick et al. 2014,
appendix C).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.detection.box_patches import SIDE, drawn_patches
from wayside.stages.imaging import Pyramid

PATCHES, SIZES, BOX_OUTPUT = "patches", "sizes", "boxes"
"""Names of the inputs, patches (n, 48, 48, 3) uint8 and widths and heights (n, 2) in pixels, and of the output."""

OFFSET_AT, COLOR_AT, SHAPE_AT = 2, 6, 6 + len(COLORS)
BOX_VALUES = SHAPE_AT + len(SHAPES)
"""Values of a box: log odds of a front and of a back, offsets of four sides, scores of colours, scores of shapes."""

TOGETHER = 64
"""Boxes that are evaluated at once: what lies between two layers stays in the processor's cache."""


@dataclass(frozen=True, slots=True)
class BoxScores:
    """What the network says of boxes, n rows.

    `front`, `back` (n,): log odds of a face, and of a panel seen from behind. `offset` (n, 4): how far each side of the
    panel lies right of or below that of the box, in box sizes. `color` (n, colours), `shape` (n, shapes): log
    probabilities but for a constant a row.
    """

    front: NDArray[np.float32]
    back: NDArray[np.float32]
    offset: NDArray[np.float32]
    color: NDArray[np.float32]
    shape: NDArray[np.float32]

    @property
    def best(self) -> NDArray[np.float32]:
        """Log odds (n,) of the likelier side."""
        return np.maximum(self.front, self.back)

    def select(self, rows: NDArray[Any]) -> BoxScores:
        """Those rows, in that order."""
        return BoxScores(*(getattr(self, one.name)[rows] for one in fields(self)))

    def replaced(self, rows: NDArray[np.int64], others: BoxScores) -> BoxScores:
        """The same with `others` in `rows` (m,)."""
        columns = [getattr(self, one.name).copy() for one in fields(self)]
        for column, one in zip(columns, fields(self), strict=True):
            column[rows] = getattr(others, one.name)
        return BoxScores(*columns)


class BoxNetwork:
    """A network from an ONNX file; threads may share it. Raises ValueError if it cannot be run."""

    def __init__(self, path: str) -> None:
        self._network = OnnxNetwork(path, (BOX_OUTPUT,))
        found = self._values(np.zeros((1, SIDE, SIDE, 3), np.uint8), np.ones((1, 2), np.float32))
        if found.shape != (1, BOX_VALUES):
            raise ValueError(
                f"a box has {BOX_VALUES} values, but the output has shape {found.shape}"
            )

    def scores(self, levels: Pyramid, box: NDArray[np.float32]) -> BoxScores:
        """Of boxes (n, 4) of an image at full, half and quarter size."""
        parts = [np.zeros((0, BOX_VALUES), np.float32)]
        for first in range(0, len(box), TOGETHER):
            some = np.asarray(box[first : first + TOGETHER], np.float32)
            parts.append(self._values(drawn_patches(levels, some), some[:, 2:] - some[:, :2]))
        values = np.concatenate(parts)
        return BoxScores(
            values[:, 0],
            values[:, 1],
            values[:, OFFSET_AT:COLOR_AT],
            values[:, COLOR_AT:SHAPE_AT],
            values[:, SHAPE_AT:],
        )

    def _values(
        self, patches: NDArray[np.uint8], sizes: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        return self._network.run({PATCHES: patches, SIZES: sizes})[BOX_OUTPUT]
