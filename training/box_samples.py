"""Boxes with targets for the box network, from crops as the detection network learns from.

What it will be asked about: the boxes of the detection network, boxes near faces, as segments and tracks give them, and
some anywhere. A face is its whole panel: the less a box overlaps it, the less it counts as one.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from training.detector_crops import (
    CROP_PX,
    DOUBTED,
    KNOWN,
    UNKNOWN,
    UNSURE,
    UNSURE_WEIGHTS,
    shown_faces,
)
from training.detector_images import LabelledImage
from training.truth import UNION, second_faces
from wayside.schemas.detections import NONE
from wayside.stages.detection import ODDS, STRIDE, DetectionNetwork, Part, boxes_of_maps
from wayside.stages.geometry import iou_matrix
from wayside.stages.kernels import Array, Bytes, Flags, Floats, Numbers

PROPOSED, LEAST_SCORE, SAME_IOU = 14, -6.0, 0.6
"""Boxes of the detection network in a crop, its best; least log odds; overlap above which the lower is left out."""

MOVED_EACH = 3
"""One of so many of these comes once more, moved."""

FACES, OTHERS, AROUND = 3, 2, 4
"""Faces of a crop, and things known as none, that boxes are laid around, at most, and how many around each."""

LAID = (0.02, 0.5)
"""How far boxes around a face are off: sigma of middle and of log size, log-uniform."""

ANYWHERE, ANYWHERE_PX = 2, (8.0, 90.0)
"""Boxes anywhere in a crop, and their sides, log-uniform."""

NARROWEST_PX, SHORTEST_PX = 3.0, 5.0
"""Boxes of less width or height are left out."""

NO_FACE, WHOLE_FACE = 0.25, 0.75
"""Overlap (IoU) with a face up to which a box is none, and from which it is wholly one."""

REGRESSED, NAMED = 0.3, 0.45
"""Overlap from which the sides of a box, and its colour and shape, are those of the face."""

IGNORED = 0.2
"""Overlap with a place where nothing is known from which a box off all faces does not count."""


@dataclass(frozen=True, slots=True)
class BoxTargets:
    """Boxes (n, 4) of a crop and what a network is to say of them.

    `size` (n, 2) float32: width and height in pixels. `panel` (n, 2) float32: how far the box is a front and a back, 0
    to 1. `weight` (n, 2) float32 of these. `offset` (n, 4) float32: of its sides to those of the face, in box sizes,
    nan where none is near. `color`, `shape` (n,) int64 or `NONE`.
    """

    box: Floats
    size: Floats
    panel: Floats
    weight: Floats
    offset: Floats
    color: Numbers
    shape: Numbers


def boxes_of_crop(
    crop: LabelledImage, doubt: Bytes, network: DetectionNetwork, rng: np.random.Generator
) -> BoxTargets:
    """Boxes of a crop; doubt: what is known of each of its cells, as in `Crop`."""
    maps = network.maps(crop.rgb)
    whole = [Part(maps, (CROP_PX, CROP_PX))]
    found = boxes_of_maps(whole, whole[0].seen, LEAST_SCORE, PROPOSED, SAME_IOU).box
    shown = shown_faces(crop)
    named = [rng.permutation(crop.box[shown])[:FACES], rng.permutation(crop.other)[:OTHERS]]
    size = _log_uniform(ANYWHERE_PX, (ANYWHERE, 2), rng)
    box = np.concatenate(
        [
            found,
            laid_around(found[::MOVED_EACH], 1, rng),
            laid_around(np.clip(np.concatenate(named), 0, CROP_PX), AROUND, rng),
            _boxes(rng.uniform(0, CROP_PX, (ANYWHERE, 2)), size),
        ]
    )
    box = np.clip(box, 0, CROP_PX).astype(np.float32)
    wide, tall = (box[:, 2:] - box[:, :2]).T
    box = box[(wide >= NARROWEST_PX) & (tall >= SHORTEST_PX)]
    row, column = (((box[:, k] + box[:, k + 2]) / (2 * STRIDE)).astype(int) for k in (1, 0))
    last = CROP_PX // STRIDE - 1
    row, column = np.minimum(row, last), np.minimum(column, last)
    weight = negative_weights(doubt[:, row, column].T, maps.all()[:ODDS, row, column].T)
    return _targets(box, crop, shown, weight)


def laid_around(box: Floats, each: int, rng: np.random.Generator) -> Array:
    """So many boxes around each of these (n, 4), some nearly the same, some far off: (n * each, 4)."""
    box = np.repeat(box, each, axis=0)
    size, middle = box[:, 2:] - box[:, :2], (box[:, :2] + box[:, 2:]) / 2
    sigma = _log_uniform(LAID, (len(box), 1), rng)
    middle = middle + 0.6 * sigma * size * rng.normal(0, 1, (len(box), 2))
    return _boxes(middle, size * np.exp(sigma * rng.normal(0, 1, (len(box), 2))))


def _log_uniform(
    limits: tuple[float, float], shape: tuple[int, int], rng: np.random.Generator
) -> Array:
    low, high = limits
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def _boxes(middle: NDArray[np.floating[Any]], size: NDArray[np.floating[Any]]) -> Array:
    return np.concatenate([middle - size / 2, middle + size / 2], axis=1)


def negative_weights(doubt: Bytes, seen: Floats) -> Floats:
    """Weights (n, 2) of boxes off all faces, by what is known there and the log odds of the detection network."""
    below, above = UNSURE_WEIGHTS
    unsure = np.where(seen < np.log(DOUBTED / (1 - DOUBTED)), below, above)
    known = np.select([doubt == KNOWN, doubt == UNSURE, doubt == UNKNOWN], [1.0, unsure, 0.0])
    return known.astype(np.float32)


def _targets(box: Floats, crop: LabelledImage, shown: Flags, weight: Floats) -> BoxTargets:
    n = len(box)
    size = box[:, 2:] - box[:, :2]
    panel, offset = np.zeros((n, 2), np.float32), np.full((n, 4), np.nan, np.float32)
    color, shape = np.full(n, NONE, np.int64), np.full(n, NONE, np.int64)
    overlap = np.zeros(n)
    if shown.any():
        faces = np.clip(crop.box[shown], 0, CROP_PX)
        every = iou_matrix(box, faces)
        nearest, overlap = every.argmax(axis=1), every.max(axis=1)
        share = np.clip((overlap - NO_FACE) / (WHOLE_FACE - NO_FACE), 0, 1)
        # a network that accepts boxes around a sign and its plaque loses the plaque
        share[(overlap < UNION) & second_faces(box, faces, nearest).any(axis=1)] = 0
        panel[np.arange(n), crop.side[shown][nearest]] = share
        near, named = overlap >= REGRESSED, overlap >= NAMED
        offset[near] = ((faces[nearest] - box) / np.tile(size, 2))[near]
        color[named], shape[named] = (
            column[shown][nearest][named] for column in (crop.color, crop.shape)
        )
    weight = np.where(overlap[:, None] > NO_FACE, np.float32(1), weight)
    unknown = np.concatenate([crop.ignored, crop.box[~shown]])
    if len(unknown):
        hidden = iou_matrix(box, unknown).max(axis=1) > IGNORED
        weight[hidden & (overlap <= NO_FACE)] = 0
    return BoxTargets(box, size, panel, weight, offset, color, shape)
