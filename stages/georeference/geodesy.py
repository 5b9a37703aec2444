"""WGS 84 and a local frame on it: east, north, up about an origin, and the cameras of a drive in that frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wayside.schemas.frame import Fix, Pose
from wayside.stages.geometry import cross_matrices, median_longitude_deg, turn_deg
from wayside.stages.georeference.trajectory import Trajectory
from wayside.stages.kernels import Array

SHORTEST_STEP_M = 0.5
"""Least distance between cameras that give a direction of travel."""

ORIGIN_REACH_DEG = 1.0
"""A fix farther from the median of all cannot be the origin: receivers that start up report other continents."""


@dataclass(frozen=True, slots=True)
class LocalOrigin:
    """A point on WGS 84; `local` and `geodetic` convert to east, north, up (metres) and back."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    def local(self, fixes: Sequence[Fix]) -> Array:
        """East, north, up (n, 3) of fixes."""
        rows = [(f.longitude_deg, f.latitude_deg, f.altitude_m) for f in fixes]
        return self.topocentric(np.array(rows, np.float64).reshape(-1, 3))

    def topocentric(self, points: Array) -> Array:
        """East, north, up (n, 3) of points (n, 3): longitude, latitude (deg), ellipsoidal height (m)."""
        return np.column_stack(_topocentric(self).transform(*points.T))

    def geodetic(self, points: Array) -> Array:
        """Longitude, latitude (deg) and ellipsoidal height (m), (n, 3), of points (n, 3) east, north, up."""
        return np.column_stack(_topocentric(self).transform(*points.T, direction="INVERSE"))


@dataclass(frozen=True, slots=True)
class Globe:
    """The cameras of a drive in east, north, up about `origin`; rows: of each frame in `trajectory`."""

    origin: LocalOrigin
    rows: dict[int, int]
    trajectory: Trajectory

    def route(self) -> Array:
        """Longitude, latitude (deg) and height (m) of all cameras, (n, 3)."""
        return self.origin.geodetic(self.trajectory.centre)

    def heading_deg(self) -> Array:
        """Compass direction (n,) that each camera looks in, clockwise from north, 0 to 360."""
        ahead = self.trajectory.rotation[:, :, 2]
        return np.asarray(np.degrees(np.arctan2(ahead[:, 0], ahead[:, 1])) % 360)

    def travel_deg(self, frame: int) -> float:
        """Compass direction of travel at a frame: from the camera before to the next one. nan: it stands still."""
        row, centre = self.rows[frame], self.trajectory.centre
        east, north, _ = centre[min(row + 1, len(centre) - 1)] - centre[max(row - 1, 0)]
        moved = np.hypot(east, north) > SHORTEST_STEP_M
        return float(np.degrees(np.arctan2(east, north)) % 360) if moved else np.nan

    def pose(self, frame: int) -> Pose:
        """The camera of a frame in east, north, up."""
        row = self.rows[frame]
        return Pose(self.trajectory.rotation[row], self.trajectory.centre[row])

    def point_covariance(self, frame: int, position: Array, covariance: Array) -> Array:
        """Covariance (3, 3) east, north, up of a point: its own relative to a camera, and that of the camera.

        `position` (3,), `covariance` (3, 3): in the axes of the camera of `frame`, metres.
        """
        row = self.rows[frame]
        rotation = self.trajectory.rotation[row]
        jacobian = np.hstack([np.eye(3), -cross_matrices(rotation @ position)])
        camera = self.trajectory.covariance[row, :6, :6]
        return np.asarray(jacobian @ camera @ jacobian.T + rotation @ covariance @ rotation.T)


def origin_of(fixes: Sequence[Fix]) -> LocalOrigin:
    """The first fix within reach of the median of all: receivers that start up report other continents."""
    latitude, longitude = np.array([(f.latitude_deg, f.longitude_deg) for f in fixes]).T
    apart = latitude - np.median(latitude), turn_deg(median_longitude_deg(longitude), longitude)
    first = fixes[int((np.abs(apart) < ORIGIN_REACH_DEG).all(axis=0).argmax())]
    return LocalOrigin(first.latitude_deg, first.longitude_deg, first.altitude_m)


def align_level(local: Array, outside: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) about z and shift (3,) that take points (n, 3) to others (n, 3), a minority of them outliers.

    The angle is the weighted median of those between points half the drive apart, the shift the median.
    """
    half = max(1, len(local) // 2)
    a, b = local[half:, :2] - local[:-half, :2], outside[half:, :2] - outside[:-half, :2]
    angle = np.arctan2(b[:, 1], b[:, 0]) - np.arctan2(a[:, 1], a[:, 0])
    weight = np.minimum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    mean = float(np.angle((weight * np.exp(1j * angle)).sum() + 1e-300))
    deviation = np.angle(np.exp(1j * (angle - mean)))
    order = np.argsort(deviation, kind="stable")
    cumulative = np.cumsum(weight[order])
    moved = len(cumulative) > 0 and cumulative[-1] > 0
    middle = deviation[order][np.searchsorted(cumulative, cumulative[-1] / 2)] if moved else 0.0
    c, s = np.cos(mean + middle), np.sin(mean + middle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return rotation, np.median(outside - local @ rotation.T, axis=0)


def _topocentric(origin: LocalOrigin) -> Any:
    from pyproj import Transformer  # takes 0.1 s, and drives without fixes do without

    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={origin.longitude_deg!r} +lat_0={origin.latitude_deg!r} "
        f"+h_0={origin.altitude_m!r}"
    )
