"""What messages say, whatever dialect they say it in."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.layout import LATEST_NS
from wayside.schemas.frame import Camera, Fix

FURTHEST_M = 1e8
"""Largest coordinate of a pose: sixteen times the earth's radius, which coordinates about its centre have."""
LOWEST_M, HIGHEST_M = -1e3, 1e4
"""Heights of fixes: no road is lower or higher."""
VAGUEST_M = 1e3
"""Standard deviation from which a position tells nothing; ROS drivers state 1e6 m^2 where they know nothing."""

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


class ContentError(ValueError):
    """A message that follows its schema and still makes no sense."""


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


@dataclass(frozen=True, slots=True)
class CalibrationContent:
    """A calibration; `camera` is None where it cannot be used, and `why` says for what reason."""

    time_ns: int | None
    frame_id: str
    camera: Camera | None
    why: str = ""


@dataclass(frozen=True, slots=True)
class PoseContent:
    """Frame `child` in frame `parent` (names may be empty): rotation x, y, z, w; translation in metres.

    refused: what it states that cannot be and is taken as unknown; empty: nothing.
    """

    time_ns: int | None
    parent: str
    child: str
    rotation: Quaternion
    translation: Vector
    sigma_m: float | None = None
    sigma_rad: float | None = None
    refused: str = ""

    def __post_init__(self) -> None:
        """Refuse what is no rigid motion."""
        if not all(map(math.isfinite, (*self.rotation, *self.translation))):
            raise ContentError("a pose that is not finite")
        if not max(map(abs, self.translation)) < FURTHEST_M:
            raise ContentError(f"a pose more than {FURTHEST_M / 1e3:.0f} km from its origin")
        if not 0.5 < (length := math.hypot(*self.rotation)) < 2.0:
            raise ContentError(f"a pose whose quaternion has the length {length:.3g}, not 1")


@dataclass(frozen=True, slots=True)
class FixContent:
    """A satellite fix; refused: as in `PoseContent`."""

    time_ns: int | None
    fix: Fix
    refused: str = ""


Content = ImageContent | CalibrationContent | PoseContent | FixContent

_SUPPORTED_LENSES = {"", "plumb_bob", "rational_polynomial", "radtan", "brown_conrady"}
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
_ROUNDING = 1e-9
"""Entries of a camera matrix smaller than this, relative to its focal length, are errors of rounding."""
_LARGEST_IMAGE_PX = 200_000_000
"""The largest survey cameras have 150 million; each pixel takes some dozen bytes while its image is processed."""
_NARROWEST_DEG, _WIDEST_DEG = 0.1, 170.0
"""Of a telescope, and of a lens whose image a plane can hold; other angles are a slip in the focal length."""


def stamp_ns(seconds: int, nanoseconds: int) -> int | None:
    """Nanoseconds of a time stamp; None where it is not set (0), or not before `LATEST_NS`."""
    stamp = int(seconds) * 10**9 + int(nanoseconds)
    return stamp if stamp and abs(stamp) < LATEST_NS else None


OTHER_LENSES = (
    "positions follow from pinhole rays; for a fisheye fit --model rational to images of a board, or remap the images "
    "to a pinhole first (cv2.fisheye.undistortImage)"
)
"""What to do where a lens has another model."""


def check_video_format(name: str) -> None:
    """Refuse a video that is not of H.264 by the name of its format; raises ContentError."""
    if name.lower() != H264:
        raise ContentError(f"it is video of the format {name!r}; h264 is understood")


def make_camera(
    size: tuple[int, int], k: tuple[float, ...], model: str, d: tuple[float, ...]
) -> Camera:
    """A camera of the 3x3 matrix `k` (row by row) and the distortion `d` of a lens model by its ROS name.

    Raises
    ------
    ContentError
        The camera is not calibrated, its pixels are skewed, or its lens is none that can be used.
    """
    if len(k) != 9 or not all(map(math.isfinite, (*k, *d))) or k[0] <= 0 or k[4] <= 0:
        raise ContentError("it has no focal length (not calibrated)")
    width, height = size
    if min(size) <= 0 or width * height > _LARGEST_IMAGE_PX:
        raise ContentError(f"its image size {width} x {height} makes no sense")
    for focal, centre, length in ((k[0], k[2], width), (k[4], k[5], height)):
        angle = math.degrees(2 * math.atan2(length / 2, focal))
        if not _NARROWEST_DEG < angle < _WIDEST_DEG:
            raise ContentError(
                f"its focal length {focal:g} px makes an angle of view of {angle:.3g} degrees over {length} px"
            )
        if not -length <= centre <= 2 * length:
            raise ContentError(
                f"its centre {centre:g} px lies far outside of the image of {length} px"
            )
    if not any(d):
        d = ()
    if d and model.lower() not in _SUPPORTED_LENSES:
        raise ContentError(
            f"its lens model {model} is not understood; plumb_bob and rational_polynomial are: {OTHER_LENSES}"
        )
    if len(d) not in _COEFFICIENTS:
        raise ContentError(
            f"its lens has {len(d)} coefficients; 0, 4, 5, 8, 12 or 14 are understood"
        )
    if abs(k[1]) > _ROUNDING * k[0]:
        raise ContentError(
            f"its camera matrix has skew ({k[1]:g} px), which no point here is corrected for; "
            "calibrate with skew fixed at 0"
        )
    if max(abs(k[3]), abs(k[6]), abs(k[7])) > _ROUNDING * k[0] or abs(k[8] - 1) > _ROUNDING:
        raise ContentError("its camera matrix is not of the form fx 0 cx, 0 fy cy, 0 0 1")
    return Camera(size[0], size[1], k[0], k[4], k[2], k[5], d)


NO_COVARIANCE = "a covariance with variances that are negative or not a number"


def refused_variances(variances: Iterable[float]) -> str:
    """`NO_COVARIANCE` where one of the variances cannot be; empty elsewhere: zero and infinite ones mean unknown."""
    return "" if all(variance >= 0 for variance in variances) else NO_COVARIANCE


def make_fix(
    time_ns: int | None,
    latitude: float,
    longitude: float,
    altitude: float,
    covariance: tuple[float, ...] | None,
) -> list[FixContent]:
    """A fix with the standard deviations east, north, up of its row-major 3x3 covariance.

    Nothing where latitude or longitude is not finite or out of range, where both are 0, or where they are known to
    `VAGUEST_M` at best: receivers write that while they have no fix. A height that is not finite is taken as 0.

    Raises
    ------
    ContentError
        The height is none of a road.
    """
    if not (abs(latitude) <= 90 and abs(longitude) <= 180) or latitude == longitude == 0:
        return []
    sigma, refused = None, ""
    if covariance is not None and len(covariance) == 9:
        east, north, up = covariance[0], covariance[4], covariance[8]
        refused = refused_variances((east, north, up))
        if not refused and max(east, north, up) >= VAGUEST_M**2:
            return []
        if not refused and min(east, north, up) > 0:
            sigma = (math.sqrt(east), math.sqrt(north), math.sqrt(up))
    height = altitude if math.isfinite(altitude) else 0.0
    if not LOWEST_M < height < HIGHEST_M:
        raise ContentError(f"a fix at a height of {height:.3g} m")
    return [FixContent(time_ns, Fix(latitude, longitude, height, sigma), refused)]
