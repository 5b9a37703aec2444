"""Clear faces that teach colour and shape: those of rendered drives, and those boxed in real pictures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError
from wayside.stages.geometry import iou_matrix
from wayside.stages.report import region_sequences

CLEAR_FRACTION, CLEAR_PX = 0.8, 15
"""A face teaches colour and shape where this share of it is seen and it is so tall."""

WHOLE = 0.75
"""An outline teaches a shape where its box overlaps the face's by this much (IoU)."""


@dataclass(frozen=True, slots=True)
class FaceSample:
    """One clear view of one sign: a name for all its views, truth, mean colour of the main patch, outline.

    rgb (3,); outline (64,) complex, nan where none was found; aspect: width by height of the box.
    """

    sign: str
    color: str
    shape: str
    point_up: bool
    aspect: float
    rgb: NDArray[np.float64]
    outline: NDArray[np.complex128]


def clear_faces(
    rgb: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    here: list[tuple[dict[str, Any], dict[str, Any]]],
    drive: str,
) -> list[FaceSample]:
    """The faces of one picture that are clear enough to teach colour and shape."""
    found = []
    for sign, view in here:
        clear = visible_fraction(view) >= CLEAR_FRACTION and height_px(view) >= CLEAR_PX
        pixels = rgb[mask == sign["id"]] if clear else rgb[:0, 0]
        if len(pixels) < 40 or sign["color"] not in COLORS or sign["shape"] not in SHAPES:
            continue
        box = np.array([view["box"]])
        mean = main_color(pixels)
        size = box[0, 2:] - box[0, :2]
        outline = region_sequences(rgb, box, mean[None])[0]
        found.append(
            FaceSample(
                f"{drive}/{sign['id']}",
                sign["color"],
                sign["shape"],
                bool(sign.get("point_up", False)),
                float(size[0] / size[1]),
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


def real_faces(folder: Path) -> list[FaceSample]:
    """Faces of the signs boxed in real pictures: `scenes/scenes.json` and `scenes/crops/crops.json` of a folder."""
    scenes = folder / "scenes"
    try:
        listed = json.loads((scenes / "scenes.json").read_text(encoding="utf-8"))
        crops = json.loads((scenes / "crops" / "crops.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{scenes}: wanted scenes.json and crops/crops.json, found {error}; correct --real"
        ) from error
    found: list[FaceSample] = []
    for scene in listed:
        rgb = _read_rgb(scenes / scene["file"])
        for number, sign in enumerate(scene["signs"]):
            found += _real_face(rgb, sign, np.array(sign["box"]), f"{scene['file']}/{number}")
    for crop in crops:
        rgb = _read_rgb(scenes / crop["file"])
        # The crops have a margin of about an eighth on every side.
        x, y = rgb.shape[1] / 8, rgb.shape[0] / 8
        box = np.array([x, y, rgb.shape[1] - x, rgb.shape[0] - y])
        # Crops of one kind mostly show one sign.
        found += _real_face(rgb, crop, box, f"crop/{crop['kind']}")
    return found


def _real_face(
    rgb: NDArray[np.uint8], sign: dict[str, Any], box: NDArray[Any], name: str
) -> list[FaceSample]:
    x0, y0, x1, y1 = (max(0, round(float(v))) for v in box)
    pixels = rgb[y0:y1, x0:x1].reshape(-1, 3)
    if len(pixels) < 40 or sign["color"] not in COLORS or sign["shape"] not in SHAPES:
        return []
    mean = main_color(pixels)
    outline = region_sequences(rgb, np.array([box], np.float64), mean[None])[0]
    aspect = (x1 - x0) / (y1 - y0)
    face = FaceSample(name, sign["color"], sign["shape"], False, aspect, mean, _whole(outline, box))
    return [face]


def _whole(outline: NDArray[np.complex128], box: NDArray[Any]) -> NDArray[np.complex128]:
    """The outline where it goes round the whole box, nan where it is that of a part or of more."""
    if not np.isfinite(outline).all():
        return outline
    low = np.array([outline.real.min(), outline.imag.min()])
    high = np.array([outline.real.max(), outline.imag.max()]) + 1
    around = np.concatenate([low, high])[None]
    whole = iou_matrix(around, np.asarray(box, np.float64)[None])[0, 0] >= WHOLE
    return outline if whole else np.full_like(outline, complex(np.nan, np.nan))


def _read_rgb(path: Path) -> NDArray[np.uint8]:
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    if pixels is None:
        raise InputError(f"{path}: wanted a picture, found none that can be read; correct --real")
    return np.ascontiguousarray(pixels, np.uint8)


def visible_fraction(view: dict[str, Any]) -> float:
    """Share of a face that is visible in a view of the truth."""
    return float(view["visible_fraction"] or 0.0)


def height_px(view: dict[str, Any]) -> float:
    """Height of a face in a view of the truth, pixels."""
    return float(view["box"][3] - view["box"][1])
