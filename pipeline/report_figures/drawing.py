"""Cut-outs of images with boxes and outlines, and several of them as one picture."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wayside.pipeline.learning.page import Picture

Ink = tuple[int, int, int]
ACCENT: Ink = (255, 0, 140)
SIGN_INK: Ink = (255, 230, 0)
_PAPER, _GAP, _SHIFT = 255, 6, 4
_WIDEST, _QUALITY = 1100, 82


def around(
    box: ArrayLike, size: tuple[int, int], *, times: float = 2.4, least: int = 40
) -> tuple[int, int, int, int]:
    """Corners x0, y0, x1, y1 of a square cut-out this many times as large as a box, inside an image (height, width)."""
    x0, y0, x1, y1 = (float(v) for v in np.asarray(box))
    side = min(max(round(times * max(x1 - x0, y1 - y0)), least), *size)
    left = int(np.clip(round((x0 + x1 - side) / 2), 0, size[1] - side))
    top = int(np.clip(round((y0 + y1 - side) / 2), 0, size[0] - side))
    return left, top, left + side, top + side


def cut(
    image: NDArray[np.uint8], corners: tuple[int, int, int, int], tall: int
) -> NDArray[np.uint8]:
    """A cut-out as RGB, enlarged or shrunk to a height."""
    x0, y0, x1, y1 = corners
    part = image[y0:y1, x0:x1]
    part = part if part.ndim == 3 else np.repeat(part[..., None], 3, axis=2)
    size = (max(round((x1 - x0) * tall / (y1 - y0)), 1), tall)
    method = cv2.INTER_NEAREST if tall > y1 - y0 else cv2.INTER_AREA
    return np.asarray(cv2.resize(np.ascontiguousarray(part), size, interpolation=method), np.uint8)


def beside(images: Sequence[NDArray[np.uint8]], columns: int = 99) -> NDArray[np.uint8]:
    """Pictures of one height in rows of so many, with gaps."""
    tall = images[0].shape[0]
    rows = [images[i : i + columns] for i in range(0, len(images), columns)]
    wide = max(sum(one.shape[1] + _GAP for one in row) for row in rows) - _GAP
    page = np.full((len(rows) * (tall + _GAP) - _GAP, wide, 3), _PAPER, np.uint8)
    for r, row in enumerate(rows):
        left = 0
        for one in row:
            top = r * (tall + _GAP)
            page[top : top + tall, left : left + one.shape[1]] = one
            left += one.shape[1] + _GAP
    return page


def boxed(
    rgb: NDArray[np.uint8], boxes: Sequence[ArrayLike], ink: Ink = ACCENT, width: int = 3
) -> NDArray[np.uint8]:
    """A copy with rectangles round boxes."""
    page = rgb.copy()
    for box in boxes:
        x0, y0, x1, y1 = (round(float(v)) for v in np.asarray(box))
        cv2.rectangle(page, (x0 - 1, y0 - 1), (x1, y1), ink, width)
    return page


def lined(
    image: NDArray[np.uint8],
    corners: tuple[int, int, int, int],
    tall: int,
    curves: Sequence[tuple[NDArray[np.complex128], Ink]],
) -> NDArray[np.uint8]:
    """A cut-out with closed curves u + iv of the image on it."""
    page = cut(image, corners, tall)
    scale = tall / (corners[3] - corners[1])
    for curve, ink in curves:
        at = np.column_stack([curve.real - corners[0] + 0.5, curve.imag - corners[1] + 0.5]) * scale
        fixed = np.rint((at - 0.5) * (1 << _SHIFT)).astype(np.int32)[:, None]
        cv2.polylines(page, [fixed], True, ink, 2, cv2.LINE_AA, _SHIFT)
    return page


def grey_of(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Values as grey levels, 255 at most."""
    return np.asarray(np.minimum(np.rint(values), 255), np.uint8)


def photo(rgb: NDArray[np.uint8], words: str = "", *, scale: float = 1.0) -> Picture:
    """An image (height, width, 3) RGB or (height, width) grey as JPEG, enlarged by a factor, shrunk where too wide."""
    factor = min(scale, _WIDEST / rgb.shape[1])
    size = (max(round(rgb.shape[1] * factor), 1), max(round(rgb.shape[0] * factor), 1))
    method = cv2.INTER_CUBIC if factor > 1 else cv2.INTER_AREA
    shown = cv2.resize(rgb, size, interpolation=method)
    if shown.ndim == 3:
        shown = cv2.cvtColor(shown, cv2.COLOR_RGB2BGR)
    _, coded = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    source = base64.b64encode(coded.tobytes()).decode()
    alt = f'width="{size[0]}" height="{size[1]}" alt="{escape(words)}"'
    return Picture(f'<img src="data:image/jpeg;base64,{source}" {alt}>', words)
