"""One image of a drive with what is known about it: times, camera, pose, fix.

Camera (optical) frame: x right, y down, z forward. Pixel centres at integers. Metres; nanoseconds in
fields that end in `_ns`.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

USED, THINNED, OUTSIDE, SKIPPED = "used", "thinned", "outside", "skipped"
UNDECODABLE, WRONG_SIZE, NO_CALIBRATION = "undecodable", "wrong_size", "no_calibration"
NO_POSITION, DAMAGED, DUPLICATE = "no_position", "damaged", "duplicate"
NO_KEY_FRAME, OTHER_CAMERA, TURNED = "no_key_frame", "other_camera", "turned"
FRAME_STATUS_WORDS = {
    USED: "searched for signs, and has a pose",
    THINNED: "too close to the previous used image; it is not searched for signs",
    OUTSIDE: "outside the part that `--from` and `--until` select",
    SKIPPED: "left out by `--every`",
    UNDECODABLE: "cannot be decoded",
    WRONG_SIZE: "of another size than the calibration",
    TURNED: "rotated or mirrored by its Exif orientation, unlike the first image",
    NO_CALIBRATION: "the calibration of its camera is not known",
    NO_POSITION: "before the first pose or fix, or after the last",
    DAMAGED: "can be decoded only in part",
    DUPLICATE: "a copy of an earlier image, or shows no motion since the last used one",
    NO_KEY_FRAME: "of a video, before its first key frame, or between a missing image and the next key frame",
    OTHER_CAMERA: "from another camera on the same topic",
}
FRAME_STATUSES = tuple(FRAME_STATUS_WORDS)


USUAL_SIGMA_M, USUAL_SIGMA_RAD = 0.03, 1.7e-3
"""Of poses whose log states no standard deviation, until their drive has shown its own."""
EARTH_RADIUS_M = 6_371_000.0
"""Of the sphere on which short distances between fixes are measured."""


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole camera with Brown (plumb_bob) or rational distortion."""

    width: int
    """Columns of its images."""
    height: int
    """Rows of its images."""
    fx: float
    """Focal length along a row, px."""
    fy: float
    """Focal length along a column, px."""
    cx: float
    """Column of the optical axis, px."""
    cy: float
    """Row of the optical axis, px."""
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2, k3 (4 or 5 numbers), or the rational model of OpenCV (8, 12 or 14). Empty: none."""

    def __post_init__(self) -> None:
        """Refuse what no lens can have."""
        if self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"focal lengths must be positive, but are {self.fx}, {self.fy}")
        if len(self.distortion) not in (0, 4, 5, 8, 12, 14):
            raise ValueError(
                f"distortion must have 0, 4, 5, 8, 12 or 14 numbers, but has {len(self.distortion)}"
            )

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Camera matrix, shape (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)


@dataclass(frozen=True, slots=True)
class Pose:
    """Position and direction of a camera in a world frame."""

    rotation: NDArray[np.float64]
    """Turns camera axes into world axes, (3, 3)."""
    centre: NDArray[np.float64]
    """Centre of the camera in the world, (3,), metres."""

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 3) of the camera frame, in the world frame."""
        return points @ self.rotation.T + self.centre

    def to_camera(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 3) of the world frame, in the camera frame."""
        return (points - self.centre) @ self.rotation

    def compose(self, inner: "Pose") -> "Pose":
        """Pose of `inner`, given in this camera's frame, in this pose's world."""
        return Pose(self.rotation @ inner.rotation, self.to_world(inner.centre))

    def relative_to(self, reference: "Pose") -> "Pose":
        """This pose in the camera frame of `reference`."""
        return Pose(reference.rotation.T @ self.rotation, reference.to_camera(self.centre))


@dataclass(frozen=True, slots=True)
class PosePrior:
    """A pose that the log states for the time of a frame. It is a prior and never the truth."""

    pose: Pose
    """The camera in the world of the log."""
    sigma_m: float | None
    """Standard deviation of the position. None: not stated."""
    sigma_rad: float | None
    """Standard deviation of the rotation. None: not stated."""
    source: str
    """`poses` or `odometry`."""

    def sigmas(
        self, default_m: float = USUAL_SIGMA_M, default_rad: float = USUAL_SIGMA_RAD
    ) -> tuple[float, float]:
        """Both standard deviations; the defaults where the log states none."""
        given = (self.sigma_m, default_m), (self.sigma_rad, default_rad)
        sigma_m, sigma_rad = (own if own is not None and own > 0 else other for own, other in given)
        return sigma_m, sigma_rad


@dataclass(frozen=True, slots=True)
class Fix:
    """A satellite fix, interpolated to the time of a frame."""

    latitude_deg: float
    """On WGS 84."""
    longitude_deg: float
    """On WGS 84."""
    altitude_m: float
    """Above the ellipsoid."""
    sigma_m: tuple[float, float, float] | None
    """Standard deviations east, north and up. None: not stated."""
    span_s: float = 0.0
    """Time between the two fixes around it. 0: a fix of that very moment."""


@dataclass(frozen=True, slots=True)
class Frame:
    """An image message of the chosen camera."""

    index: int
    """Number among all images of the camera, in the order they were taken in, from 0."""
    log_time_ns: int
    """When it was logged."""
    header_time_ns: int | None
    """Capture time in its header. None: not set."""
    status: str
    """A key of `FRAME_STATUS_WORDS`."""
    encoding: str
    """Of `data`: `jpeg`, `png`, ... of a compressed image; `bgr8`, `rgb8`, `mono8`, ... of a raw one."""
    data: bytes | memoryview = field(repr=False)
    """The bytes as recorded. May be empty where the frame is not used."""
    camera: Camera | None
    """Its calibration. None: unknown."""
    width: int = 0
    """Columns of a raw image."""
    height: int = 0
    """Rows of a raw image."""
    step: int = 0
    """Bytes of a row of a raw image."""
    pose: PosePrior | None = None
    """The pose that the log states. None: none."""
    fix: Fix | None = None
    """The satellite fix. None: none."""
    spacing_m: float | None = None
    """Nominal distance from the previous used frame. None: unknown."""
    settled_time_ns: int | None = None
    """Capture time where clocks were set or wrong. None: the header or the log tells it."""
    name: str = ""
    """Name of the file that was imported."""
    date: str = ""
    """When it was taken, as its camera wrote it. Empty: unknown."""
    grey: bool = False
    """Whether its camera sees no colour."""

    @property
    def label(self) -> str:
        """The name of its file, else its number."""
        return self.name or f"frame {self.index}"

    @property
    def frame(self) -> "Frame":
        """Itself: every type that travels through the flow names its frame."""
        return self

    @property
    def used(self) -> bool:
        """Whether the frame takes part in the measurement."""
        return self.status == USED

    @property
    def time_ns(self) -> int:
        """Capture time: the header's where set, else the log's; where both are wrong, that found in their place."""
        if self.settled_time_ns is not None:
            return self.settled_time_ns
        return self.log_time_ns if self.header_time_ns is None else self.header_time_ns


@dataclass(frozen=True, slots=True)
class Image:
    """Decoded pixels of a frame."""

    frame: Frame
    """The frame they are of."""
    rgb: NDArray[np.uint8] | None = field(repr=False)
    """(height, width, 3). None: the frame is not used, or not any more."""
    grey: NDArray[np.uint8] | None = field(repr=False)
    """(height, width). None where `rgb` is."""
