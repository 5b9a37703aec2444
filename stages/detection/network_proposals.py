"""Boxes of sign faces by the detection network: heat map of middles, boxes, colours and shapes at stride 4."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import LEARNED_COLORS, SHAPES, NetworkBoxes
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.geometry import non_maximum_suppression
from wayside.stages.kernels import compiled

STRIDE, MULTIPLE = 4, 32
"""Pixels a cell of the maps; height and width of what the network sees are multiples of this."""
CENTRE_PX, SIDE_PX = 8.0, 16.0
"""A box at a cell: middle = centre of the cell + `CENTRE_PX` * (a, b), width and height = `SIDE_PX` * exp(c, d)."""
MAPS = 2 + 4 + len(LEARNED_COLORS) + len(SHAPES)
"""Maps: log odds of fronts and of backs, box (a, b, c, d), log odds of colours, of shapes."""
MAXIMA = 4
"""Boxes are made of so many times the maxima that are wanted: most of the others are next to better ones."""
IMAGE, OUTPUT = "image", "maps"
"""Names of the input of a network, (1, height, width, 3) uint8, and of its output, (1, `MAPS`, rows, columns)."""
HEAT, FEATURES, SCALE, WEIGHT, BIAS = SPLIT_OUTPUTS = "heat", "features", "scale", "weight", "bias"
"""Names of the outputs of a network whose last layer is split: log odds without their biases (1, 2, rows, columns); the
inputs of that layer as integers (1, rows, columns, c), and their scale; its weights (`MAPS`, c) and biases (`MAPS`,),
to be applied to single cells."""
ODDS = 2
"""The first so many maps are log odds."""


@dataclass(frozen=True, slots=True)
class Maps:
    """The maps of a network: log odds of every cell, the others as the inputs and the weights of the last layer.

    `heat` (2, rows, columns): log odds. `features` (rows, columns, c): inputs of the last layer, of any type. `weight`
    (`MAPS` - 2, c), `bias` (`MAPS` - 2,): of that layer; None where the features are the other maps themselves.
    """

    heat: NDArray[np.float32]
    features: NDArray[Any]
    weight: NDArray[np.float32] | None = None
    bias: NDArray[np.float32] | None = None

    @classmethod
    def of(cls, maps: NDArray[np.float32]) -> "Maps":
        """Of maps (`MAPS`, rows, columns)."""
        return cls(maps[:ODDS], np.moveaxis(maps[ODDS:], 0, -1))

    def values(
        self, row: NDArray[np.integer] | slice, column: NDArray[np.integer] | slice
    ) -> NDArray[np.float32]:
        """Box, colours and shapes (..., `MAPS` - 2) of cells."""
        seen = self.features[row, column].astype(np.float32)
        if self.weight is None or self.bias is None:
            return np.asarray(seen)
        return np.asarray(seen @ self.weight.T + self.bias)

    def all(self) -> NDArray[np.float32]:
        """All maps of all cells, (`MAPS`, rows, columns)."""
        rest = np.moveaxis(self.values(slice(None), slice(None)), -1, 0)
        return np.concatenate([self.heat, rest])


class DetectionNetwork:
    """A network from an ONNX file; raises ValueError where it cannot be run."""

    def __init__(self, path: str) -> None:
        self._network = OnnxNetwork(path)
        found = self.maps(np.zeros((MULTIPLE, MULTIPLE, 3), np.uint8)).all().shape
        if found != (MAPS, MULTIPLE // STRIDE, MULTIPLE // STRIDE):
            raise ValueError(
                f"the output has shape {found} instead of {MAPS} maps of a quarter of the image's size"
            )

    def maps(self, rgb: NDArray[np.uint8]) -> Maps:
        """Maps of an image, padded at the right and below to whole multiples of 32."""
        found = self._network.run({IMAGE: padded(rgb)})
        if OUTPUT in found:
            return Maps.of(found[OUTPUT][0])
        if not set(SPLIT_OUTPUTS) <= set(found):
            raise ValueError(f"there is no output {OUTPUT!r} among {sorted(found)}")
        heat, features, scale, weight, bias = (found[name] for name in SPLIT_OUTPUTS)
        heat = heat[0] + bias[:ODDS, None, None]
        return Maps(heat, features[0], weight[ODDS:] * scale, bias[ODDS:])


def padded(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image as the network takes it: (1, height, width, 3), its border repeated to whole multiples of 32."""
    height, width = rgb.shape[:2]
    more = -height % MULTIPLE, -width % MULTIPLE
    if any(more):
        rgb = np.pad(rgb, ((0, more[0]), (0, more[1]), (0, 0)), mode="edge")
    return np.ascontiguousarray(rgb)[None]


@compiled
def _keep_maxima(heat: Any, cells: Any) -> Any:
    """Move those cells (n,), numbers in (sides, rows, columns) of the heat, to the front that no neighbour exceeds."""
    rows, columns, count = heat.shape[1], heat.shape[2], 0
    for cell in cells:
        line, j = cell // columns, cell % columns
        side, i = line // rows, line % rows
        highest = True
        for y in range(max(i - 1, 0), min(i + 2, rows)):
            for x in range(max(j - 1, 0), min(j + 2, columns)):
                highest &= heat[side, i, j] >= heat[side, y, x]
        if highest:
            cells[count] = cell
            count += 1
    return count


def boxes_of_maps(
    maps: Maps, size: tuple[int, int], least_score: float, most: int, same_iou: float
) -> NetworkBoxes:
    """Faces with log odds of `least_score` and more: the best `most`, none overlapping a better one by more.

    Local maxima of the log odds, clipped to the image of `size` (height, width).
    """
    heat = maps.heat
    # twice as fast as nonzero on three axes
    cells = np.flatnonzero(heat >= least_score)
    side, row, column = np.unravel_index(cells[: _keep_maxima(heat, cells)], heat.shape)
    score = heat[side, row, column]
    order = np.argsort(-score, kind="stable")[: MAXIMA * most]
    side, row, column, score = side[order], row[order], column[order], score[order]
    values = maps.values(row, column)
    middle = np.stack([column, row], 1) * STRIDE + STRIDE / 2 + CENTRE_PX * values[:, :2]
    half = SIDE_PX / 2 * np.exp(np.clip(values[:, 2:4], -4, 5))
    box = np.concatenate([middle - half, middle + half], 1)
    box = np.clip(box, 0, size[::-1] * 2).astype(np.float32)
    fits = np.flatnonzero((box[:, 2] - box[:, 0] >= 2) & (box[:, 3] - box[:, 1] >= 2))
    every = fits[non_maximum_suppression(box[fits], same_iou)]
    kept = every[:most]
    color, shape = np.split(values[kept, 4:], [len(LEARNED_COLORS)], axis=1)
    front = heat[0][row[kept], column[kept]]
    return NetworkBoxes(box[kept], score[kept], front, color, shape, len(every) - len(kept))
