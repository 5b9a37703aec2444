"""Things drawn into images that are no signs: signals, cones, lamps, panels, windows, lettering, advertisements.

They are worn and blended in as faces are: what tells them from signs is what they show, not how they were drawn.
"""

from collections.abc import Callable
from math import ceil, floor

import cv2
import numpy as np

from recordings.drives.signs.face import COLORS
from training import face_compositing
from training.detector_images import FRONT
from training.face_drawings import BOARD_WEIGHTS, FaceDrawing, some_words
from wayside.schemas.detections import NONE
from wayside.stages.kernels import Bytes, Floats

HEIGHTS_PX = (8.0, 110.0)
"""Heights, log-uniform."""

BESIDE = 0.4
"""Fraction of them that touch a face, where there is one: the face ends there, and does not become another thing."""

DRAWN_PX = 96
"""Length of the shorter side of a drawing before it is scaled."""

LAMPS = ((255, 40, 30), (255, 190, 30), (40, 255, 160))
"""Red, amber and green of signals, RGB."""

BACKPLATE = 0.4
"""Most that a backplate reaches beyond the housing, in shorter sides of that."""

HOUSINGS = ((20, 20, 20), (200, 160, 20), (215, 130, 25), (30, 60, 40), (90, 92, 95))
"""Paints of signals, RGB: black, yellow, orange, green, grey."""

SLANTED = (cv2.FONT_HERSHEY_SCRIPT_SIMPLEX, cv2.FONT_HERSHEY_SCRIPT_COMPLEX)
"""Typefaces of advertisements: all others of OpenCV 5 are upright and have no serifs, as those of signs are."""

PICTURE_PX = 24
"""Side of the part of the image that the picture on an advertisement is."""

Draw = Callable[[Bytes, Bytes, np.random.Generator], None]
"""Draws onto a board (h, w, 3), which shows some other part of the image, and its alpha (h, w), 255 all over, in
place."""


def draw_distractor(
    rgb: Bytes, taken: Floats, noise: Floats, rng: np.random.Generator
) -> face_compositing.Box | None:
    """One of them somewhere, in place; its box, None where it is not drawn: it would lie on the boxes `taken` (n, 4).

    `noise` is a square of smooth noise as `draw_faces` takes it.
    """
    shares = np.array([share for share, *_ in KINDS.values()])
    _, narrowest, widest, draw = KINDS[str(rng.choice(list(KINDS), p=shares / shares.sum()))]
    aspect = float(np.exp(rng.uniform(np.log(narrowest), np.log(widest))))
    short = DRAWN_PX / min(aspect, 1.0)
    y, x = (int(rng.integers(max(1, side - PICTURE_PX))) for side in rgb.shape[:2])
    part = rgb[y : y + PICTURE_PX, x : x + PICTURE_PX]
    board = np.asarray(cv2.resize(part, (round(short * aspect), round(short))), np.uint8)
    alpha = np.full(board.shape[:2], 255, np.uint8)
    draw(board, alpha, rng)
    drawing = FaceDrawing(np.dstack([board, alpha]), NONE, NONE)
    high = float(np.exp(rng.uniform(*np.log(HEIGHTS_PX))))
    neighbour = taken[rng.integers(len(taken))] if len(taken) and rng.random() < BESIDE else None
    if neighbour is not None:
        high = float((neighbour[3] - neighbour[1]) * rng.uniform(0.5, 2.0))
    patch = face_compositing.seen_from_an_angle(drawing, high, rng)
    left, top = (rng.uniform(-0.1, 1, 2) * rgb.shape[1::-1]).round().astype(int).tolist()
    if neighbour is not None:
        left, top = _beside(neighbour, patch.shape[:2], rng)
    box = (float(left), float(top), float(left + patch.shape[1]), float(top + patch.shape[0]))
    if face_compositing.overlaps(box, list(map(tuple, taken))):
        return None
    face_compositing.wear(
        patch, FRONT, face_compositing.random_brightness(rng), rgb, box, noise, rng
    )
    return face_compositing.blend(rgb, patch, left, top)


