"""Boxes of sign faces by the detection network: heat map of middles, boxes, colours and shapes at stride 4."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import LEARNED_COLORS, SHAPES, NetworkBoxes
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.geometry import non_maximum_suppression
from wayside.stages.kernels import compiled, compiled_within

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

    `heat` (2, rows, columns) float32: log odds but for their biases. `features` (rows, columns, c): inputs of the last
    layer, of any type. `weight` (c, `MAPS`), `bias` (`MAPS`,) float32: of that layer.
    """

    heat: NDArray[np.float32]
    features: NDArray[Any]
    weight: NDArray[np.float32]
    bias: NDArray[np.float32]

    @classmethod
    def of(cls, maps: NDArray[np.float32]) -> "Maps":
        """Of maps (`MAPS`, rows, columns)."""
        weight = np.eye(MAPS - ODDS, MAPS, ODDS, np.float32)
        return cls(maps[:ODDS], np.moveaxis(maps[ODDS:], 0, -1), weight, np.zeros(MAPS, np.float32))

    def all(self) -> NDArray[np.float32]:
        """All maps of all cells, (`MAPS`, rows, columns)."""
        found = np.moveaxis(self.features.astype(np.float32) @ self.weight, -1, 0)
        found[:ODDS] = self.heat
        return np.asarray(found + self.bias[:, None, None])


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
        return Maps(heat[0], features[0], np.multiply(weight.T, scale, order="C"), bias)


def padded(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image as the network takes it: (1, height, width, 3), its border repeated to whole multiples of 32."""
    height, width = rgb.shape[:2]
    more = -height % MULTIPLE, -width % MULTIPLE
    if any(more):
        rgb = np.pad(rgb, ((0, more[0]), (0, more[1]), (0, 0)), mode="edge")
    return np.ascontiguousarray(rgb)[None]


@compiled_within
def _best_maxima(heat: Any, bias: Any, least: Any, cell: Any, score: Any) -> Any:
    """Number of the local maxima of log odds of `least` and more; numbers (n,) of the best cells, and their log odds.

    Cells are numbered row by row; the best are first, and of equal ones the earlier.
    """
    rows, columns, count = heat.shape[1], heat.shape[2], 0
    for line in range(heat.shape[0] * rows):
        side, i = line // rows, line % rows
        likely = 0
        for j in range(columns):  # without a branch, which is quick: most rows have none
            likely += heat[side, i, j] + bias[side] >= least
        for j in range(columns if likely else 0):
            own = heat[side, i, j] + bias[side]
            highest = own >= least
            for y in range(max(i - 1, 0), min(i + 2, rows) if highest else 0):
                for x in range(max(j - 1, 0), min(j + 2, columns)):
                    highest &= own >= heat[side, y, x] + bias[side]
            if highest and (count < len(cell) or own > score[-1]):
                count = min(count + 1, len(cell))
                k = count - 1
                while k > 0 and score[k - 1] < own:
                    score[k], cell[k] = score[k - 1], cell[k - 1]
                    k -= 1
                score[k], cell[k] = own, i * columns + j
    return count


@compiled
def _read_boxes(
    layer: Any, part: Any, size: Any, least: Any, most: Any, first: Any, found: Any
) -> Any:
    """Fill rows `[*box, score, front, shape]` by the `most` best maxima, from row `first` on; the row after the last.

    `layer`: the fields of `Maps`; `part`: the other fields of `Part`. Boxes of less than 2 px are left out.
    """
    (heat, features, weight, bias), (seen, corner, scale) = layer, part
    cell, score = np.empty(most, np.int64), np.empty(most, np.float32)
    values = np.empty(MAPS, np.float32)
    for n in range(_best_maxima(heat, bias, least, cell, score)):
        i, j = cell[n] // heat.shape[2], cell[n] % heat.shape[2]
        values[:] = 0
        for c in range(len(weight)):
            for k in range(MAPS):
                values[k] += np.float32(features[i, j, c]) * weight[c, k]
        values += bias
        fits = True
        for k in range(2):
            middle = (j, i)[k] * STRIDE + STRIDE / 2 + CENTRE_PX * values[ODDS + k]
            half = SIDE_PX / 2 * np.exp(min(max(values[ODDS + 2 + k], -4), 5))
            low, high = max(middle - half, 0), min(middle + half, seen[1 - k])
            before, after = corner[k], size[1 - k] - corner[k] - (seen[1 - k] + 1) * scale
            cut = (low == 0 and before > 0) or (high == seen[1 - k] and after >= 0)
            fits &= high - low >= 2 and not cut
            found[first, k], found[first, k + 2] = corner[k] + scale * low, corner[k] + scale * high
        if fits:
            found[first, 4], found[first, 5] = score[n], heat[0, i, j] + bias[0]
            found[first, 6] = np.argmax(values[-len(SHAPES) :])
            first += 1
    return first


class Part(NamedTuple):
    """Part of an image from `corner` (x, y) on as a network sees it; a pixel of it is `scale` of the image, 1/4 to 2.

    `maps`: of the network; `seen`: height and width of its input.
    """

    maps: Maps
    seen: tuple[int, ...]
    corner: tuple[int, int] = (0, 0)
    scale: float = 1.0


def boxes_of_maps(
    parts: Sequence[Part], size: tuple[int, ...], least_score: float, most: int, same_iou: float
) -> NetworkBoxes:
    """Faces in an image (height, width) with log odds of `least_score` and more: the best `most`, in its pixels.

    Local maxima of the log odds; none overlaps a better one by more than `same_iou`. Boxes that a border of a part cuts
    off where the image goes on are left out: another part shows such a face whole.
    """
    every, count = np.empty((len(parts) * MAXIMA * most, 7), np.float32), 0
    for maps, *part in parts:
        layer = maps.heat, maps.features, maps.weight, maps.bias
        least, among = np.float32(least_score), MAXIMA * most
        count = _read_boxes(layer, tuple(part), size[:2], least, among, count, every)
    every = every[np.argsort(-every[:count, 4], kind="stable")]
    apart = non_maximum_suppression(every[:, :4], same_iou)
    best = every[apart[:most]]
    box, shape = np.ascontiguousarray(best[:, :4]), best[:, 6].astype(np.int8)
    return NetworkBoxes(box, best[:, 4], best[:, 5], shape, len(apart) - len(best))
