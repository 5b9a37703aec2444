"""Polygons."""

import numpy as np

from recordings.drives.arrays import Floats


def clip_near(polygon: Floats, near: float) -> Floats:
    """Part of a camera-frame polygon (n, 3) with z >= near; fewer than 3 points if none is left."""
    result = []
    for i, point in enumerate(polygon):
        before = polygon[i - 1]
        if (before[2] < near) != (point[2] < near):
            w = (near - before[2]) / (point[2] - before[2])
            result.append(before + (point - before) * w)
        if point[2] >= near:
            result.append(point)
    return np.array(result)


def polygon_area(points: Floats) -> float:
    """Area of a polygon (n, 2), by the shoelace formula."""
    x, y = points[:, 0], points[:, 1]
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
