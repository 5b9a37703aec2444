"""Shapes of faces as straight segments in a box, and how the segments move with the box."""

from typing import NamedTuple

import numpy as np

from wayside.stages.geometry import cholesky_solve
from wayside.stages.kernels import Array, compiled, shaped

ASPECT = {"triangle": 1.155, "triangle_up": 1.155, "pennant": 1.278}
ASPECT |= dict.fromkeys(("diamond", "octagon", "circle", "pentagon"), 1.0)
"""Width over height of shapes that come in one proportion (MUTCD)."""
_PARTS = 3
"""Segments of each side of a shape with few sides: their offsets show its rotation and its proportions."""
_SINGULAR = 1e-9 * np.eye(4)
"""Added to the squares of the sides: a box that segments do not show in full changes least."""
_ROUNDED, _ROUNDED_SHORT = 0.1, 0.15
"""Fraction of a side left out at either end, where corners are rounded; of the sides of a shape with many."""


class Segments(NamedTuple):
    """Segments in an image: ends and outward normals (k, 2).

    `jacobian` (k, 5): derivative of a segment's offset along its normal by left, top, right, bottom and rotation.
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


def _template(shape: str) -> Array:
    """Ends (k, 4) of the segments of an outline in the square -1..1, y down: x, y, x, y."""
    corners = np.array(_CORNERS[shape], np.float64)
    parts, rounded = (1, _ROUNDED_SHORT) if len(corners) >= 8 else (_PARTS, _ROUNDED)
    cuts = np.linspace(rounded, 1 - rounded, parts + 1)
    first, side = corners[:, None], (np.roll(corners, -1, axis=0) - corners)[:, None]
    begin, end = first + side * cuts[None, :-1, None], first + side * cuts[None, 1:, None]
    return np.concatenate([begin, end], axis=2).reshape(-1, 4)


_UPRIGHT = ("diamond", "octagon", "circle", "pentagon")
"""Shapes that stand one way up, so that their name tells where their corners are."""


def face_corners(shape: str | None) -> Array:
    """Corners (n, 2) of a face in the square -1..1, y down: its outline, or its box where the name tells too little."""
    return np.array(_CORNERS[shape if shape in _UPRIGHT else "rectangle"], np.float64)


OUTLINE_SHAPES = tuple(_CORNERS)
"""Shapes that have a template; triangles point down unless said."""
TEMPLATES = {shape: _template(shape) for shape in OUTLINE_SHAPES}
"""Ends (k, 4) of the segments of each in the square -1..1."""


def segments_of(shape: str, box: Array, rotation: float = 0.0) -> Segments:
    """Segments of a shape that fills a box [left, top, right, bottom], rotated about its centre (rad, clockwise)."""
    return placed(TEMPLATES[shape], shaped(box, (4,)), rotation)


@compiled
def placed(template: Array, box: Array, rotation: float) -> Segments:
    """Segments of a template (k, 4) in a box, as `segments_of`."""
    count = len(template)
    begin, end, normal = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2))
    jacobian = np.empty((count, 5))
    u, v = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    wide, tall = box[2] - box[0], box[3] - box[1]
    c, s = np.cos(rotation), np.sin(rotation)
    for k in range(count):
        x0, y0, x1, y1 = template[k]
        a, b = (y1 - y0) * tall / 2, (x0 - x1) * wide / 2
        length = np.sqrt(a * a + b * b)
        a, b, x, y = a / length, b / length, (x0 + x1) / 4, (y0 + y1) / 4
        jacobian[k, 0], jacobian[k, 1] = a * (0.5 - x), b * (0.5 - y)
        jacobian[k, 2], jacobian[k, 3] = a * (0.5 + x), b * (0.5 + y)
        jacobian[k, 4] = b * x * wide - a * y * tall
        x0, y0, x1, y1 = x0 * wide / 2, y0 * tall / 2, x1 * wide / 2, y1 * tall / 2
        begin[k, 0], begin[k, 1] = u + c * x0 - s * y0, v + s * x0 + c * y0
        end[k, 0], end[k, 1] = u + c * x1 - s * y1, v + s * x1 + c * y1
        normal[k, 0], normal[k, 1] = c * a - s * b, s * a + c * b
    return Segments(begin, end, normal, jacobian)


def box_round(shape: str, box: Array, rotation: float) -> Array:
    """Box (4,) round a shape that fills a box and is rotated about its centre (rad, clockwise)."""
    if shape == "circle":
        return box
    centre, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
    c, s = np.cos(rotation), np.sin(rotation)
    corners = np.array(_CORNERS[shape]) * half @ np.array([[c, s], [-s, c]]) + centre
    return np.concatenate([corners.min(axis=0), corners.max(axis=0)])


def growth(segments: Segments) -> Array:
    """Change (4,) of the box that moves all segments one sample outwards (least squares)."""
    moves = segments.jacobian[:, :4]
    change: Array = moves.sum(axis=0)
    cholesky_solve(moves.T @ moves + _SINGULAR, change)
    return change
