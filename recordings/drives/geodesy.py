"""WGS 84 positions of points of a local tangent plane."""

import numpy as np

from recordings.drives.arrays import Floats

_A, _F = 6378137.0, 1 / 298.257223563
_E2 = _F * (2 - _F)


def geodetic(origin: tuple[float, float, float], enu: Floats) -> tuple[float, float, float]:
    """WGS 84 latitude, longitude (deg) and altitude (m) of a point (3,) east, north, up of an origin (m).

    Through earth-centred coordinates; the latitude by fixed-point iteration.
    """
    latitude, longitude = np.radians(origin[:2])
    n = _A / np.sqrt(1 - _E2 * np.sin(latitude) ** 2)
    base = np.array(
        [
            (n + origin[2]) * np.cos(latitude) * np.cos(longitude),
            (n + origin[2]) * np.cos(latitude) * np.sin(longitude),
            (n * (1 - _E2) + origin[2]) * np.sin(latitude),
        ]
    )
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    level = np.cos(latitude)
    up = np.array([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)])
    x, y, z = base + enu[0] * east + enu[1] * np.cross(up, east) + enu[2] * up
    across = np.hypot(x, y)
    angle, height = np.arctan2(z, across * (1 - _E2)), 0.0
    for _ in range(6):
        n = _A / np.sqrt(1 - _E2 * np.sin(angle) ** 2)
        height = across / np.cos(angle) - n
        angle = np.arctan2(z, across * (1 - _E2 * n / (n + height)))
    return float(np.degrees(angle)), float(np.degrees(np.arctan2(y, x))), float(height)
