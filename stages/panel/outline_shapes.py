"""Shapes of faces as straight segments in a box, and how the segments move with the box."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.stages.kernels import Array

OUTLINE_SHAPES = (
    "rectangle",
    "diamond",
    "octagon",
    "circle",
    "triangle",
    "triangle_up",
    "pennant",
    "pentagon",
)
"""Shapes that have a template; triangles point down unless said."""
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


class Template(NamedTuple):
    """Segments of an outline in the square -1..1, y down: ends (k, 2) before scaling."""

    begin: Array
    end: Array


class Segments(NamedTuple):
    """Segments in an image: ends and outward normals (k, 2).

    jacobian (k, 5): derivative of a segment's offset along its normal by left, top, right, bottom and rotation.
    """

    begin: Array
    end: Array
    normal: Array
    jacobian: Array


def _corners(shape: str) -> list[tuple[float, float]]:
    if shape == "diamond":
        return [(0, -1), (1, 0), (0, 1), (-1, 0)]
    if shape == "octagon":
        c = float(np.tan(np.pi / 8))
        return [(-c, -1), (c, -1), (1, -c), (1, c), (c, 1), (-c, 1), (-1, c), (-1, -c)]
    if shape == "circle":
        angles = (np.arange(16) + 0.5) * np.pi / 8
        return [
            (x, y)
            for x, y in np.column_stack([np.cos(angles), np.sin(angles)]) / np.cos(np.pi / 16)
        ]
    if shape == "triangle":
        return [(-1, -1), (1, -1), (0, 1)]
    if shape == "triangle_up":
        return [(0, -1), (1, 1), (-1, 1)]
    if shape == "pennant":
        return [(-1, -1), (1, 0), (-1, 1)]
    if shape == "pentagon":
        return [(0, -1), (1, 0), (1, 1), (-1, 1), (-1, 0)]
    return [(-1, -1), (1, -1), (1, 1), (-1, 1)]


def _template(shape: str) -> Template:
    corners = np.array(_corners(shape), np.float64)
    parts, rounded = (1, _ROUNDED_SHORT) if len(corners) >= 8 else (_PARTS, _ROUNDED)
    cuts = np.linspace(rounded, 1 - rounded, parts + 1)
    first, side = corners[:, None], (np.roll(corners, -1, axis=0) - corners)[:, None]
    begin, end = first + side * cuts[None, :-1, None], first + side * cuts[None, 1:, None]
    return Template(begin.reshape(-1, 2), end.reshape(-1, 2))


_TEMPLATES = {shape: _template(shape) for shape in OUTLINE_SHAPES}


def segments_of(shape: str, box: Array, rotation: float = 0.0) -> Segments:
    """Segments of a shape that fills a box [left, top, right, bottom], rotated about its centre (rad, clockwise)."""
    template = _TEMPLATES[shape]
    centre, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
    along = (template.end - template.begin) * half
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    unit = (template.begin + template.end) / 2
    radius = unit * half
    jacobian = np.column_stack(
        [
            normal * (0.5 - unit / 2),
            normal * (0.5 + unit / 2),
            normal[:, 1] * radius[:, 0] - normal[:, 0] * radius[:, 1],
        ]
    )
    c, s = np.cos(rotation), np.sin(rotation)
    rotate = np.array([[c, s], [-s, c]])  # for rows
    return Segments(
        np.ascontiguousarray(template.begin * half @ rotate + centre),
        np.ascontiguousarray(template.end * half @ rotate + centre),
        np.ascontiguousarray(normal @ rotate),
        jacobian,
    )


def box_size(box: Array) -> Array:
    """Width and height (2,) of a box, one sample at least."""
    return np.asarray(np.maximum(box[2:] - box[:2], 1.0))


def growth(segments: Segments) -> Array:
    """Change (4,) of the box that moves all segments one sample outwards (least squares)."""
    ones = np.ones(len(segments.begin))
    return np.asarray(np.linalg.lstsq(segments.jacobian[:, :4], ones, rcond=1e-6)[0])
