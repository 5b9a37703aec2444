"""Boards invented for learning: lines of words, arrows, symbols and inserted panels, in the colours of signs.

They are painted with the strokes of the signs of rendered drives (`recordings/drives/signs`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recordings.drives.signs.face import Face, pick
from recordings.drives.signs.symbols import SYMBOL_NAMES, draw_symbol

BOARD_WEIGHTS = {
    "white": 0.17,
    "yellow": 0.08,
    "green": 0.25,
    "red": 0.02,
    "orange": 0.08,
    "blue": 0.18,
    "brown": 0.15,
    "fluorescent_yellow_green": 0.04,
    "black": 0.03,
}
"""How often an invented board has each colour."""

LIGHT = ("white", "yellow", "orange", "fluorescent_yellow_green")
"""Those with dark letters."""

WORDS = (
    "EXIT|NORTH|Madrid|A 96|City|Main St|Park|1/2 MILE|ONE WAY|Ausfahrt|LANE|ONLY|Hospital|Centre|280|BUS|P|12 km|Lake"
    "|ROAD WORK"
).split("|")

LETTERS = "abcdefghijklmnopqrstuvwxyz"

ASPECTS, LONGEST_M = (0.45, 4.8), 0.64
"""Width over height, log-uniform; longer side, or less: 256 pixels."""

MOST_LINES = 6

EDGE, ARROW, SYMBOL, INSERT = 0.75, 0.4, 0.3, 0.2
"""How often a board has an edge, an arrow, a symbol, and a panel of another colour behind one of its lines."""

GROUND_SIGMA = 12.0
"""Scatter of the colours of a board, levels."""


def draw_board(color: str, rng: np.random.Generator) -> NDArray[np.uint8]:
    """A board (h, w, 4), RGBA, whose ground has a colour of `BOARD_WEIGHTS`."""
    aspect = float(np.exp(rng.uniform(*np.log(ASPECTS))))
    width = LONGEST_M if aspect >= 1 else max(0.2, LONGEST_M * aspect)
    face = Face("board", color, "rectangle", width, max(0.12, width / aspect))
    ink = edge_ink = _ink_on(color)
    if color == "white":
        choices = ["black", "red", "blue", "green"]
        ink, edge_ink = (str(one) for one in rng.choice(choices, 2, p=[0.6, 0.1, 0.2, 0.1]))
    margin = 0.0
    if rng.random() < EDGE:
        thick, inset = face.height * rng.uniform(0.02, 0.06), rng.integers(0, 2)
        face.border(edge_ink, thick, thick * inset)
        margin = thick * (1 + inset)
    left, right = margin + 0.02 * face.width, 0.98 * face.width - margin
    for share, is_arrow in ((ARROW, True), (SYMBOL, False)):
        side = min(0.8 * face.height, 0.45 * (right - left))
        if rng.random() < share and side > 0.03:
            at_left = rng.random() < 0.5
            middle = left + side / 2 if at_left else right - side / 2
            (_draw_arrow if is_arrow else _draw_symbol)(face, middle, side, ink, rng)
            left, right = (left + side, right) if at_left else (left, right - side)
    _draw_lines(face, (left, right), 0.9 * face.height - 2 * margin, ink, rng)
    rgb = np.clip(face.image + rng.normal(0, GROUND_SIGMA, 3), 0, 255).astype(np.uint8)
    return np.dstack([rgb, face.alpha()])


def _ink_on(color: str) -> str:
    """Letters on a ground are black or white."""
    return "black" if color in LIGHT else "white"


def _draw_arrow(face: Face, middle: float, side: float, ink: str, rng: np.random.Generator) -> None:
    """An arrow in one of eight directions, in a square half-way up."""
    turn = np.pi / 4 * rng.choice([0, 2, 6, 1, 7, 3, 5, 4], p=[0.4, 0.15, 0.15, *[0.06] * 5])
    way = side * 0.4 * np.array([np.sin(turn), -np.cos(turn)])
    centre = np.array([middle, face.height / 2])
    ends = [(float(x), float(y)) for x, y in (centre - way, centre + way)]
    face.arrow(ends, ink, side * rng.uniform(0.08, 0.2))


def _draw_symbol(
    face: Face, middle: float, side: float, ink: str, rng: np.random.Generator
) -> None:
    """A symbol on a square half-way up; now and then in the colour of the ground, framed by the ink."""
    ground = face.color
    if rng.random() < 0.4:
        ink, ground = ground, ink
    plate = Face("symbol", ground, "rectangle", side, side)
    draw_symbol(plate, pick(rng, SYMBOL_NAMES), ink)
    rows, columns = plate.image.shape[:2]
    y, x = (face.image.shape[0] - rows) // 2, round(middle / face.width * face.image.shape[1])
    x = int(np.clip(x - columns // 2, 0, face.image.shape[1] - columns))
    face.image[y : y + rows, x : x + columns] = plate.image


def _draw_lines(
    face: Face, between: tuple[float, float], tall: float, ink: str, rng: np.random.Generator
) -> None:
    """Lines of words between two columns, one of them at times on a panel of another colour; tall: all together."""
    left, right = between
    lines = min(int(rng.integers(1, MOST_LINES + 1)), max(1, round(3 * tall / (right - left))))
    inserted = int(rng.integers(lines)) if lines > 1 and rng.random() < INSERT else -1
    pitch, size = tall / lines, rng.uniform(0.36, 0.62)
    for line in range(lines):
        middle, letters = (face.height - tall) / 2 + (line + 0.5) * pitch, ink
        if line == inserted:
            ground = pick(rng, list(BOARD_WEIGHTS))
            letters = _ink_on(ground)
            end = left + (right - left) * rng.uniform(0.6, 1)
            face.box(left, middle - pitch / 2, end, middle + pitch / 2, ground)
        centre = (left + right) / 2 + rng.uniform(-0.06, 0.06) * (right - left), middle
        room, weight = 0.85 * (right - left), rng.uniform(0.1, 0.24)
        face.text(some_words(rng), centre, pitch * size, letters, room, weight)


def some_words(rng: np.random.Generator) -> str:
    """A word or two, or a number."""
    kind = rng.random()
    if kind < 0.4:
        return pick(rng, WORDS)
    if kind < 0.5:
        return str(rng.integers(1, 999))
    word = "".join(rng.choice(list(LETTERS), int(rng.integers(3, 12))))
    return word.upper() if rng.random() < 0.4 else word.capitalize()
