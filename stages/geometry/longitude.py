"""Longitudes and compass directions in degrees, which go round."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Degrees = TypeVar("Degrees", float, NDArray[np.float64])


def turn_deg(start: float, end: Degrees) -> Degrees:
    """From one longitude, or compass direction, to another the short way round, degrees, -180 to 180."""
    return (end - start + 180.0) % 360.0 - 180.0


def median_longitude_deg(longitudes: NDArray[np.float64]) -> float:
    """Median of longitudes (n,), degrees, on whichever side of 180 they lie; of a drive, not of the earth."""
    first = float(longitudes[0])
    return turn_deg(0.0, first + float(np.median(turn_deg(first, longitudes))))