def _beside(neighbour: Floats, size: tuple[int, int], rng: np.random.Generator) -> tuple[int, int]:
    """Left and top of a patch of a size (rows, columns) that touches a box, or nearly, below, above or at a side."""
    left, top, right, bottom = neighbour.tolist()
    high, wide = size
    gap = rng.uniform(0, 0.15) * (bottom - top)
    x, y = (left + right - wide) / 2, (top + bottom - high) / 2
    places = (x, bottom + gap), (x, top - gap - high), (left - gap - wide, y), (right + gap, y)
    x, y = places[int(rng.integers(4))]
    # rounded away from the box: nothing is drawn where both overlap
    return floor(x) if x < left else ceil(x), floor(y) if y < top else ceil(y)


def _signal(board: Bytes, alpha: Bytes, rng: np.random.Generator) -> None:
    """Three lamps in a housing, vertical or horizontal, with or without a backplate; the lit one may be too bright."""
    paint = np.array(HOUSINGS[int(rng.integers(len(HOUSINGS)))]) * rng.uniform(0.6, 1.2)
    high, wide = alpha.shape
    edge = 0
    if rng.random() < 0.4:
        share = rng.uniform(0.1, BACKPLATE)
        edge = round(min(wide, high) * share / (1 + 2 * share))
    board[:] = (20, 20, 20) if rng.random() < 0.6 else np.minimum(paint, 255)
    housing = board[edge : high - edge, edge : wide - edge]
    housing[:] = np.minimum(paint, 255)
    high, wide = housing.shape[:2]
    radius = max(1, round(min(wide, high, max(wide, high) / 3) * rng.uniform(0.3, 0.48)))
    lit, has_visors, unlit = int(rng.integers(4)), rng.random() < 0.6, rng.uniform(0.04, 0.4)
    visor = tuple((paint * rng.uniform(0.05, 0.7)).tolist())
    drawn = np.ascontiguousarray(housing)
    for number, lamp in enumerate(LAMPS):
        along, across = 0.18 + 0.32 * number, 0.5
        u, v = (along, across) if wide > high else (across, along)
        middle = round(u * wide), round(v * high)
        color = tuple((1.0 if number == lit else unlit) * part for part in lamp)
        if has_visors:
            cv2.circle(drawn, middle, radius, visor, -1, cv2.LINE_AA)
        inner = max(1, round(radius * (0.8 if has_visors else 1.0)))
        cv2.circle(drawn, middle, inner, color, -1, cv2.LINE_AA)
        if has_visors:
            shade = max(1, round(radius * rng.uniform(0.2, 0.6)))
            cv2.ellipse(drawn, middle, (inner, inner), 0, 180, 360, visor, shade, cv2.LINE_AA)
        if number == lit and rng.random() < 0.6:
            cv2.circle(drawn, middle, round(radius * rng.uniform(0.7, 1.1)), (255,) * 3, -1)
    housing[:] = drawn


