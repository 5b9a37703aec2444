"""The box network: what a box shows, by its pixels and those around it.

A small convolutional network on a patch of each box. Outputs are the log odds of the front and of the back of a panel,
and the colour and shape of the face. They also give the offsets of its sides (box regression; Girshick et al. 2014,
appendix C).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import LEARNED_COLORS, SHAPES
from wayside.schemas.models import ScoreModel
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.detection.box_patches import SIDE, drawn_patches, log_levels

PATCHES, SIZES, BOX_OUTPUT = "patches", "sizes", "boxes"
"""Names of the inputs, `log_levels` (n, 48, 48, 3) and widths and heights (n, 2) in pixels, and of the output."""
OFFSET_AT, COLOR_AT, SHAPE_AT = 2, 6, 6 + len(LEARNED_COLORS)
BOX_VALUES = SHAPE_AT + len(SHAPES)
"""Values of a box: log odds of a front and of a back, offsets of four sides, scores of colours, scores of shapes."""
TOGETHER = 64
"""Boxes that are evaluated at once: what lies between two layers stays in the processor's cache."""


class BoxScores(NamedTuple):
    """What the network says of boxes, n rows."""

    front: NDArray[np.float32]
    """Log odds of a face, (n,)."""
    back: NDArray[np.float32]
    """Log odds of a panel seen from behind, (n,)."""
    offset: NDArray[np.float32]
    """How far each side of the panel lies right of or below that of the box, (n, 4), box sizes."""
    color: NDArray[np.float32]
    """Log probability of each colour but for a constant a row, (n, colours)."""
    shape: NDArray[np.float32]
    """The same of each shape, (n, shapes)."""

    @property
    def best(self) -> NDArray[np.float32]:
        """Log odds (n,) of the likelier side."""
        return np.maximum(self.front, self.back)

    def select(self, rows: NDArray[Any]) -> "BoxScores":
        """Those rows, in that order."""
        return BoxScores(*(column[rows] for column in self))


class BoxNetwork:
    """A network from an ONNX file; threads may share it. Raises ValueError if it cannot be run."""

    def __init__(self, path: str) -> None:
        self._network = OnnxNetwork(path, (BOX_OUTPUT,))
        found = self._values(np.zeros((1, SIDE, SIDE, 3), np.uint8), np.ones((1, 4), np.float32))
        if found.shape != (1, BOX_VALUES):
            raise ValueError(
                f"a box has {BOX_VALUES} values, but the output has shape {found.shape}"
            )

    def scores(self, rgb: NDArray[np.uint8], box: NDArray[np.float32]) -> BoxScores:
        """Of boxes (n, 4) of an image (height, width, 3)."""
        return self.scores_of_patches(drawn_patches(rgb, box), box)

    def scores_of_patches(self, patches: NDArray[np.uint8], box: NDArray[np.float32]) -> BoxScores:
        """Of boxes (n, 4) of any images, by their patches, see `drawn_patches`."""
        parts = [np.zeros((0, BOX_VALUES), np.float32)]
        for first in range(0, len(box), TOGETHER):
            rows = slice(first, first + TOGETHER)
            parts.append(self._values(patches[rows], box[rows]))
        values = np.concatenate(parts)
        columns = np.split(values, [1, OFFSET_AT, COLOR_AT, SHAPE_AT], axis=1)
        return BoxScores(columns[0][:, 0], columns[1][:, 0], *columns[2:])

    def _values(self, patches: NDArray[np.uint8], box: NDArray[np.float32]) -> NDArray[np.float32]:
        seen = {PATCHES: log_levels(patches), SIZES: box[:, 2:] - box[:, :2]}
        return self._network.run(seen)[BOX_OUTPUT]


@dataclass(frozen=True, slots=True)
class BoxClassifier:
    """The box network as a classifier of panels from the front, or from behind (`back`)."""

    network: BoxNetwork
    model: ScoreModel
    back: bool = False

    def scores(
        self, shown: Iterable[tuple[NDArray[np.uint8], NDArray[np.float32]]]
    ) -> NDArray[np.float32]:
        """Log odds (n,) that boxes show such a panel: of images (height, width, 3), each with its boxes (k, 4)."""
        images = list(shown)
        patches = np.concatenate([drawn_patches(rgb, box) for rgb, box in images])
        found = self.network.scores_of_patches(patches, np.concatenate([box for _, box in images]))
        return found.back if self.back else found.front
