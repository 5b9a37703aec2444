"""A page to draw on: text in a proper typeface and shapes placed to a fraction of a pixel."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wayside.pipeline.evidence.marks import Ink

PAPER: Ink = (255, 255, 255)
PANEL: Ink = (244, 246, 248)
RULE: Ink = (217, 222, 228)
TEXT: Ink = (22, 27, 34)
FAINT: Ink = (96, 106, 118)
ACCENT: Ink = (214, 0, 128)
"""A colour that no sign has, for boxes and ellipses."""
REGULAR, MEDIUM, BOLD = 400, 500, 650

_SHIFT = 4
_SUBPIXEL = 1 << _SHIFT
_IMAGE_SIZE = (0, 0)
_CUT_SIGN = "..."


class Canvas:
    """RGB page of a given size; x right, y down, pixels."""

    def __init__(self, width: int, height: int, ground: Ink = PAPER) -> None:
        self.rgb = np.full((height, width, 3), ground, np.uint8)

    def text(
        self,
        at: tuple[float, float],
        words: str,
        size: int,
        ink: Ink = TEXT,
        weight: int = REGULAR,
        *,
        right: bool = False,
    ) -> None:
        """Write one line that starts (or, with `right`, ends) at a point of the baseline."""
        x = at[0] - (text_width(words, size, weight) if right else 0)
        cv2.putText(self.rgb, words, (round(x), round(at[1])), ink, _typeface(), size, weight)

    def line(
        self, points: ArrayLike, ink: Ink, thickness: int = 1, *, closed: bool = False
    ) -> None:
        """A line through points (n, 2)."""
        fixed = _fixed(points)
        if len(fixed) > 1:
            cv2.polylines(self.rgb, [fixed], closed, ink, thickness, cv2.LINE_AA, _SHIFT)

    def polygon(
        self, points: ArrayLike, fill: Ink, edge: Ink | None = None, width: int = 1
    ) -> None:
        """A filled polygon of corners (n, 2)."""
        cv2.fillPoly(self.rgb, [_fixed(points)], fill, cv2.LINE_AA, _SHIFT)
        if edge is not None:
            self.line(points, edge, width, closed=True)

    def dot(self, at: ArrayLike, radius: float, fill: Ink, edge: Ink | None = None) -> None:
        """A filled circle."""
        x, y = (int(v) for v in _fixed(np.asarray(at))[0, 0])
        fixed = round(radius * _SUBPIXEL)
        cv2.circle(self.rgb, (x, y), fixed, fill, -1, cv2.LINE_AA, _SHIFT)
        if edge is not None:
            cv2.circle(self.rgb, (x, y), fixed, edge, 2, cv2.LINE_AA, _SHIFT)

    def block(self, corner: tuple[int, int], size: tuple[int, int], fill: Ink) -> None:
        """A filled rectangle with its upper left corner and size."""
        (x, y), (width, height) = corner, size
        self.rgb[y : y + height, x : x + width] = fill

    def frame(self, corner: tuple[int, int], size: tuple[int, int], ink: Ink = RULE) -> None:
        """A hairline just inside a rectangle."""
        (x, y), (width, height) = corner, size
        cv2.rectangle(self.rgb, (x, y), (x + width - 1, y + height - 1), ink, 1)

    def paste(self, corner: tuple[int, int], image: NDArray[np.uint8]) -> None:
        """Put an image (height, width, 3) with its upper left corner at a point."""
        (x, y), (height, width) = corner, image.shape[:2]
        self.rgb[y : y + height, x : x + width] = image


def text_width(words: str, size: int, weight: int = REGULAR) -> int:
    """How far a line of text reaches, pixels."""
    return int(cv2.getTextSize(_IMAGE_SIZE, words, (0, 0), _typeface(), size, weight)[2])


def shortened(words: str, size: int, weight: int, width: int) -> str:
    """The words, cut in the middle where they are wider than `width` pixels, so that a number at the end stays."""
    if text_width(words, size, weight) <= width:
        return words
    for kept in range(len(words) - 1, 1, -1):
        head, tail = (kept + 1) // 2, kept // 2
        short = words[:head] + _CUT_SIGN + words[-tail:]
        if text_width(short, size, weight) <= width:
            return short
    return _CUT_SIGN


@cache
def _typeface() -> Any:
    """The sans-serif typeface that comes with OpenCV, all its figures of one width."""
    return cv2.FontFace("sans")


def _fixed(points: ArrayLike) -> NDArray[np.int32]:
    """Points (n, 2) as (n, 1, 2) fixed-point numbers."""
    scaled = np.asarray(points, np.float64).reshape(-1, 1, 2) * _SUBPIXEL
    return np.rint(np.clip(scaled, -(2**30), 2**30)).astype(np.int32)
