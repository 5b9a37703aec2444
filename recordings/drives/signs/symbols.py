"""Symbols of warning signs, drawn on a square panel in fractions of its width."""

from collections.abc import Callable
from dataclasses import dataclass

from recordings.drives.signs.face import Face
from recordings.drives.signs.shapes import Points, outline

_THICK = 0.085


@dataclass(frozen=True, slots=True)
class _Pen:
    """Strokes on a face, measured in fractions of its width."""

    face: Face
    ink: str

    def _scaled(self, points: Points) -> Points:
        return [(self.face.width * x, self.face.width * y) for x, y in points]

    def arrow(self, *points: tuple[float, float], width: float = 1.0) -> None:
        self.face.arrow(self._scaled([*points]), self.ink, _THICK * self.face.width * width)

    def line(self, *points: tuple[float, float], width: float = 1.0) -> None:
        self.face.line(self._scaled([*points]), self.ink, _THICK * self.face.width * width)

    def fill(self, *points: tuple[float, float], ink: str = "") -> None:
        self.face.fill(self._scaled([*points]), ink or self.ink)

    def disc(self, x: float, y: float, radius: float, ink: str = "") -> None:
        size = self.face.width
        self.face.disc(size * x, size * y, size * radius, ink or self.ink)


def _curve_right(pen: _Pen) -> None:
    pen.arrow((0.44, 0.76), (0.44, 0.58), (0.47, 0.47), (0.62, 0.28))


def _curve_left(pen: _Pen) -> None:
    pen.arrow((0.56, 0.76), (0.56, 0.58), (0.53, 0.47), (0.38, 0.28))


def _turn_right(pen: _Pen) -> None:
    pen.arrow((0.38, 0.74), (0.38, 0.42), (0.72, 0.42))


def _crossroad(pen: _Pen) -> None:
    pen.line((0.5, 0.24), (0.5, 0.76))
    pen.line((0.24, 0.5), (0.76, 0.5))


def _side_road(pen: _Pen) -> None:
    pen.line((0.44, 0.22), (0.44, 0.78))
    pen.line((0.44, 0.5), (0.74, 0.5))


def _winding(pen: _Pen) -> None:
    pen.arrow((0.5, 0.8), (0.42, 0.68), (0.56, 0.52), (0.44, 0.38), (0.5, 0.18))


def _stop_ahead(pen: _Pen) -> None:
    octagon = outline("octagon", 0.7, 0.7)
    pen.fill(*((x / 0.7 * 0.3 + 0.35, y / 0.7 * 0.3 + 0.42) for x, y in octagon), ink="red")
    pen.arrow((0.5, 0.36), (0.5, 0.18), width=0.8)


def _signal(pen: _Pen) -> None:
    for y, color in ((0.3, "red"), (0.5, "orange"), (0.7, "green")):
        pen.disc(0.5, y, 0.085, color)


def _pedestrian(pen: _Pen) -> None:
    pen.disc(0.52, 0.24, 0.05)
    pen.line((0.51, 0.33), (0.5, 0.53))
    pen.line((0.5, 0.52), (0.42, 0.76), width=0.7)
    pen.line((0.5, 0.52), (0.6, 0.75), width=0.7)
    pen.line((0.51, 0.36), (0.38, 0.48), width=0.55)
    pen.line((0.51, 0.36), (0.63, 0.48), width=0.55)


def _children(pen: _Pen) -> None:
    for x in (0.38, 0.62):
        pen.disc(x, 0.34, 0.045)
        pen.line((x, 0.41), (x, 0.6), width=0.9)
        pen.line((x, 0.58), (x - 0.07, 0.78), width=0.6)
        pen.line((x, 0.58), (x + 0.07, 0.78), width=0.6)
        pen.line((x - 0.09, 0.5), (x + 0.09, 0.46), width=0.5)


def _deer(pen: _Pen) -> None:
    neck_and_head = ((0.58, 0.42), (0.68, 0.28), (0.74, 0.3), (0.7, 0.44))
    pen.fill((0.3, 0.52), *neck_and_head, (0.62, 0.56), (0.36, 0.62))
    pen.line((0.34, 0.58), (0.24, 0.76), width=0.4)
    pen.line((0.4, 0.6), (0.34, 0.78), width=0.4)
    pen.line((0.58, 0.54), (0.7, 0.66), width=0.4)
    pen.line((0.6, 0.52), (0.78, 0.58), width=0.4)
    pen.line((0.7, 0.3), (0.66, 0.18), width=0.4)
    pen.line((0.72, 0.3), (0.8, 0.2), width=0.4)


def _tractor(pen: _Pen) -> None:
    pen.disc(0.38, 0.6, 0.14)
    pen.disc(0.66, 0.66, 0.08)
    pen.fill((0.36, 0.46), (0.72, 0.48), (0.72, 0.6), (0.36, 0.6))
    pen.fill((0.3, 0.3), (0.48, 0.3), (0.48, 0.5), (0.3, 0.5))


_SYMBOLS: dict[str, Callable[[_Pen], None]] = {
    "curve_right": _curve_right,
    "curve_left": _curve_left,
    "turn_right": _turn_right,
    "crossroad": _crossroad,
    "side_road": _side_road,
    "winding": _winding,
    "stop_ahead": _stop_ahead,
    "signal": _signal,
    "pedestrian": _pedestrian,
    "children": _children,
    "deer": _deer,
    "tractor": _tractor,
}


SYMBOL_NAMES = tuple(_SYMBOLS)


def draw_symbol(face: Face, name: str, ink: str) -> None:
    """Draw the symbol of that name, or else the name as words, one line for each part between bars."""
    if name in _SYMBOLS:
        _SYMBOLS[name](_Pen(face, ink))
        return
    words, size = name.split("|"), face.width
    face.lines(words, ink, size * (0.5 - 0.115 * len(words)), size * (0.5 + 0.115 * len(words)))
