"""What messages say, whatever dialect they say it in."""

import math
from dataclasses import dataclass, field

from wayside.pipeline.reading.layout import LATEST_NS
from wayside.schemas.frame import Camera, Fix

FURTHEST_M = 1e8
"""Largest coordinate of a pose: sixteen times the earth's radius, the size of earth-centred coordinates."""
LOWEST_M, HIGHEST_M = -1e3, 1e4
"""Heights of fixes: no road is lower or higher."""
VAGUEST_M = 1e3
"""A position with this standard deviation is useless; ROS drivers state 1e6 m^2 if they know nothing."""

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


class ContentError(ValueError):
    """A message cannot be decoded, or makes no sense."""


@dataclass(frozen=True, slots=True)
class ImageContent:
    """An image: compressed (`width`, `height`, `step` 0) or raw rows of `step` bytes."""

    time_ns: int | None
    frame_id: str
    encoding: str
    data: memoryview = field(repr=False)
    width: int = 0
    height: int = 0
    step: int = 0

    def __post_init__(self) -> None:
        """Refuse impossible sizes, which JSON may hold."""
        sizes = self.width, self.height, self.step
        if not all(isinstance(size, int) and 0 <= size < 1 << 32 for size in sizes):
            raise ContentError(f"an image of {self.width!r} x {self.height!r} pixels")


@dataclass(frozen=True, slots=True)
class CalibrationContent:
    """Cameras of raw images, and of rectified ones: the first by the definition of the message, others of other sizes.

    `why`, `why_rectified`: for what reason there is no first.
    """

    time_ns: int | None
    frame_id: str
    raw: tuple[Camera, ...]
    rectified: tuple[Camera, ...] = ()
    why: str = ""
    why_rectified: str = ""

    def camera_for(self, size: tuple[int, int] | None, *, rectified: bool) -> Camera | None:
        """The camera of images of a size (None: unknown), or the first where none is; None where none can be used."""
        cameras, why = (self.rectified, self.why_rectified) if rectified else (self.raw, self.why)
        fitting = (camera for camera in cameras if (camera.width, camera.height) == size)
        return next(fitting, cameras[0] if cameras and not why else None)


@dataclass(frozen=True, slots=True)
class PoseContent:
    """Frame `child` in frame `parent` (names may be empty): rotation x, y, z, w; translation in metres."""

    time_ns: int | None
    parent: str
    child: str
    rotation: Quaternion
    translation: Vector
    sigma_m: float | None = None
    sigma_rad: float | None = None

    def __post_init__(self) -> None:
        """Refuse a transform that is not a rigid motion."""
        if not all(map(math.isfinite, (*self.rotation, *self.translation))):
            raise ContentError("a pose that is not finite")
        if not max(map(abs, self.translation)) < FURTHEST_M:
            raise ContentError(f"a pose more than {FURTHEST_M / 1e3:.0f} km from its origin")
        if not 0.5 < (length := math.hypot(*self.rotation)) < 2.0:
            raise ContentError(f"a pose whose quaternion has the length {length:.3g}, not 1")


@dataclass(frozen=True, slots=True)
class FixContent:
    """A satellite fix."""

    time_ns: int | None
    fix: Fix


Content = ImageContent | CalibrationContent | PoseContent | FixContent


def stamp_ns(seconds: int, nanoseconds: int) -> int | None:
    """Nanoseconds of a time stamp; None where it is not set (0), or not before `LATEST_NS`."""
    stamp = int(seconds) * 10**9 + int(nanoseconds)
    return stamp if stamp and abs(stamp) < LATEST_NS else None


def make_fix(
    time_ns: int | None,
    latitude: float,
    longitude: float,
    altitude: float,
    covariance: tuple[float, ...] | None,
) -> list[FixContent]:
    """A fix with the standard deviations east, north, up of its row-major 3x3 covariance.

    Nothing where latitude or longitude is not finite or out of range, where both are 0, or where they are known to
    `VAGUEST_M` at best. Receivers write these values without a fix. A height that is not finite is taken as 0.

    Raises ContentError for a height that no road has.
    """
    if not (abs(latitude) <= 90 and abs(longitude) <= 180) or latitude == longitude == 0:
        return []
    sigma = None
    if covariance is not None and len(covariance) == 9:
        east, north, up = covariance[0], covariance[4], covariance[8]
        if max(east, north, up) >= VAGUEST_M**2:
            return []
        if all(variance > 0 for variance in (east, north, up)):  # else, or not a number: unknown
            sigma = (math.sqrt(east), math.sqrt(north), math.sqrt(up))
    height = altitude if math.isfinite(altitude) else 0.0
    if not LOWEST_M < height < HIGHEST_M:
        raise ContentError(f"a fix at a height of {height:.3g} m")
    return [FixContent(time_ns, Fix(latitude, longitude, height, sigma))]
