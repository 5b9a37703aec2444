"""What the messages say, whatever their dialect."""

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from recordings.drives.arrays import Bytes, Floats
from recordings.drives.spec import CameraSpec

WORLD, CAMERA, ANTENNA = "world", "camera_optical", "gps"
"""Frames of reference."""

IDENTITY = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]

DIAGONAL_KNOWN = 2
"""Position covariance type, the same number in all dialects."""

EncodedMessage: TypeAlias = tuple[str, bytes]
"""Name of the schema and serialised content."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Pinhole matrix and Brown coefficients (k1, k2, p1, p2, k3) of an image."""

    camera: CameraSpec

    @property
    def k(self) -> list[float]:
        """Camera matrix, row-major 3x3."""
        c = self.camera
        return [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]

    @property
    def p(self) -> list[float]:
        """Projection matrix, row-major 3x4."""
        c = self.camera
        return [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0]


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Camera in the world: position (m), quaternion x, y, z, w, and their standard deviations."""

    position: Floats
    quaternion: Floats
    sigma_m: float
    sigma_deg: float

    def covariance(self) -> Floats:
        """Row-major 6x6: square metres, then square radians."""
        turn = np.radians(self.sigma_deg) ** 2
        return np.diag([self.sigma_m**2] * 3 + [turn] * 3).ravel()


@dataclass(frozen=True, slots=True)
class FixReading:
    """Position fix: WGS 84 degrees and metres, standard deviations east, north, up (m)."""

    latitude: float
    longitude: float
    altitude: float
    sigma: tuple[float, float, float]

    def covariance(self) -> list[float]:
        """Row-major 3x3, east-north-up, square metres."""
        return [float(v) for v in np.diag(np.square(self.sigma)).ravel()]


class Dialect(Protocol):
    """One way to write the messages of a drive; times are header times in nanoseconds."""

    encoding: str
    schema_encoding: str

    def schema(self, name: str) -> bytes:
        """Schema of a message type."""
        ...

    def compressed(self, time_ns: int, jpeg: bytes) -> EncodedMessage:
        """A JPEG image."""
        ...

    def raw(self, time_ns: int, image: Bytes) -> EncodedMessage:
        """A bgr8 image (height, width, 3)."""
        ...

    def calibration(self, time_ns: int, calibration: Calibration) -> EncodedMessage:
        """Camera calibration."""
        ...

    def pose(self, time_ns: int, pose: CameraPose) -> EncodedMessage:
        """Camera pose in the world."""
        ...

    def fix(self, time_ns: int, fix: FixReading) -> EncodedMessage:
        """Position fix."""
        ...
