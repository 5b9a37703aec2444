"""Crops with targets for the detection network: a face at some scale, other faces drawn in, through some camera.

A crop is the same for the same seed and number, so that a learning run can be taken up again where it stopped.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from training.camera_effects import Noise, through_a_camera
from training.detector_images import BACK, FRONT, LabelledImage
from training.distractor_drawings import draw_distractor
from training.face_compositing import draw_faces
from training.face_drawings import FaceLibrary
from wayside.schemas.detections import NONE
from wayside.stages.detection import STRIDE
from wayside.stages.kernels import Bytes, Flags, Floats, Numbers

CROP_PX = 256
"""Side of a crop."""

AS_TAKEN = 0.3
"""Fraction of the crops that are not altered: runs see images as one camera takes them."""

ANCHOR_FRACTION, OTHER_FRACTION = 0.8, 0.3
"""Fraction of the crops cut around something of their image, the others lie anywhere; of those, around what is labelled
as no sign where there are faces as well."""

HEIGHTS_PX, SCALES = (7.0, 160.0), (0.22, 1.7)
"""Heights that faces are scaled to, log-uniform; limits of the scale."""

MOST_DISTRACTORS = 2
"""Things that are no signs are drawn into a crop up to so many times."""

FILLED = 0.85
"""Small images are not made smaller than this fraction of the crop."""

SMALLEST_PX, NARROWEST_PX, SHOWN_FRACTION = 6.5, 2.5, 0.55
"""Height and width of a face in the crop, and fraction inside, from which it is a positive; else it is ignored."""

SPREAD, LEAST_SPREAD, REGRESSED = 0.08, 0.5, 0.3
"""Sigma of the peak on the heat map as a fraction of the face; at least, cells; heat from which a cell is regressed."""

KNOWN, UNSURE, UNKNOWN = 0, 1, 2
"""A cell off all boxes is a negative; one unless the network thinks otherwise; nothing is known of it."""

UNSURE_WEIGHTS, DOUBTED = (0.5, 0.2), 0.3
"""Weights of an unsure negative, a cell or a box, below and above a probability of a face by the detection network."""

CELLS = 48
"""Most cells of a crop that are regressed."""


@dataclass(frozen=True, slots=True)
class Crop:
    """Pixels and targets of a crop; n = `CELLS` rows, unused ones of weight 0.

    `rgb` (side, side, 3) uint8. `heat` (2, cells, cells) float16: fronts and backs. `doubt` (2, cells, cells) uint8:
    `KNOWN`, `UNSURE` or `UNKNOWN`. `cell` (n,) int32 row-major, side first. `box` (n, 4) float32 pixels. `weight` (n,)
    float32, 1 a face. `color`, `shape` (n,) int64 or `NONE`.
    """

    rgb: Bytes
    heat: NDArray[np.float16]
    doubt: Bytes
    cell: NDArray[np.int32]
    box: Floats
    weight: Floats
    color: Numbers
    shape: Numbers


def drawn_crop(
    image: LabelledImage, library: FaceLibrary, noise: Noise, rng: np.random.Generator
) -> LabelledImage:
    """A square window of an image with faces and other things drawn in, as some camera takes it."""
    crop = _cut(image, rng)
    if rng.random() < 0.55:
        posts = int(rng.integers(1, 5))
        known = np.concatenate([crop.box, crop.ignored, crop.other])
        drawn = draw_faces(crop.rgb, known, library, noise.smooth, rng, posts)
        boxes = np.array([box for box, _ in drawn], np.float32).reshape(-1, 4)
        faces = [face for _, face in drawn]
        crop = replace(
            crop,
            box=np.concatenate([crop.box, boxes]),
            side=np.append(crop.side, [face.side for face in faces]).astype(np.int8),
            color=np.append(crop.color, [face.color for face in faces]).astype(np.int8),
            shape=np.append(crop.shape, [face.shape for face in faces]).astype(np.int8),
        )
    taken, others = np.concatenate([crop.box, crop.ignored]), [crop.other]
    for _ in range(int(rng.integers(0, MOST_DISTRACTORS + 1))):
        box = draw_distractor(crop.rgb, taken, noise.smooth, rng)
        if box is not None:
            others.append(np.array([box], np.float32))
    rgb = crop.rgb if rng.random() < AS_TAKEN else through_a_camera(crop.rgb, noise, rng)
    return replace(crop, rgb=rgb, other=np.concatenate(others))


def _cut(image: LabelledImage, rng: np.random.Generator) -> LabelledImage:
    """A window of the image at some scale, mirrored or not, with the faces in it."""
    height, width = image.rgb.shape[:2]
    wanted = float(np.exp(rng.uniform(*np.log(HEIGHTS_PX))))
    anchors = image.box
    if not len(anchors) or (len(image.other) and rng.random() < OTHER_FRACTION):
        anchors = image.other
    if len(anchors) and rng.random() < ANCHOR_FRACTION:
        box = anchors[rng.integers(len(anchors))]
        scale = np.clip(wanted / max(box[3] - box[1], 1), *SCALES)
        scale = min(scale, 1.4 * CROP_PX / max(box[2] - box[0], 1))
        middle = (box[:2] + box[2:]) / 2 + rng.uniform(-0.42, 0.42, 2) * CROP_PX / scale
    else:
        scale = float(np.exp(rng.uniform(np.log(0.4), np.log(1.4))))
        middle = rng.uniform(0, 1, 2) * [width, height]
    scale = max(scale, FILLED * CROP_PX / min(width, height))
    stretch = float(np.exp(rng.normal(0, 0.05)))
    scales = np.array([scale * stretch, scale / stretch])
    extent = CROP_PX / scales
    size = np.array([width, height])
    start = np.clip(middle - extent / 2, np.minimum(0, size - extent), np.maximum(0, size - extent))
    start = np.round(start)
    x0, y0 = np.maximum(start, 0).astype(int)
    x1, y1 = np.minimum(np.ceil(start + extent), size).astype(int)
    window = image.rgb[y0:y1, x0:x1]
    to = np.maximum(np.round((np.array([x1, y1]) - [x0, y0]) * scales), 1).astype(int)
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    scaled = cv2.resize(window, (int(to[0]), int(to[1])), interpolation=way)
    at = np.maximum(np.round((np.array([x0, y0]) - start) * scales), 0).astype(int)
    if at.any() or (to < CROP_PX).any():
        pixels = np.empty((CROP_PX, CROP_PX, 3), np.uint8)
        pixels[:] = rng.integers(0, 256, 3)
        shown = scaled[: CROP_PX - at[1], : CROP_PX - at[0]]
        pixels[at[1] : at[1] + shown.shape[0], at[0] : at[0] + shown.shape[1]] = shown
    else:
        pixels = np.ascontiguousarray(scaled[:CROP_PX, :CROP_PX])
    factor = to / (np.array([x1, y1]) - [x0, y0])
    shift, by = np.tile([x0, y0], 2), np.tile(factor, 2)
    box, ignored, other = (
        ((known - shift) * by + np.tile(at, 2)).astype(np.float32)
        for known in (image.box, image.ignored, image.other)
    )
    if rng.random() < 0.5:
        pixels = np.ascontiguousarray(pixels[:, ::-1])
        box, ignored, other = _mirrored(box), _mirrored(ignored), _mirrored(other)
    return replace(image, rgb=pixels, box=box, ignored=ignored, other=other)


def _mirrored(box: Floats) -> Floats:
    left, right = CROP_PX - box[:, 2], CROP_PX - box[:, 0]
    return np.stack([left, box[:, 1], right, box[:, 3]], 1)


def shown_faces(crop: LabelledImage) -> Flags:
    """Which faces (n,) of a crop are positives: the others are too small in it, or for the greater part outside."""
    inside = np.clip(crop.box, 0, CROP_PX)
    wide, tall = (inside[:, 2:] - inside[:, :2]).T
    full = np.maximum(np.prod(crop.box[:, 2:] - crop.box[:, :2], axis=1), 1e-3)
    large = (tall >= SMALLEST_PX) & (wide >= NARROWEST_PX)
    return np.asarray(large & (wide * tall >= SHOWN_FRACTION * full))


def targets(image: LabelledImage) -> Crop:
    """Maps and regressed cells of the faces of a crop, an image of `CROP_PX` by `CROP_PX`."""
    cells = CROP_PX // STRIDE
    heat = np.zeros((2, cells, cells), np.float32)
    doubt = np.zeros((2, cells, cells), np.uint8)
    for side in (FRONT, BACK):
        doubt[side] = KNOWN if image.complete[side] else UNSURE
    inside = np.clip(image.box, 0, CROP_PX)
    area = np.prod(inside[:, 2:] - inside[:, :2], axis=1)
    positive = shown_faces(image)
    unknown = np.concatenate([image.ignored, inside[~positive & (area > 0)]])
    for boxes, what in ((unknown, UNKNOWN), (image.other, KNOWN), (inside[positive], KNOWN)):
        for x0, y0, x1, y1 in np.clip(boxes, 0, CROP_PX):
            rows = slice(int(y0 // STRIDE), int(-(-y1 // STRIDE)))
            doubt[:, rows, int(x0 // STRIDE) : int(-(-x1 // STRIDE))] = what
    found: list[tuple[int, int, float]] = []
    # small faces last: where two peaks meet, the smaller face keeps its cells
    for row in sorted(np.flatnonzero(positive).tolist(), key=lambda r: -area[r]):
        found += _peak(heat[image.side[row]], inside[row], row, int(image.side[row]))
    owner = {cell: (row, weight) for cell, row, weight in found}
    best = sorted(owner.items(), key=lambda item: -item[1][1])[:CELLS]
    total: dict[int, float] = {}
    for _, (row, weight) in best:
        total[row] = total.get(row, 0.0) + weight
    crop = Crop(
        image.rgb,
        heat.astype(np.float16),
        doubt,
        np.zeros(CELLS, np.int32),
        np.zeros((CELLS, 4), np.float32),
        np.zeros(CELLS, np.float32),
        np.full(CELLS, NONE, np.int64),
        np.full(CELLS, NONE, np.int64),
    )
    for place, (cell, (row, weight)) in enumerate(best):
        crop.cell[place], crop.box[place] = cell, inside[row]
        crop.weight[place] = weight / total[row]
        crop.color[place], crop.shape[place] = image.color[row], image.shape[row]
    return crop


def _peak(heat: Floats, box: Floats, row: int, side: int) -> list[tuple[int, int, float]]:
    """Raise the heat around the middle of a face, in place; cells that are regressed, the face's row, their weights."""
    cells = heat.shape[0]
    middle = np.clip((box[:2] + box[2:]) / 2 / STRIDE - 0.5, 0, cells - 1)
    spread = np.maximum(SPREAD * (box[2:] - box[:2]) / STRIDE, LEAST_SPREAD)
    centre = np.round(middle).astype(int)
    reach = np.ceil(3 * spread).astype(int)
    low, high = np.maximum(centre - reach, 0), np.minimum(centre + reach + 1, cells)
    across = np.arange(low[0], high[0]) - centre[0]
    down = np.arange(low[1], high[1]) - centre[1]
    values = np.exp(-((across / spread[0]) ** 2)[None] / 2 - ((down / spread[1]) ** 2)[:, None] / 2)
    part = heat[low[1] : high[1], low[0] : high[0]]
    np.maximum(part, values, out=part)
    ys, xs = np.nonzero(values >= REGRESSED)
    offset = side * cells * cells
    return [
        (int(offset + (y + low[1]) * cells + x + low[0]), row, float(values[y, x]))
        for y, x in zip(ys, xs, strict=True)
    ]
