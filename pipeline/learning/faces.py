"""Clear faces as samples of colour and shape: those of rendered drives, and those boxed in real images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.stages.geometry import iou_matrix
from wayside.stages.report import SAMPLES, traced_sequences

CLEAR_FRACTION, CLEAR_PX = 0.8, 15
"""A face is a sample of colour and shape where this fraction of it is visible and it is so tall, pixels."""

WHOLE = 0.75
"""An outline is a sample of a shape where its box overlaps the face's by this much (IoU)."""

LONGEST_SIDE_PX = 64
"""Larger boxes are sampled in steps, so that the longer side has at most twice as many samples."""

MARGIN = 0.15
"""A box is enlarged by this fraction of its longer side, at least 2 px, to sample its surroundings."""


@dataclass(frozen=True, slots=True)
class FaceSample:
    """One clear view of one sign: a name for all its views, truth, mean colour of the main patch, outline.

    rgb (3,); outline (64,) complex, nan where none was found.
    """

    sign: str
    color: str
    shape: str
    rgb: NDArray[np.float64]
    outline: NDArray[np.complex128]


def clear_faces(
    rgb: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    here: list[tuple[dict[str, Any], dict[str, Any]]],
    drive: str,
) -> list[FaceSample]:
    """The faces of one image that are clear enough to be samples of colour and shape."""
    found = []
    for sign, view in here:
        clear = visible_fraction(view) >= CLEAR_FRACTION and height_px(view) >= CLEAR_PX
        pixels = rgb[mask == sign["id"]] if clear else rgb[:0, 0]
        if len(pixels) < 40 or sign["color"] not in COLORS or sign["shape"] not in SHAPES:
            continue
        box = np.array([view["box"]])
        mean = main_color(pixels)
        outline = box_outline(rgb, box[0], mean)
        found.append(
            FaceSample(
                f"{drive}/{sign['id']}",
                sign["color"],
                sign["shape"],
                mean,
                _whole(outline, box[0]),
            )
        )
    return found


def main_color(pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Mean colour (3,) of the main patch among pixels (n, 3): legends and borders are left out.

    The half nearest to the median, twice.
    """
    values = pixels.astype(np.float64)
    middle = np.median(values, axis=0)
    for _ in range(2):
        gap = ((values - middle) ** 2).sum(axis=1)
        middle = values[gap <= np.median(gap)].mean(axis=0)
    return np.asarray(middle)


def box_outline(
    rgb: NDArray[np.uint8],
    box: NDArray[Any],
    mean_rgb: NDArray[np.float64],
) -> NDArray[np.complex128]:
    """Resampled outline of the object in a box: the largest patch nearer to its colour than to its surroundings.

    The surroundings are the mean colours of the four strips between the box and the enlarged box. Holes are filled.

    Parameters
    ----------
    rgb
        The image, (height, width, 3).
    box
        [x0, y0, x1, y1], pixels, half open; rounded to whole pixels, cut at the image.
    mean_rgb
        Colour (3,) of the main patch.

    Returns
    -------
    (64,) complex u + iv in image pixels, clockwise as seen; nan where no pixel is nearer to the colour, or the box
    misses the image.
    """
    height, width, _ = rgb.shape
    corners = np.rint(np.asarray(box, np.float64)).astype(int)
    margin_px = max(2, int(MARGIN * max(corners[2:] - corners[:2]) + 0.5))
    limits = (width, height, width, height)
    x0, y0, x1, y1 = np.clip(corners, 0, limits).tolist()
    around = np.clip(corners + margin_px * np.array([-1, -1, 1, 1]), 0, limits)
    left, top, right, bottom = around.tolist()
    if x1 <= x0 or y1 <= y0:
        return np.full(SAMPLES, complex(np.nan, np.nan))
    step = -(-max(x1 - x0, y1 - y0) // LONGEST_SIDE_PX)
    part = rgb[top:bottom:step, left:right:step].astype(np.float64)
    y = top + step * np.arange(part.shape[0])[:, None]
    x = left + step * np.arange(part.shape[1])
    between = (y >= y0) & (y < y1)
    strips = (
        np.broadcast_to(y < y0, part.shape[:2]),
        np.broadcast_to(y >= y1, part.shape[:2]),
        between & (x < x0),
        between & (x >= x1),
    )
    # a strip is empty where the box reaches the image's border
    means = [part[strip].mean(axis=0) for strip in strips if strip.any()]
    others = [((part - mean) ** 2).sum(axis=2) for mean in means]
    nearer = ((part - mean_rgb) ** 2).sum(axis=2) < np.min(
        [np.full(part.shape[:2], np.inf), *others], 0
    )
    _, _, patches, _ = cv2.connectedComponentsWithStats(nearer.astype(np.uint8), connectivity=4)
    if len(patches) < 2:
        return np.full(SAMPLES, complex(np.nan, np.nan))
    u, v, wide, tall, _ = patches[1 + patches[1:, cv2.CC_STAT_AREA].argmax()]
    patch = np.array([[u, v, u + wide, v + tall]])
    sequence = traced_sequences(nearer.astype(np.uint8), patch)[0]
    return np.asarray(complex(left, top) + step * sequence)


def real_face(
    rgb: NDArray[np.uint8], color: str, shape: str, box: NDArray[Any], name: str
) -> list[FaceSample]:
    """The face in a box [x0, y0, x1, y1] of a real image as a sample; none of too few pixels."""
    x0, y0, x1, y1 = (max(0, round(float(v))) for v in box)
    pixels = rgb[y0:y1, x0:x1].reshape(-1, 3)
    if len(pixels) < 40:
        return []
    mean = main_color(pixels)
    outline = _whole(box_outline(rgb, box, mean), box)
    return [FaceSample(name, color, shape, mean, outline)]


def _whole(outline: NDArray[np.complex128], box: NDArray[Any]) -> NDArray[np.complex128]:
    """The outline where it goes round the whole box, nan where it is that of a part or of more."""
    if not np.isfinite(outline).all():
        return outline
    low = np.array([outline.real.min(), outline.imag.min()])
    high = np.array([outline.real.max(), outline.imag.max()]) + 1
    around = np.concatenate([low, high])[None]
    whole = iou_matrix(around, np.asarray(box, np.float64)[None])[0, 0] >= WHOLE
    return outline if whole else np.full_like(outline, complex(np.nan, np.nan))


def visible_fraction(view: dict[str, Any]) -> float:
    """Fraction of a face that is visible in a view of the truth."""
    return float(view["visible_fraction"] or 0.0)


def height_px(view: dict[str, Any]) -> float:
    """Height of a face in a view of the truth, pixels."""
    return float(view["box"][3] - view["box"][1])
