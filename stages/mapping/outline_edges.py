"""Outlines of faces: shapes made of straight sides, fitted to the edges of a picture.

A face is looked for in pictures of it that lie in register (rows, columns, 3): what belongs to the face stays where it
is, what lies behind it moves from view to view. An edge counts by e^2 / (e^2 + c^2), so that a faint rim that runs all
along the outline beats a strong letter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, require_array

EDGE = 12.0
"""Slope of an edge that counts half, grey levels a sample."""
SEGMENTS = 3
"""Parts of each side of a shape with few sides: their offsets tell its turn and its proportions."""
MOST_SAMPLES = 16
"""Points at which a segment is compared with the picture, at most."""
STEP = 0.25
"""Samples between the offsets at which edges are looked for."""
SHAPES = (
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
"""Width over height of shapes that come in one proportion."""
ASPECT_SIGMA = 0.03
"""How far a proportion may be off: the facing of the panel narrows it."""


class Template(NamedTuple):
    """Segments of an outline in the square -1..1, y down: ends (k, 2) and outward side (k, 2) before scaling."""

    begin: Array
    end: Array


class Segments(NamedTuple):
    """Segments in a picture: ends, outward normals (k, 2), and offsets by left, top, right, bottom, turn (k, 5)."""

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
    parts = 1 if len(corners) >= 8 else SEGMENTS
    spare = 0.15 if parts == 1 else 0.1  # corners are rounded
    cuts = np.linspace(spare, 1 - spare, parts + 1)
    first, side = corners[:, None], (np.roll(corners, -1, axis=0) - corners)[:, None]
    begin, end = first + side * cuts[None, :-1, None], first + side * cuts[None, 1:, None]
    return Template(begin.reshape(-1, 2), end.reshape(-1, 2))


TEMPLATES = {shape: _template(shape) for shape in SHAPES}


def segments_of(shape: str, box: Array, turn: float = 0.0) -> Segments:
    """The segments of a shape that fills a box [left, top, right, bottom], turned about its middle (rad, clockwise)."""
    template = TEMPLATES[shape]
    middle, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
    along = (template.end - template.begin) * half
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    unit = (template.begin + template.end) / 2
    arm = unit * half
    jacobian = np.column_stack(
        [
            normal * (0.5 - unit / 2),
            normal * (0.5 + unit / 2),
            normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1],
        ]
    )
    c, s = np.cos(turn), np.sin(turn)
    rotate = np.array([[c, s], [-s, c]])  # for rows
    return Segments(
        np.ascontiguousarray(template.begin * half @ rotate + middle),
        np.ascontiguousarray(template.end * half @ rotate + middle),
        np.ascontiguousarray(normal @ rotate),
        jacobian,
    )


def slopes(views: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Slope right and down, (views, rows, columns) each, of the channel that changes most."""
    require_array(views, "views", np.float32, (None, None, None, 3))
    right, down = np.zeros(views.shape[:3], np.float32), np.zeros(views.shape[:3], np.float32)
    _slopes(views, right, down)
    return right, down


def edge_profiles(
    right: NDArray[np.float32],
    down: NDArray[np.float32],
    segments: Segments,
    low: float,
    high: float,
) -> Array:
    """Strength of the edge along each segment at offsets low, low + STEP, ... (k, m), 0 to 1, mean over the views.

    Segments that leave the picture have strength 0.
    """
    require_array(right, "right", np.float32, (None, None, None))
    require_array(down, "down", np.float32, right.shape)
    count = round((high - low) / STEP) + 1
    profiles = np.zeros((len(segments.begin), count))
    _profiles(right, down, segments.begin, segments.end, segments.normal, low, profiles)
    return profiles


def strip_colors(
    views: NDArray[np.float32], segments: Segments, low: float, high: float
) -> NDArray[np.float32]:
    """Mean colour along each segment at offsets low, low + STEP, ...: (k, views, m, 3)."""
    require_array(views, "views", np.float32, (None, None, None, 3))
    count = round((high - low) / STEP) + 1
    colors = np.zeros((len(segments.begin), len(views), count, 3), np.float32)
    _colors(views, segments.begin, segments.end, segments.normal, low, colors)
    return colors


def strongest_box(
    profiles: Array, jacobian: Array, low: float, directions: Array, limit: float
) -> tuple[Array, float]:
    """Change (4,) of a box whose segments lie on the strongest edges, and their mean strength.

    Coordinate ascent: the whole box grows first, then each of the `directions` (d, 4) on its own.
    """
    change = np.zeros(4)
    best = _ascend(profiles, np.ascontiguousarray(jacobian[:, :4]), low, directions, limit, change)
    return change, float(best)


