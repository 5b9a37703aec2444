"""Shapes of faces as straight segments in a box, and how the segments move with the box."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.stages.kernels import Array

ASPECT = {
    "diamond": 1.0,
    "octagon": 1.0,
    "circle": 1.0,
    "triangle": 1.155,
    "triangle_up": 1.155,
    "pennant": 1.278,
    "pentagon": 1.0,
}
"""Width over height of shapes that come in one proportion (MUTCD)."""
_PARTS = 3
"""Segments of each side of a shape with few sides: their offsets show its rotation and its proportions."""
_ROUNDED, _ROUNDED_SHORT = 0.1, 0.15
"""Fraction of a side left out at either end, where corners are rounded; of the sides of a shape with many."""


class Segments(NamedTuple):
    """Segments in an image: ends and outward normals (k, 2).

    jacobian (k, 5): derivative of a segment's offset along its normal by left, top, right, bottom and rotation.
    """

    begin: Array
    end: Array
    normal: Array
    jacobian: Array


def _regular(count: int) -> list[tuple[float, float]]:
    """Corners of a regular polygon round the unit circle, its first side at the right."""
    angles = (np.arange(count) + 0.5) * 2 * np.pi / count
    around = np.column_stack([np.cos(angles), np.sin(angles)]) / np.cos(np.pi / count)
    return [(x, y) for x, y in around]


_SIDE = float(np.tan(np.pi / 8))
_CORNERS: dict[str, list[tuple[float, float]]] = {
    "rectangle": [(-1, -1), (1, -1), (1, 1), (-1, 1)],
    "diamond": [(0, -1), (1, 0), (0, 1), (-1, 0)],
    "octagon": [
        *((-_SIDE, -1), (_SIDE, -1), (1, -_SIDE), (1, _SIDE)),
        *((_SIDE, 1), (-_SIDE, 1), (-1, _SIDE), (-1, -_SIDE)),
    ],
    "circle": _regular(16),
    "triangle": [(-1, -1), (1, -1), (0, 1)],
    "triangle_up": [(0, -1), (1, 1), (-1, 1)],
    "pennant": [(-1, -1), (1, 0), (-1, 1)],
    "pentagon": [(0, -1), (1, 0), (1, 1), (-1, 1), (-1, 0)],
}


def _template(shape: str) -> tuple[Array, Array]:
    """Ends (k, 2) of the segments of an outline in the square -1..1, y down."""
    corners = np.array(_CORNERS[shape], np.float64)
    parts, rounded = (1, _ROUNDED_SHORT) if len(corners) >= 8 else (_PARTS, _ROUNDED)
    cuts = np.linspace(rounded, 1 - rounded, parts + 1)
    first, side = corners[:, None], (np.roll(corners, -1, axis=0) - corners)[:, None]
    begin, end = first + side * cuts[None, :-1, None], first + side * cuts[None, 1:, None]
    return begin.reshape(-1, 2), end.reshape(-1, 2)


_UPRIGHT = ("diamond", "octagon", "circle", "pentagon")
"""Shapes that stand one way up, so that their name tells where their corners are."""


def face_corners(shape: str | None) -> Array:
    """Corners (n, 2) of a face in the square -1..1, y down: its outline, or its box where the name tells too little."""
    return np.array(_CORNERS[shape if shape in _UPRIGHT else "rectangle"], np.float64)


OUTLINE_SHAPES = tuple(_CORNERS)
"""Shapes that have a template; triangles point down unless said."""
_TEMPLATES = {shape: _template(shape) for shape in OUTLINE_SHAPES}


def segments_of(shape: str, box: Array, rotation: float = 0.0) -> Segments:
    """Segments of a shape that fills a box [left, top, right, bottom], rotated about its centre (rad, clockwise)."""
    begin, end = _TEMPLATES[shape]
    centre, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
    along = (end - begin) * half
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.sqrt((along**2).sum(axis=1))[:, None]
    unit = (begin + end) / 2
    radius = unit * half
    jacobian = np.empty((len(unit), 5))
    jacobian[:, :2], jacobian[:, 2:4] = normal * (0.5 - unit / 2), normal * (0.5 + unit / 2)
    jacobian[:, 4] = normal[:, 1] * radius[:, 0] - normal[:, 0] * radius[:, 1]
    c, s = np.cos(rotation), np.sin(rotation)
    rotate = np.array([[c, s], [-s, c]])  # for rows
    begin, end = begin * half @ rotate + centre, end * half @ rotate + centre
    return Segments(begin, end, normal @ rotate, jacobian)


def box_round(shape: str, box: Array, rotation: float) -> Array:
    """Box (4,) round a shape that fills a box and is rotated about its centre (rad, clockwise)."""
    if shape == "circle":
        return box
    centre, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
    c, s = np.cos(rotation), np.sin(rotation)
    corners = np.array(_CORNERS[shape]) * half @ np.array([[c, s], [-s, c]]) + centre
    return np.concatenate([corners.min(axis=0), corners.max(axis=0)])


def box_size(box: Array) -> Array:
    """Width and height (2,) of a box, one sample at least."""
    return np.asarray(np.maximum(box[2:] - box[:2], 1.0))


def has_area(box: Array) -> bool:
    """Whether a box (4,) is a sample or more wide and high: a narrower one has no outline."""
    return bool((box[2:] - box[:2]).min() >= 1.0)


def growth(segments: Segments) -> Array:
    """Change (4,) of the box that moves all segments one sample outwards (least squares)."""
    ones = np.ones(len(segments.begin))
    return np.asarray(np.linalg.lstsq(segments.jacobian[:, :4], ones, rcond=1e-6)[0])