def _cone(board: Bytes, alpha: Bytes, rng: np.random.Generator) -> None:
    high, wide = alpha.shape
    board[:] = COLORS["orange"]
    at, half = round(high * 0.5), max(1, round(high * 0.05))
    board[at - half : at + half] = COLORS["white"]
    alpha[:] = 0
    cv2.fillPoly(alpha, [np.array([(wide // 2, 0), (wide, high), (0, high)])], 255, cv2.LINE_AA)


def _lamp(board: Bytes, alpha: Bytes, rng: np.random.Generator) -> None:
    board[:] = LAMPS[int(rng.integers(len(LAMPS)))]
    _ellipse(alpha)


def _panel(board: Bytes, alpha: Bytes, rng: np.random.Generator) -> None:
    """A plain surface: wall, lorry, hoarding, container."""
    color = rng.uniform(15, 240, 3) if rng.random() < 0.6 else np.repeat(rng.uniform(20, 240), 3)
    board[:] = color
    if rng.random() < 0.4:  # a part of it darker
        board[round(len(board) * rng.uniform(0.3, 0.8)) :] = color * rng.uniform(0.4, 0.9)


def _windows(board: Bytes, alpha: Bytes, rng: np.random.Generator) -> None:
    """A row of panes, dark by day or lit by night."""
    high, wide = alpha.shape
    count, gap = int(rng.integers(1, 5)), rng.uniform(0.1, 0.35)
    board[:] = rng.uniform(60, 220, 3)
    if rng.random() < 0.4:  # in the wall that is there
        alpha[:] = 0
    pane, color = wide / count, rng.uniform(10, 90, 3)
    if rng.random() < 0.3:
        color = rng.uniform(150, 250, 3)
    inset = round(min(pane, high) * gap / 2)
    for number in range(count):
        columns = slice(round(number * pane) + inset, round((number + 1) * pane) - inset)
        board[inset : high - inset, columns] = color
        alpha[inset : high - inset, columns] = 255


def _lettering(board: Bytes, alpha: Bytes, rng: np.random.Generator) -> None:
    """Words on whatever is there: shop fronts, lorries, road markings."""
    board[:] = COLORS[str(rng.choice(list(BOARD_WEIGHTS)))]
    text, high = some_words(rng), len(board)
    ink = np.zeros((*alpha.shape, 3), np.uint8)
    _lettered(ink, text, high / 2, high * 0.7, (255,) * 3, cv2.FONT_HERSHEY_DUPLEX, rng)
    alpha[:] = ink[..., 0]


def _advertisement(board: Bytes, alpha: Bytes, rng: np.random.Generator) -> None:
    """A board or disc with the picture that is there or colours, and words in the typefaces of advertisements."""
    high = len(board)
    ground = rng.uniform(10, 245, 3) if rng.random() < 0.6 else np.repeat(rng.uniform(10, 245), 3)
    picture = np.clip(board * rng.uniform(0.6, 1.8, 3), 0, 255)
    rows = round(high * rng.uniform(0.4, 1)) if rng.random() < 0.3 else 0
    board[:] = ground
    board[:rows] = picture[:rows]
    if rng.random() < 0.4:  # a strip of a second colour
        from_row = round(high * rng.uniform(0, 0.8))
        board[from_row : from_row + max(2, high // 3)] = rng.uniform(10, 245, 3)
    lines = int(rng.integers(1, 4))
    for line in range(lines):
        light = board.mean() < rng.uniform(90, 160)
        ink = rng.uniform(180, 255, 3) if light else rng.uniform(0, 90, 3)
        typeface = int(rng.choice(SLANTED))
        middle, tall = high * (line + 0.5) / lines, high / lines * rng.uniform(0.4, 0.9)
        _lettered(board, some_words(rng), middle, tall, tuple(ink.tolist()), typeface, rng)
    if rng.random() < 0.3:
        _ellipse(alpha)


def _lettered(
    pixels: Bytes,
    text: str,
    middle: float,
    tall: float,
    ink: tuple[int, ...],
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


def _ellipse(alpha: Bytes) -> None:
    """Nothing but the ellipse that fills the board."""
    half = alpha.shape[1] // 2, alpha.shape[0] // 2
    alpha[:] = 0
    cv2.ellipse(alpha, half, half, 0, 0, 360, 255, -1, cv2.LINE_AA)


KINDS: dict[str, tuple[float, float, float, Draw]] = {
    "signal": (0.14, 0.32, 0.5, _signal),
    "horizontal signal": (0.17, 2.0, 3.1, _signal),
    "cone": (0.08, 0.6, 0.6, _cone),
    "lamp": (0.08, 1.0, 1.0, _lamp),
    "panel": (0.06, 0.4, 4.0, _panel),
    "windows": (0.11, 0.5, 3.0, _windows),
    "lettering": (0.12, 2.0, 5.0, _lettering),
    "advertisement": (0.18, 0.4, 3.5, _advertisement),
}
"""How often each kind is drawn, its width over height, least and most, and how."""