@compiled
def _slopes(
    views: NDArray[np.float32], right: NDArray[np.float32], down: NDArray[np.float32]
) -> None:
    count, rows, columns = views.shape[:3]
    for q in range(count):
        for i in range(1, rows - 1):
            for j in range(1, columns - 1):
                best = np.float32(-1)
                for c in range(3):
                    dx = (views[q, i, j + 1, c] - views[q, i, j - 1, c]) * np.float32(0.5)
                    dy = (views[q, i + 1, j, c] - views[q, i - 1, j, c]) * np.float32(0.5)
                    square = dx * dx + dy * dy
                    if square > best:
                        best = square
                        right[q, i, j] = dx
                        down[q, i, j] = dy


@compiled
def _profiles(
    right: NDArray[np.float32],
    down: NDArray[np.float32],
    begin: Array,
    end: Array,
    normal: Array,
    low: float,
    profiles: Array,
) -> None:
    views, rows, columns = right.shape
    for k in range(begin.shape[0]):
        du, dv = end[k, 0] - begin[k, 0], end[k, 1] - begin[k, 1]
        samples = min(max(4, int(np.sqrt(du * du + dv * dv))), MOST_SAMPLES)
        for m in range(profiles.shape[1]):
            offset = low + m * STEP
            total, seen = 0.0, 0
            for n in range(samples):
                share = (n + 0.5) / samples
                u = begin[k, 0] + share * du + offset * normal[k, 0]
                v = begin[k, 1] + share * dv + offset * normal[k, 1]
                if not (u >= 1 and v >= 1 and u < columns - 2 and v < rows - 2):
                    continue
                x, y = int(u), int(v)
                a, b = u - x, v - y
                w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
                for q in range(views):
                    gx = w00 * right[q, y, x] + w01 * right[q, y, x + 1]
                    gx += w10 * right[q, y + 1, x] + w11 * right[q, y + 1, x + 1]
                    gy = w00 * down[q, y, x] + w01 * down[q, y, x + 1]
                    gy += w10 * down[q, y + 1, x] + w11 * down[q, y + 1, x + 1]
                    edge = gx * normal[k, 0] + gy * normal[k, 1]
                    total += edge * edge / (edge * edge + EDGE * EDGE)
                    seen += 1
            if seen >= 0.6 * samples * views:
                profiles[k, m] = total / seen


@compiled
def _colors(
    views: NDArray[np.float32],
    begin: Array,
    end: Array,
    normal: Array,
    low: float,
    colors: NDArray[np.float32],
) -> None:
    count, rows, columns = views.shape[:3]
    for k in range(begin.shape[0]):
        for m in range(colors.shape[2]):
            for n in range(3):
                share, offset = (n + 0.5) / 3, low + m * STEP
                u = begin[k, 0] + share * (end[k, 0] - begin[k, 0]) + offset * normal[k, 0]
                v = begin[k, 1] + share * (end[k, 1] - begin[k, 1]) + offset * normal[k, 1]
                u, v = min(max(u, 0.0), columns - 1.001), min(max(v, 0.0), rows - 1.001)
                x, y = int(u), int(v)
                a, b = u - x, v - y
                for q in range(count):
                    for c in range(3):
                        above = (1 - a) * views[q, y, x, c] + a * views[q, y, x + 1, c]
                        below = (1 - a) * views[q, y + 1, x, c] + a * views[q, y + 1, x + 1, c]
                        colors[k, q, m, c] += np.float32(((1 - b) * above + b * below) / 3)


@compiled
def _strength(profiles: Array, jacobian: Array, low: float, change: Array) -> float:
    total = 0.0
    last = profiles.shape[1] - 1.001
    for k in range(profiles.shape[0]):
        offset = 0.0
        for c in range(4):
            offset += jacobian[k, c] * change[c]
        at = min(max((offset - low) / STEP, 0.0), last)
        i = int(at)
        total += profiles[k, i] + (at - i) * (profiles[k, i + 1] - profiles[k, i])
    return float(total / profiles.shape[0])


@compiled
def _ascend(
    profiles: Array, jacobian: Array, low: float, directions: Array, limit: float, change: Array
) -> float:
    high = low + STEP * (profiles.shape[1] - 1)
    trial = np.zeros(4)
    best = -1.0
    steps = int((high - low) / 0.5) + 1
    for s in range(steps):
        size = low + 0.5 * s
        for c in range(4):
            trial[c] = -size if c < 2 else size
        strength = _strength(profiles, jacobian, low, trial)
        if strength > best:
            best = strength
            change[:] = trial
    for sweep in range(3):
        for d in range(directions.shape[0]):
            start = change.copy()
            count = steps if sweep == 0 else 9
            for s in range(count):
                size = low + 0.5 * s if sweep == 0 else -2.0 + 0.5 * s
                inside = True
                for c in range(4):
                    trial[c] = start[c] + size * directions[d, c]
                    inside = inside and abs(trial[c]) <= limit
                if not inside:
                    continue
                strength = _strength(profiles, jacobian, low, trial)
                if strength > best + 1e-9:
                    best = strength
                    change[:] = trial
    return best
