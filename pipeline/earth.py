"""Where a drive lies on the globe: east, north, up round an origin on WGS 84, and the cameras in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from wayside.schemas.frame import Fix, Pose
from wayside.stages.geometry import cross_matrix
from wayside.stages.georeference import Trajectory
from wayside.stages.kernels import Array

NEAR_DEG = 1.0
"""Fixes further than this from the middle of all cannot be of the same drive."""


@dataclass(frozen=True, slots=True)
class Origin:
    """A point on WGS 84; `local` and `geodetic` lead to east, north, up (metres) and back."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    def local(self, fixes: Sequence[Fix]) -> Array:
        """East, north, up (n, 3) of fixes."""
        columns = _topocentric(self).transform(
            [f.longitude_deg for f in fixes],
            [f.latitude_deg for f in fixes],
            [f.altitude_m for f in fixes],
        )
        return np.stack([np.asarray(column, np.float64) for column in columns], axis=1)

    def geodetic(self, points: Array) -> Array:
        """Longitude, latitude (deg) and ellipsoidal height (m) of points (n, 3) east, north, up."""
        x, y, z = points.T
        columns = _topocentric(self).transform(x, y, z, direction="INVERSE")
        return np.stack([np.asarray(column) for column in columns], axis=1)


@dataclass(frozen=True, slots=True)
class Earth:
    """The cameras of a drive in east, north, up: `path` frame by frame, the row of each frame in `rows`."""

    origin: Origin
    rows: dict[int, int]
    path: Trajectory

    def route(self) -> Array:
        """Longitude, latitude (deg) and height (m) of all cameras, (n, 3)."""
        return self.origin.geodetic(self.path.centre)

    def pose(self, frame: int) -> Pose:
        """The camera of a frame in east, north, up."""
        row = self.rows[frame]
        return Pose(self.path.rotation[row], self.path.centre[row])

    def spread(self, frame: int, position: Array, covariance: Array) -> Array:
        """Covariance (3, 3) east, north, up of a point given by a camera: its own and that of the camera.

        Parameters
        ----------
        position, covariance
            (3,) and (3, 3) in the camera's axes, metres.
        """
        row = self.rows[frame]
        rotation = self.path.rotation[row]
        slopes = np.hstack([np.eye(3), -cross_matrix(rotation @ position)])
        camera = self.path.covariance[row, :6, :6]
        return np.asarray(slopes @ camera @ slopes.T + rotation @ covariance @ rotation.T)


def origin_of(fixes: Sequence[Fix]) -> Origin:
    """The first fix that can be one of this drive: receivers that wake up tell of other continents."""
    latitude = float(np.median([f.latitude_deg for f in fixes]))
    longitude = float(np.median([f.longitude_deg for f in fixes]))
    first = next((f for f in fixes if _is_near(f, latitude, longitude)), fixes[0])
    return Origin(first.latitude_deg, first.longitude_deg, first.altitude_m)


def align_level(local: Array, outside: Array) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) about z and shift (3,) that lay points (n, 3) over others (n, 3), few of which may be far off.

    The angle is the weighted median of those between points half the drive apart, the shift the median.
    """
    half = max(1, len(local) // 2)
    a, b = local[half:, :2] - local[:-half, :2], outside[half:, :2] - outside[:-half, :2]
    angle = np.arctan2(b[:, 1], b[:, 0]) - np.arctan2(a[:, 1], a[:, 0])
    weight = np.minimum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    mean = float(np.angle((weight * np.exp(1j * angle)).sum() + 1e-300))
    beside = np.angle(np.exp(1j * (angle - mean)))
    order = np.argsort(beside, kind="stable")
    share = np.cumsum(weight[order])
    moved = len(share) > 0 and share[-1] > 0
    middle = beside[order][np.searchsorted(share, share[-1] / 2)] if moved else 0.0
    c, s = np.cos(mean + middle), np.sin(mean + middle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return rotation, np.median(outside - local @ rotation.T, axis=0)


def _is_near(fix: Fix, latitude_deg: float, longitude_deg: float) -> bool:
    turn = (fix.longitude_deg - longitude_deg + 180) % 360 - 180
    return abs(fix.latitude_deg - latitude_deg) < NEAR_DEG and abs(turn) < NEAR_DEG


def _topocentric(origin: Origin) -> Transformer:
    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={origin.longitude_deg!r} +lat_0={origin.latitude_deg!r} "
        f"+h_0={origin.altitude_m!r}"
    )
