"""One sign panel and the strokes that paint it.

Panel coordinates: metres, x right and y down from the top-left corner of the panel's bounding box.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import cv2
import numpy as np

from recordings.drives.arrays import Bytes
from recordings.drives.signs.shapes import Points, circle, outline, shrunk

INCH = 0.0254
PX_PER_M = 400

COLORS = {
    "white": (232, 233, 228),
    "yellow": (250, 186, 16),
    "green": (0, 104, 72),
    "red": (176, 26, 40),
    "orange": (240, 106, 24),
    "blue": (10, 66, 142),
    "brown": (96, 58, 32),
    "fluorescent_yellow_green": (198, 232, 28),
    "black": (24, 24, 26),
    "grey": (150, 152, 154),
}
"""Sheeting, sRGB."""

_Choice = TypeVar("_Choice")


def pick(rng: np.random.Generator, options: Sequence[_Choice]) -> _Choice:
    """One of the options, each as likely."""
    return options[int(rng.integers(len(options)))]


def fill_polygon(image: Bytes, points: Points, value: int | tuple[int, ...]) -> None:
    """Fill a polygon in metres, antialiased."""
    shifted = np.round((np.array(points) * PX_PER_M - 0.5) * 16).astype(np.int32)
    cv2.fillPoly(image, [shifted], value if isinstance(value, tuple) else (value,), cv2.LINE_AA, 4)


def _capitals(text: str, weight: float) -> Bytes:
    """Coverage of a line of capitals, cropped; the stroke is `weight` times the letters' height."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 4.0
    (width, height), _ = cv2.getTextSize(text, font, size, 1)
    thickness = max(1, round(height * weight))
    pad = thickness * 2
    plate: Bytes = np.zeros((height + 2 * pad + height // 2, width + 2 * pad), np.uint8)
    cv2.putText(plate, text, (pad, pad + height), font, size, 255, thickness, cv2.LINE_AA)
    columns, rows = np.flatnonzero(plate.any(axis=0)), np.flatnonzero(plate.any(axis=1))
    return plate[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


@dataclass
class Face:
    """One sign panel before it is placed: width and height in metres, painted in sRGB."""

    kind: str
    color: str
    shape: str
    width: float
    height: float
    legend: str = ""
    secondary: tuple[str, ...] = ()
    outlines: list[Points] = field(default_factory=list)  # closed polygons, panel coordinates
    image: Bytes = field(init=False)  # (rows, columns, 3)

    def __post_init__(self) -> None:
        """Lay the sheeting."""
        rows, columns = (max(4, round(v * PX_PER_M)) for v in (self.height, self.width))
        self.image = np.zeros((rows, columns, 3), np.uint8)
        self.image[:] = COLORS[self.color]
        if not self.outlines:
            self.outlines = [outline(self.shape, self.width, self.height)]

    def fill(self, points: Points, color: str) -> None:
        """Filled polygon."""
        fill_polygon(self.image, points, COLORS[color])

    def box(self, left: float, top: float, right: float, bottom: float, color: str) -> None:
        """Filled upright rectangle."""
        self.fill([(left, top), (right, top), (right, bottom), (left, bottom)], color)

    def disc(self, x: float, y: float, radius: float, color: str) -> None:
        """Filled circle."""
        self.fill(circle(x, y, radius), color)

    def line(self, points: Points, color: str, width: float) -> None:
        """Polyline with round ends."""
        pixels = np.round(np.array(points) * PX_PER_M).astype(np.int32)
        thickness = max(1, round(width * PX_PER_M))
        cv2.polylines(self.image, [pixels], False, COLORS[color], thickness, cv2.LINE_AA)

    def arrow(self, points: Points, color: str, width: float) -> None:
        """Polyline that ends in an arrow head."""
        path = np.array(points, float)
        direction = path[-1] - path[-2]
        direction /= np.linalg.norm(direction)
        normal = np.array([-direction[1], direction[0]])
        neck, tip = path[-1] - direction * width * 1.6, path[-1] + direction * width * 0.4
        barbs = neck + normal * width * 1.5, neck - normal * width * 1.5
        self.line([(x, y) for x, y in (*path[:-1], neck)], color, width)
        self.fill([(x, y) for x, y in (tip, *barbs)], color)

    def border(self, color: str, width: float, inset: float = 0.0) -> None:
        """Border line parallel to the outline."""
        outside = np.array(self.outlines[0])
        uneven = self.shape in ("triangle", "pentagon", "pennant")
        centre = outside.mean(axis=0) if uneven else np.array([self.width, self.height]) / 2
        outer = shrunk(outside, centre, inset, self.shape)
        inner = shrunk(outside, centre, inset + width, self.shape)
        before = self.image.copy()
        self.fill(outer, color)
        inner_mask: Bytes = np.zeros(self.image.shape[:2], np.uint8)
        outer_mask: Bytes = np.zeros_like(inner_mask)
        fill_polygon(inner_mask, inner, 255)
        fill_polygon(outer_mask, outer, 255)
        keep = np.clip(inner_mask[..., None] / 255.0 + (1 - outer_mask[..., None] / 255.0), 0, 1)
        self.image[:] = np.round(before * keep + self.image * (1 - keep))

    def text(
        self,
        text: str,
        centre: tuple[float, float],
        height: float,
        color: str,
        max_width: float | None = None,
        weight: float = 0.17,
    ) -> None:
        """One line of capitals, narrowed to `max_width`; it joins the legend."""
        limit = (self.width * 0.84 if max_width is None else max_width) * PX_PER_M
        plate = _capitals(text, weight)
        rows = max(2, round(height * PX_PER_M))
        columns = max(2, round(min(plate.shape[1] * rows / plate.shape[0], limit)))
        plate = np.asarray(cv2.resize(plate, (columns, rows), interpolation=cv2.INTER_AREA))
        left = round(centre[0] * PX_PER_M - columns / 2)
        top = round(centre[1] * PX_PER_M - rows / 2)
        x0, y0 = max(left, 0), max(top, 0)
        x1 = min(left + columns, self.image.shape[1])
        y1 = min(top + rows, self.image.shape[0])
        if x1 <= x0 or y1 <= y0:
            return
        alpha = plate[y0 - top : y1 - top, x0 - left : x1 - left, None] / 255.0
        region = self.image[y0:y1, x0:x1]
        region[:] = np.round(region * (1 - alpha) + np.array(COLORS[color]) * alpha)
        self.legend = f"{self.legend} {text}".strip()

    def lines(self, lines: Sequence[str], color: str, top: float, bottom: float) -> None:
        """Text lines spread evenly between top and bottom (m)."""
        pitch = (bottom - top) / len(lines)
        for i, text in enumerate(lines):
            half = abs(top + pitch * (i + 0.5) - self.height / 2)
            room = self.width * 0.84
            if self.shape == "diamond":
                room = max(0.3, 0.92 - 2 * (half + pitch * 0.3) / self.height) * self.width
            self.text(text, (self.width / 2, top + pitch * (i + 0.5)), pitch * 0.68, color, room)

    def alpha(self) -> Bytes:
        """Coverage of the panel's shape."""
        mask: Bytes = np.zeros(self.image.shape[:2], np.uint8)
        for points in self.outlines:
            fill_polygon(mask, points, 255)
        return mask


def panel(
    kind: str, color: str, size: tuple[float, float], ink: str, lines: Sequence[str] = ()
) -> Face:
    """Rectangle of (width, height) metres with border and text."""
    width, height = size
    face = Face(kind, color, "rectangle", width, height, secondary=(ink,))
    face.border(ink, max(0.012, 0.018 * min(width, height) / 0.6), 0.012)
    if lines:
        face.lines(lines, ink, height * 0.12, height * 0.9)
    return face


def bordered(
    kind: str,
    color: str,
    shape: str,
    size: tuple[float, float],
    ink: str,
    border: tuple[float, float],
) -> Face:
    """Panel of (width, height) metres with a border of (width, inset) metres and nothing else."""
    face = Face(kind, color, shape, *size, secondary=(ink,))
    face.border(ink, *border)
    return face
