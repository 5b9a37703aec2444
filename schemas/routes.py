"""Routes with measures, by which a place on a road is named: linear referencing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Rows

MEASURE_UNITS = {"mi": 1609.344, "km": 1000.0, "ft": 0.3048, "m": 1.0}
"""Units of measures along routes, in metres: the international mile and foot."""


@dataclass(frozen=True, slots=True)
class RouteSegments(Rows):
    """Straight pieces of route lines on WGS 84, n rows."""

    names: tuple[str, ...]
    """Of the routes."""
    route: NDArray[np.int64]
    """Index of the route in `names`, (n,)."""
    start: NDArray[np.float64]
    """Longitude and latitude, (n, 2), degrees."""
    end: NDArray[np.float64]
    """Longitude and latitude, (n, 2), degrees."""
    start_measure: NDArray[np.float64]
    """Measure at the start, (n,)."""
    end_measure: NDArray[np.float64]
    """Measure at the end, (n,)."""
    unit: str
    """Of the measures, a key of `MEASURE_UNITS`."""
