"""How classes look: the colours of sign faces and unit outlines of their shapes, for sheets and the index alike."""

from __future__ import annotations

import math

from wayside.schemas.detections import COLOR_RGB

Ink = tuple[int, int, int]
Outline = tuple[tuple[float, float], ...]

UNKNOWN_INK: Ink = (150, 156, 164)


def _regular(corners: int, first_rad: float) -> Outline:
    """A regular polygon in the unit circle; y down."""
    angles = [first_rad + 2 * math.pi * i / corners for i in range(corners)]
    return tuple((math.cos(angle), math.sin(angle)) for angle in angles)


_SHIELD: Outline = (
    (-0.85, -0.8), (-0.45, -0.7), (0.0, -0.95), (0.45, -0.7), (0.85, -0.8),
    (0.9, 0.05), (0.65, 0.55), (0.0, 0.95), (-0.65, 0.55), (-0.9, 0.05),
)  # fmt: skip
_CROSSBUCK: Outline = (
    (-0.95, -0.65), (-0.65, -0.95), (0.0, -0.3), (0.65, -0.95), (0.95, -0.65), (0.3, 0.0),
    (0.95, 0.65), (0.65, 0.95), (0.0, 0.3), (-0.65, 0.95), (-0.95, 0.65), (-0.3, 0.0),
)  # fmt: skip
OUTLINES: dict[str, Outline] = {
    "rectangle": ((-0.72, -0.92), (0.72, -0.92), (0.72, 0.92), (-0.72, 0.92)),
    "diamond": _regular(4, 0.0),
    "octagon": _regular(8, math.pi / 8),
    "triangle": ((-0.95, -0.8), (0.95, -0.8), (0.0, 0.85)),
    "circle": _regular(32, 0.0),
    "pentagon": ((0.0, -0.92), (0.9, -0.1), (0.9, 0.9), (-0.9, 0.9), (-0.9, -0.1)),
    "pennant": ((-0.95, -0.7), (0.95, 0.0), (-0.95, 0.7)),
    "shield": _SHIELD,
    "crossbuck": _CROSSBUCK,
    "other": _regular(6, 0.0),
}
"""Corners between -1 and 1, x right, y down."""


def ink_of(color: str | None) -> Ink:
    """Colour to paint a class in; grey where it is not known."""
    return UNKNOWN_INK if color is None else COLOR_RGB[color]


def css(color: str | None) -> str:
    """The ink of a class of colours as CSS has it."""
    return "#{:02x}{:02x}{:02x}".format(*ink_of(color))


def outline_of(shape: str | None) -> Outline:
    """Outline to paint a class with; a hexagon where it is not known."""
    return OUTLINES["other" if shape is None else shape]


def class_words(name: str | None) -> str:
    """A class as a person says it."""
    return "unknown" if name is None else name.replace("_", " ")


def appearance_of(color: str | None, shape: str | None) -> str:
    """Colour and shape in one phrase."""
    return f"{class_words(color)} {class_words(shape)}" if color or shape else "look unknown"
