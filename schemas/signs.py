"""Signs as the inventory lists them: landmarks placed on the path of the whole drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.landmarks import Landmark


@dataclass(frozen=True, slots=True)
class GlobePosition:
    """A point on WGS 84; sigma_m: standard deviations east, north, up of the camera and the sign together."""

    longitude_deg: float
    latitude_deg: float
    altitude_m: float
    sigma_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SignCode:
    """What sign it is, as far as it is settled.

    system: of `SYSTEMS`; code: of a sign (`R2-1`) or of a series (`R`); legend: number or direction that its face
    shows, None where it shows none or is not settled; probability: of the code; nominal_in: standard width and height,
    inches, of a diamond the side of its square; None where the measured size is none.
    """

    system: str
    code: str
    legend: str | None
    probability: float
    nominal_in: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Sign:
    """A landmark with its final position; metres, nan where a number is unknown.

    number, assembly: of the sign and of its support, from 1; status: a key of `SIGN_STATUSES`; position (3,),
    covariance (3, 3): in the camera frame of `landmark.best_frame` (right, down, ahead), with the final scale;
    centre (3,), world_covariance (3, 3): in the world frame; station_m along the path, lateral_m right of it, up_m and
    bottom_m above the road; route, measure, measure_unit: where along which route, a key of `MEASURE_UNITS`; code: None
    where not even its series is settled; us_probability: that the signs of the drive are of the US system.
    """

    number: int
    assembly: int
    landmark: Landmark
    status: str
    confidence: float
    position: NDArray[np.float64]
    covariance: NDArray[np.float64]
    centre: NDArray[np.float64]
    world_covariance: NDArray[np.float64]
    station_m: float
    lateral_m: float
    up_m: float
    bottom_m: float
    width_m: float
    height_m: float
    sigma_width_m: float
    sigma_height_m: float
    globe: GlobePosition | None
    route: str | None = None
    measure: float = math.nan
    measure_unit: str | None = None
    code: SignCode | None = None
    us_probability: float = math.nan
