"""Signs as the inventory lists them: landmarks placed on the path of the whole drive."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.landmarks import Landmark


@dataclass(frozen=True, slots=True)
class GlobePosition:
    """A point on WGS 84."""

    longitude_deg: float
    """-180 to 180."""
    latitude_deg: float
    """-90 to 90."""
    altitude_m: float
    """Above the ellipsoid."""
    sigma_m: tuple[float, float, float]
    """Standard deviations east, north and up, of camera and sign together."""
    bearing_deg: float
    """Compass direction that the face of the panel looks in, 0 to 360. nan: its facing was not measured."""


@dataclass(frozen=True, slots=True)
class SignCode:
    """The code of a sign, or the series where only that is certain."""

    system: str
    """One of `SYSTEMS`."""
    code: str
    """Of a sign (`R2-1`) or of a series (`R`)."""
    legend: str | None
    """Number or direction on its face. None: it shows none, or uncertain."""
    probability: float
    """Of the code."""
    nominal_in: tuple[float, float] | None
    """Standard width and height, inches; of a diamond the side of its square. None: the measured size is none."""


@dataclass(frozen=True, slots=True)
class Sign:
    """A landmark with its final position. Metres, nan where a number is unknown."""

    number: int
    """From 1."""
    assembly: int
    """Number of its support, from 1."""
    landmark: Landmark
    """As it was measured."""
    status: str
    """A key of `SIGN_STATUSES`."""
    confidence: float
    """Probability that it is a sign."""
    position: NDArray[np.float64]
    """Like that of the landmark, with the final scale, (3,)."""
    covariance: NDArray[np.float64]
    """Of that position, (3, 3)."""
    centre: NDArray[np.float64]
    """In the world frame, (3,)."""
    world_covariance: NDArray[np.float64]
    """Of the centre, (3, 3)."""
    station_m: float
    """Along the path."""
    lateral_m: float
    """To the right of the path."""
    up_m: float
    """Centre above the road."""
    bottom_m: float
    """Lower edge above the road."""
    width_m: float
    """With the final scale."""
    height_m: float
    """With the final scale."""
    sigma_width_m: float
    """Standard deviation of the width."""
    sigma_height_m: float
    """Standard deviation of the height."""
    globe: GlobePosition | None
    """None: the log has no fixes."""
    route: str | None = None
    """Name of the route. None: no route is near."""
    measure: float = math.nan
    """Along the route."""
    measure_unit: str | None = None
    """A key of `MEASURE_UNITS`."""
    code: SignCode | None = None
    """None: not even its series is settled."""
    category: str | None = None
    """One of `CATEGORIES`. None: not settled."""
    sigma_bottom_m: float = math.nan
    """Standard deviation of the lower edge: of centre, height, road, level and lengths together."""
    us_probability: float = math.nan
    """That the signs of the drive are of the US system."""
    next_number: int | None = None
    """Number of the next sign of the same type ahead. None: there is none, or the type is not known."""
    spacing_m: float = math.nan
    """Distance to it along the path."""
    sigma_spacing_m: float = math.nan
    """Standard deviation of that distance."""
    radius_m: float = math.nan
    """Of the path abreast of the sign, positive in a right turn. nan: straight."""
    sigma_radius_m: float = math.nan
    """Standard deviation of the radius."""
