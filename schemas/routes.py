"""Routes with measures, by which a place on a road is named: linear referencing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MEASURE_UNITS = {"mi": 1609.344, "km": 1000.0, "ft": 0.3048, "m": 1.0}
"""Units of measures along routes, in metres: the international mile and foot."""


@dataclass(frozen=True, slots=True)
class RouteSegments:
    """Straight pieces of route lines on WGS 84, with the measure at both ends.

    names: of the routes; route (n,): index of each piece's route in `names`; start, end (n, 2): longitude and latitude,
    degrees; start_measure, end_measure (n,): in `unit`, a key of `MEASURE_UNITS`.
    """

    names: tuple[str, ...]
    route: NDArray[np.int64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    start_measure: NDArray[np.float64]
    end_measure: NDArray[np.float64]
    unit: str

    def __len__(self) -> int:
        return len(self.route)
