"""Boards invented for learning: lines of words, arrows, pictograms and inserted panels, in the colours of signs."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

SHEETING = {
    "white": (235, 235, 232),
    "yellow": (250, 190, 10),
    "green": (10, 110, 70),
    "red": (190, 25, 40),
    "orange": (245, 120, 10),
    "blue": (15, 75, 165),
    "brown": (95, 55, 35),
    "fluorescent_yellow_green": (190, 235, 30),
    "black": (25, 25, 27),
}
"""Colours of boards, RGB."""

LIGHT = ("white", "yellow", "orange", "fluorescent_yellow_green")
"""Those with dark letters."""

WORDS = (
    "EXIT",
    "NORTH",
    "Madrid",
    "A 96",
    "City",
    "Main St",
    "Park",
    "1/2 MILE",
    "ONE WAY",
    "Ausfahrt",
    "LANE",
    "ONLY",
    "Hospital",
    "Centre",
    "280",
    "BUS",
    "P",
    "12 km",
    "Lake",
    "ROAD WORK",
)

TYPEFACES = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX)
"""Typefaces of boards: upright, without serifs."""

LETTERS = "abcdefghijklmnopqrstuvwxyz"

ASPECTS = (0.45, 4.8)
"""Width over height, log-uniform."""

LONGEST_PX = 256
"""Longer side of a board, or less."""

MOST_LINES = 6

ARROW, PICTOGRAM, INSERT = 0.4, 0.3, 0.2
"""How often a board has an arrow, a pictogram, and a panel of another colour behind one of its lines."""

Ink = tuple[int, ...]
Pixels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Area:
    """A part of a board, in pixels."""

    left: float
    top: float
    right: float
    bottom: float

    def split(self, share: float, rng: np.random.Generator) -> tuple[Area, Area]:
        """A part of it at one end of its longer side, and the rest."""
        across = self.right - self.left > self.bottom - self.top
        low, high = (self.left, self.right) if across else (self.top, self.bottom)
        is_first = rng.random() < 0.5
        at = low + (high - low) * (share if is_first else 1 - share)
        if across:
            parts = (
                Area(self.left, self.top, at, self.bottom),
                Area(at, self.top, self.right, self.bottom),
            )
        else:
            parts = (
                Area(self.left, self.top, self.right, at),
                Area(self.left, at, self.right, self.bottom),
            )
        return parts if is_first else (parts[1], parts[0])

    def fitted(self, unit: NDArray[np.float64]) -> NDArray[np.int32]:
        """Points (n, 2) of -1 to 1 in the largest square in its middle, with a margin; pixels."""
        middle = np.array([self.left + self.right, self.top + self.bottom]) / 2
        half = 0.42 * min(self.right - self.left, self.bottom - self.top)
        return np.round(middle + half * unit).astype(np.int32)


def draw_board(color: str, rng: np.random.Generator) -> Pixels:
    """A board (h, w, 4), RGBA, whose ground has a colour of `SHEETING`."""
    aspect = float(np.exp(rng.uniform(*np.log(ASPECTS))))
    width = LONGEST_PX if aspect >= 1 else max(80, round(LONGEST_PX * aspect))
    height = max(48, round(width / aspect))
    ground: Ink = tuple(np.clip(SHEETING[color] + rng.normal(0, 12, 3), 0, 255).tolist())
    ink = edge_ink = _ink_on(color)
    if color == "white":
        inks = [ink, *(SHEETING[name] for name in ("red", "blue", "green"))]
        ink, edge_ink = (inks[k] for k in rng.choice(4, 2, p=[0.6, 0.1, 0.2, 0.1]))
    pixels = np.empty((height, width, 3), np.uint8)
    pixels[:] = ground
    edge = int(rng.integers(0, 4) * max(1, height // 48))
    inset = int(rng.integers(0, 2)) * edge
    if edge:
        corner = width - 1 - inset, height - 1 - inset
        cv2.rectangle(pixels, (inset, inset), corner, edge_ink, edge)
    margin = edge + inset
    rest = Area(margin, margin, width - margin, height - margin)
    if rng.random() < ARROW:
        part, rest = rest.split(rng.uniform(0.2, 0.45), rng)
        cv2.fillPoly(pixels, [part.fitted(_arrow(rng))], ink, cv2.LINE_AA)
    if rng.random() < PICTOGRAM:
        part, rest = rest.split(rng.uniform(0.25, 0.6), rng)
        _draw_pictogram(pixels, part, (ink, ground), rng)
    lines = int(rng.integers(1, MOST_LINES + 1))
    lines = min(lines, max(1, round(3 * (rest.bottom - rest.top) / (rest.right - rest.left))))
    inserted = int(rng.integers(lines)) if lines > 1 and rng.random() < INSERT else -1
    tall = (rest.bottom - rest.top) / lines
    size = rng.uniform(0.36, 0.62)
    for line in range(lines):
        top, letters = rest.top + line * tall, ink
        if line == inserted:
            letters = _draw_insert(pixels, Area(rest.left, top, rest.right, top + tall), rng)
        font = int(rng.choice(TYPEFACES))
        part_of_board = pixels[:, round(rest.left) : round(rest.right)]
        lettered(part_of_board, some_words(rng), top + tall / 2, tall * size, letters, font, rng)
    return np.dstack([pixels, _rounded(width, height, rng)])


def some_words(rng: np.random.Generator) -> str:
    """A word or two, or a number."""
    kind = rng.random()
    if kind < 0.4:
        return str(rng.choice(WORDS))
    if kind < 0.5:
        return str(rng.integers(1, 999))
    word = "".join(rng.choice(list(LETTERS), int(rng.integers(3, 12))))
    return word.upper() if rng.random() < 0.4 else word.capitalize()


def lettered(
    pixels: Pixels,
    text: str,
    middle: float,
    tall: float,
    ink: Ink,
    font: int,
    rng: np.random.Generator,
) -> None:
    """A line of text about a row of a board (h, w, 3), in place: `tall` pixels high, or as wide as the board."""
    scale, width = tall / 22, pixels.shape[1]
    weight = max(1, round(scale * 2 * rng.uniform(0.7, 1.8)))
    (wide, high), _ = cv2.getTextSize(text, font, scale, weight)
    fitted = min(1.0, 0.85 * width / max(wide, 1))
    at = round(width * rng.uniform(0.06, 0.15)), round(middle + high * fitted / 2)
    drawn = np.ascontiguousarray(pixels)
    cv2.putText(drawn, text, at, font, scale * fitted, ink, weight, cv2.LINE_AA)
    pixels[:] = drawn


def _arrow(rng: np.random.Generator) -> NDArray[np.float64]:
    """Corners (7, 2) of an arrow in one of eight directions, in -1 to 1."""
    shaft, head, neck = rng.uniform(0.1, 0.3), rng.uniform(0.45, 0.9), rng.uniform(-0.4, 0.2)
    upright = np.array(
        [
            [0, -1],
            [head, neck],
            [shaft, neck],
            [shaft, 1],
            [-shaft, 1],
            [-shaft, neck],
            [-head, neck],
        ]
    )
    angle = np.pi / 4 * rng.choice([0, 2, 6, 1, 7, 3, 5, 4], p=[0.4, 0.15, 0.15, *[0.06] * 5])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray(upright @ turn.T)


def _draw_pictogram(
    pixels: Pixels, area: Area, inks: tuple[Ink, Ink], rng: np.random.Generator
) -> None:
    """A few shapes that overlap, as what is pictured is not known at the size of most views; now and then framed."""
    ink, ground = inks
    if rng.random() < 0.4:
        cv2.fillPoly(pixels, [area.fitted(_polygon(4, np.ones(2), rng))], ink, cv2.LINE_AA)
        ink, ground = ground, ink
    for _ in range(int(rng.integers(2, 6))):
        around = _polygon(int(rng.choice([3, 4, 24])), rng.uniform(0.1, 0.6, 2), rng)
        points = area.fitted(around + rng.uniform(-0.5, 0.5, 2))
        cv2.fillPoly(pixels, [points], ink if rng.random() < 0.8 else ground, cv2.LINE_AA)


def _polygon(
    corners: int, size: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """A triangle, rectangle or ellipse (corners, 2) about the origin; half its sides are given."""
    start = np.pi / 4 if corners == 4 else rng.choice([0.5, -0.5]) * np.pi
    angle = start + np.linspace(0, 2 * np.pi, corners, endpoint=False)
    unit = np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.asarray(unit / np.abs(unit).max(axis=0) * size)


def _draw_insert(pixels: Pixels, area: Area, rng: np.random.Generator) -> Ink:
    """A panel of any colour behind a line; the ink of that line."""
    color = str(rng.choice(list(SHEETING)))
    inside = (area.right - area.left) * rng.uniform(0.0, 0.12)
    corners = (
        (round(area.left + inside), round(area.top)),
        (
            round(area.left + (area.right - area.left) * rng.uniform(0.6, 1.0)),
            round(area.bottom),
        ),
    )
    cv2.rectangle(pixels, *corners, SHEETING[color], -1)
    return _ink_on(color)


def _ink_on(color: str) -> Ink:
    """Letters on a ground are black or white."""
    return (20, 20, 22) if color in LIGHT else (238, 238, 235)


def _rounded(width: int, height: int, rng: np.random.Generator) -> Pixels:
    """The alpha (h, w) of a rectangle whose corners are round, or not."""
    alpha = np.zeros((height, width), np.uint8)
    radius = int(min(width, height) * rng.choice([0.0, 0.06, 0.14]))
    cv2.rectangle(alpha, (radius, 0), (width - 1 - radius, height - 1), 255, -1)
    cv2.rectangle(alpha, (0, radius), (width - 1, height - 1 - radius), 255, -1)
    for x in (radius, width - 1 - radius):
        for y in (radius, height - 1 - radius):
            cv2.circle(alpha, (x, y), radius, 255, -1)
    return alpha
