"""Things drawn into images that are no signs: signals, cones, lamps, plain panels, windows, lettering on walls."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.face_compositing import overlaps
from wayside.pipeline.learning.face_drawings import SHEETING, WORDS

HEIGHTS_PX = (8.0, 110.0)
"""Heights, log-uniform."""

ASPECTS = {
    "signal": (0.32, 0.42),
    "horizontal signal": (2.4, 3.1),
    "cone": (0.6, 0.6),
    "lamp": (0.5, 0.5),
    "panel": (0.4, 4.0),
    "windows": (0.5, 3.0),
    "lettering": (2.0, 5.0),
}
"""Width over height of each kind: least and most."""

LAMPS = ((255, 40, 30), (255, 190, 30), (40, 255, 160))
"""Red, amber and green of signals, RGB."""

BACKPLATE = 0.4
"""Most that a backplate reaches beyond the housing, in shorter sides of that."""

HOUSINGS = ((20, 20, 20), (200, 160, 20), (215, 130, 25), (30, 60, 40), (90, 92, 95))
"""Paints of signals, RGB: black, yellow, orange, green, grey."""

Corners = tuple[float, float, float, float]


def draw_distractor(
    rgb: NDArray[np.uint8], taken: NDArray[np.float32], rng: np.random.Generator
) -> None:
    """One of them somewhere, in place; none where it would lie on the boxes `taken` (n, 4)."""
    kind = str(rng.choice(list(ASPECTS)))
    high = float(np.exp(rng.uniform(*np.log(HEIGHTS_PX))))
    wide = max(3.0, high * float(np.exp(rng.uniform(*np.log(ASPECTS[kind])))))
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
    for number, lamp in enumerate(LAMPS):
        along, across = 0.18 + 0.32 * number, 0.5
        u, v = (along, across) if wide > high else (across, along)
        middle = round(x0 + u * wide), round(y0 + v * high)
        color = tuple((1.0 if number == lit else 0.15) * part for part in lamp)
        cv2.circle(rgb, middle, radius, color, -1, cv2.LINE_AA)
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
