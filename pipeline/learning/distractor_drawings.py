"""Things drawn into images that are no signs: signals, cones, lamps, panels, windows, lettering, advertisements."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.face_compositing import overlaps
from wayside.pipeline.learning.face_drawings import SHEETING, WORDS, lettered

HEIGHTS_PX = (8.0, 110.0)
"""Heights, log-uniform."""

KINDS = {
    "signal": (0.14, 0.32, 0.42),
    "horizontal signal": (0.17, 2.1, 3.1),
    "cone": (0.08, 0.6, 0.6),
    "lamp": (0.08, 0.5, 0.5),
    "panel": (0.12, 0.4, 4.0),
    "windows": (0.11, 0.5, 3.0),
    "lettering": (0.12, 2.0, 5.0),
    "advertisement": (0.18, 0.4, 3.5),
}
"""How often each kind is drawn, and its width over height: least and most."""

LAMPS = ((255, 40, 30), (255, 190, 30), (40, 255, 160))
"""Red, amber and green of signals, RGB."""

BACKPLATE = 0.4
"""Most that a backplate reaches beyond the housing, in shorter sides of that."""

HOUSINGS = ((20, 20, 20), (200, 160, 20), (215, 130, 25), (30, 60, 40), (90, 92, 95))
"""Paints of signals, RGB: black, yellow, orange, green, grey."""

SCRIPTS = (
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
    cv2.FONT_HERSHEY_SCRIPT_SIMPLEX,
    cv2.FONT_HERSHEY_SCRIPT_COMPLEX,
    cv2.FONT_HERSHEY_DUPLEX | cv2.FONT_ITALIC,
    cv2.FONT_HERSHEY_TRIPLEX | cv2.FONT_ITALIC,
)
"""Typefaces of advertisements: those of signs have no serifs and stand upright."""

Corners = tuple[float, float, float, float]


def draw_distractor(
    rgb: NDArray[np.uint8], taken: NDArray[np.float32], rng: np.random.Generator
) -> None:
    """One of them somewhere, in place; none where it would lie on the boxes `taken` (n, 4)."""
    shares = np.array([share for share, *_ in KINDS.values()])
    kind = str(rng.choice(list(KINDS), p=shares / shares.sum()))
    high = float(np.exp(rng.uniform(*np.log(HEIGHTS_PX))))
    wide = max(3.0, high * float(np.exp(rng.uniform(*np.log(KINDS[kind][1:])))))
    left = rng.uniform(-0.1, 1) * rgb.shape[1]
    top = rng.uniform(-0.1, 1) * rgb.shape[0]
    box = (left, top, left + wide, top + high)
    margin = 2 + (BACKPLATE * min(wide, high) if kind.endswith("signal") else 0)
    around = (left - margin, top - margin, left + wide + margin, top + high + margin)
    if overlaps(around, list(map(tuple, taken))):
        return
    if kind.endswith("signal"):
        _signal(rgb, box, rng)
    elif kind == "cone":
        _cone(rgb, box)
    elif kind == "lamp":
        lamp = LAMPS[int(rng.integers(len(LAMPS)))]
        middle = round((box[0] + box[2]) / 2), round((box[1] + box[3]) / 2)
        cv2.circle(rgb, middle, max(1, round(high / 5)), lamp, -1, cv2.LINE_AA)
    elif kind == "panel":
        _panel(rgb, box, rng)
    elif kind == "windows":
        _windows(rgb, box, rng)
    elif kind == "advertisement":
        _advertisement(rgb, box, rng)
    else:
        _lettering(rgb, box, rng)


def _rectangle(rgb: NDArray[np.uint8], box: Corners, color: tuple[float, ...]) -> None:
    x0, y0, x1, y1 = (round(v) for v in box)
    cv2.rectangle(rgb, (x0, y0), (x1 - 1, y1 - 1), color, -1)


def _signal(rgb: NDArray[np.uint8], box: Corners, rng: np.random.Generator) -> None:
    """Three lamps in a housing, vertical or horizontal, with or without a backplate; the lit one may be too bright."""
    paint = np.array(HOUSINGS[int(rng.integers(len(HOUSINGS)))]) * rng.uniform(0.6, 1.2)
    x0, y0, x1, y1 = box
    wide, high = x1 - x0, y1 - y0
    short, lit = min(wide, high), int(rng.integers(4))
    if rng.random() < 0.4:
        edge = short * rng.uniform(0.1, BACKPLATE)
        backplate = (20, 20, 20) if rng.random() < 0.6 else tuple(paint.tolist())
        _rectangle(rgb, (x0 - edge, y0 - edge, x1 + edge, y1 + edge), backplate)
    _rectangle(rgb, box, tuple(np.minimum(paint, 255).tolist()))
    radius = max(1, round(short * rng.uniform(0.26, 0.4)))
    has_visors = rng.random() < 0.5
    visor = tuple((paint * rng.uniform(0.1, 0.7)).tolist())
    for number, lamp in enumerate(LAMPS):
        along, across = 0.18 + 0.32 * number, 0.5
        u, v = (along, across) if wide > high else (across, along)
        middle = round(x0 + u * wide), round(y0 + v * high)
        color = tuple((1.0 if number == lit else 0.15) * part for part in lamp)
        cv2.circle(rgb, middle, radius, color, -1, cv2.LINE_AA)
        if has_visors:
            shade = max(1, round(radius * 0.35))
            cv2.ellipse(rgb, middle, (radius, radius), 0, 180, 360, visor, shade, cv2.LINE_AA)
        if number == lit and rng.random() < 0.5:
            cv2.circle(rgb, middle, max(1, round(radius * 0.7)), (255, 255, 255), -1, cv2.LINE_AA)


def _cone(rgb: NDArray[np.uint8], box: Corners) -> None:
    middle, wide, high = (box[0] + box[2]) / 2, box[2] - box[0], box[3] - box[1]
    corners = np.array([(middle, box[1]), (box[2], box[3]), (box[0], box[3])])
    cv2.fillPoly(rgb, [np.round(corners).astype(np.int32)], SHEETING["orange"], cv2.LINE_AA)
    at = round(box[1] + high * 0.5)
    ends = (round(middle - wide * 0.2), at), (round(middle + wide * 0.2), at)
    cv2.line(rgb, *ends, SHEETING["white"], max(1, round(high * 0.09)))


def _panel(rgb: NDArray[np.uint8], box: Corners, rng: np.random.Generator) -> None:
    """A plain surface: wall, lorry, hoarding, container."""
    color = rng.uniform(15, 240, 3) if rng.random() < 0.6 else np.repeat(rng.uniform(20, 240), 3)
    _rectangle(rgb, box, tuple(color.tolist()))
    if rng.random() < 0.4:  # a part of it darker
        x0, y0, x1, y1 = box
        cut = y0 + (y1 - y0) * rng.uniform(0.3, 0.8)
        _rectangle(rgb, (x0, cut, x1, y1), tuple((color * rng.uniform(0.4, 0.9)).tolist()))


def _windows(rgb: NDArray[np.uint8], box: Corners, rng: np.random.Generator) -> None:
    """A row of panes, dark by day or lit by night."""
    count, gap = int(rng.integers(1, 5)), rng.uniform(0.1, 0.35)
    color = rng.uniform(10, 90, 3) if rng.random() < 0.7 else rng.uniform(150, 250, 3)
    if rng.random() < 0.6:
        _rectangle(rgb, box, tuple(rng.uniform(60, 220, 3).tolist()))
    pane = (box[2] - box[0]) / count
    inset = min(pane, box[3] - box[1]) * gap / 2
    for number in range(count):
        left = box[0] + number * pane
        inner = (left + inset, box[1] + inset, left + pane - inset, box[3] - inset)
        _rectangle(rgb, inner, tuple(color.tolist()))


def _lettering(rgb: NDArray[np.uint8], box: Corners, rng: np.random.Generator) -> None:
    """Words on whatever is there: shop fronts, lorries, road markings."""
    text, high = str(rng.choice(WORDS)), box[3] - box[1]
    ink = SHEETING[str(rng.choice(list(SHEETING)))]
    at = round(box[0]), round(box[3])
    weight = max(1, round(high / 12))
    cv2.putText(rgb, text, at, cv2.FONT_HERSHEY_DUPLEX, high / 30, ink, weight, cv2.LINE_AA)


def _advertisement(rgb: NDArray[np.uint8], box: Corners, rng: np.random.Generator) -> None:
    """A board or disc with a picture or colours, words in the typefaces of advertisements, and no post."""
    x0, y0, x1, y1 = (round(v) for v in box)
    high, wide = y1 - y0, x1 - x0
    ground = rng.uniform(10, 245, 3) if rng.random() < 0.6 else np.repeat(rng.uniform(10, 245), 3)
    board = np.empty((high, wide, 3), np.uint8)
    board[:] = ground
    if rng.random() < 0.3:  # a picture: some other part of the image, its colours altered
        y, x = (int(rng.integers(max(1, side - 24))) for side in rgb.shape[:2])
        part = rgb[y : y + 24, x : x + 24].astype(np.float32) * rng.uniform(0.6, 1.8, 3)
        picture = cv2.resize(np.clip(part, 0, 255).astype(np.uint8), (wide, high))
        rows = slice(0, round(high * rng.uniform(0.4, 1)))
        board[rows] = np.asarray(picture, np.uint8)[rows]
    if rng.random() < 0.4:  # a strip of a second colour
        from_row = round(high * rng.uniform(0, 0.8))
        board[from_row : from_row + max(2, high // 3)] = rng.uniform(10, 245, 3)
    lines = int(rng.integers(1, 4))
    for line in range(lines):
        light = board.mean() < rng.uniform(90, 160)
        ink = rng.uniform(180, 255, 3) if light else rng.uniform(0, 90, 3)
        typeface = SCRIPTS[int(rng.integers(len(SCRIPTS)))]
        middle, tall = high * (line + 0.5) / lines, high / lines * rng.uniform(0.4, 0.9)
        lettered(board, str(rng.choice(WORDS)), middle, tall, tuple(ink.tolist()), typeface, rng)
    mask = np.zeros((high, wide), np.uint8)
    if rng.random() < 0.3:
        cv2.ellipse(mask, (wide // 2, high // 2), (wide // 2, high // 2), 0, 0, 360, 255, -1)
    else:
        mask[:] = 255
    top, left = max(0, -y0), max(0, -x0)
    there = rgb[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)]
    rows, columns = slice(top, top + there.shape[0]), slice(left, left + there.shape[1])
    np.copyto(there, board[rows, columns], where=mask[rows, columns, None] > 0)
