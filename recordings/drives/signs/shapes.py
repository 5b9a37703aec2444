"""Outlines of sign panels.

Panel coordinates: metres, x right and y down from the top-left corner of the panel's bounding box.
"""

from typing import TypeAlias

import numpy as np

from recordings.drives.arrays import Floats

Points: TypeAlias = list[tuple[float, float]]

_SHIELD: Points = [
    *((0.08, 0.02), (0.3, 0.07), (0.5, 0.0), (0.7, 0.07), (0.92, 0.02), (1.0, 0.2), (0.96, 0.36)),
    *((1.0, 0.55), (0.95, 0.74), (0.78, 0.9), (0.5, 1.0), (0.22, 0.9), (0.05, 0.74), (0.0, 0.55)),
    *((0.04, 0.36), (0.0, 0.2)),
]


def circle(x: float, y: float, radius: float) -> Points:
    """Forty points of a circle."""
    angle = np.arange(40) * 2 * np.pi / 40
    return list(zip(x + radius * np.cos(angle), y + radius * np.sin(angle), strict=True))


def rounded(points: Points, radius: float) -> Points:
    """Convex polygon with rounded corners, three points a corner."""
    corners = np.array(points, float)
    result: Points = []
    for i, corner in enumerate(corners):
        before, after = corners[i - 1] - corner, corners[(i + 1) % len(corners)] - corner
        shorter = min(np.linalg.norm(before), np.linalg.norm(after))
        a, b = before / np.linalg.norm(before), after / np.linalg.norm(after)
        half = np.arccos(np.clip(a @ b, -1, 1)) / 2
        reach = min(radius / np.tan(half), 0.45 * shorter)
        start, end = corner + a * reach, corner + b * reach
        middle = 0.25 * start + 0.5 * corner + 0.25 * end
        result += [(float(x), float(y)) for x, y in (start, middle, end)]
    return result


def outline(shape: str, w: float, h: float) -> Points:
    """Outline of a shape that fills a box of width w and height h (m); a rectangle for any other name."""
    if shape == "circle":
        return circle(w / 2, h / 2, w / 2)
    if shape == "octagon":
        c = w / (2 + np.sqrt(2))
        return [(c, 0), (w - c, 0), (w, c), (w, h - c), (w - c, h), (c, h), (0, h - c), (0, c)]
    if shape == "diamond":
        return rounded([(w / 2, 0), (w, h / 2), (w / 2, h), (0, h / 2)], 0.04 * w)
    if shape == "triangle":  # point down
        return rounded([(0, 0), (w, 0), (w / 2, h)], 0.05 * w)
    if shape == "triangle_up":
        return rounded([(w / 2, 0), (w, h), (0, h)], 0.05 * w)
    if shape == "pentagon":
        return rounded([(w / 2, 0), (w, h / 2), (w, h), (0, h), (0, h / 2)], 0.03 * w)
    if shape == "pennant":
        return rounded([(0, 0), (w, h / 2), (0, h)], 0.03 * w)
    if shape == "shield":
        return [(x * w, y * h) for x, y in _SHIELD]
    return rounded([(0, 0), (w, 0), (w, h), (0, h)], min(0.045, 0.12 * min(w, h)))


def shrunk(outside: Floats, centre: Floats, inset: float, shape: str) -> Points:
    """Outline (n, 2) moved inwards by about `inset` metres."""
    offset = outside - centre
    extent = np.abs(offset).max(axis=0)
    if shape == "rectangle":
        scaled = centre + offset * (1 - inset / extent)
    else:
        apothem = {
            "diamond": extent[0] / np.sqrt(2),
            "triangle": extent[0] * 0.577,
            "triangle_up": extent[0] * 0.577,
            "pennant": extent[1] * 0.6,
            "pentagon": extent[0] * 0.9,
        }.get(shape, extent[0] * 0.96)
        scaled = centre + offset * (1 - inset / apothem)
    return [(float(x), float(y)) for x, y in scaled]
