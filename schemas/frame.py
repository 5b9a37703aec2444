"""One image of a drive with what is known about it: times, camera, pose, fix.

Camera (optical) frame: x right, y down, z forward. Pixel centres at integers. Metres; nanoseconds in
fields that end in `_ns`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

USED, THINNED, OUTSIDE, SKIPPED = "used", "thinned", "outside", "skipped"
UNDECODABLE, WRONG_SIZE, NO_CALIBRATION = "undecodable", "wrong_size", "no_calibration"
NO_POSITION, DAMAGED, DUPLICATE = "no_position", "damaged", "duplicate"
NO_KEY_FRAME, OTHER_CAMERA, TURNED = "no_key_frame", "other_camera", "turned"
FRAME_STATUS_WORDS = {
    USED: "its candidates were looked for, and it has a pose",
    THINNED: "too near to the used image before it; its candidates are not looked for",
    OUTSIDE: "outside the part that `--from` and `--until` ask for",
    SKIPPED: "left out by `--every`",
    UNDECODABLE: "cannot be decoded",
    WRONG_SIZE: "of another size than the calibration",
    TURNED: "to be shown turned or mirrored, by its Exif orientation, while the first image is not",
    NO_CALIBRATION: "nothing says how its camera is calibrated",
    NO_POSITION: "before the first pose or fix, or behind the last",
    DAMAGED: "decodes in part only",
    DUPLICATE: "a copy of an earlier image, or shows no motion since the last used one",
    NO_KEY_FRAME: "of a video, before its first key frame or behind a missing image until the next",
    OTHER_CAMERA: "of a camera that shares the topic",
}
FRAME_STATUSES = tuple(FRAME_STATUS_WORDS)


USUAL_SIGMA_M, USUAL_SIGMA_RAD = 0.03, 1.7e-3
"""Of poses whose log states no standard deviation, until their drive has shown its own."""
EARTH_RADIUS_M = 6_371_000.0
"""Of the sphere on which short distances between fixes are measured."""


Degrees = TypeVar("Degrees", float, NDArray[np.float64])


def turn_deg(start: float, end: Degrees) -> Degrees:
    """From one longitude, or compass direction, to another the short way round, degrees, -180 to 180."""
    return (end - start + 180.0) % 360.0 - 180.0


def median_longitude_deg(longitudes: NDArray[np.float64]) -> float:
    """Median of longitudes (n,), degrees, on whichever side of 180 they lie; of a drive, not of the earth."""
    first = float(longitudes[0])
    return turn_deg(0.0, first + float(np.median(turn_deg(first, longitudes))))


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole camera with Brown (plumb_bob, k1 k2 p1 p2 k3) or rational (8, 12 or 14 numbers) distortion."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

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
    """Camera in a world frame: `rotation` (3, 3) turns camera into world axes, `centre` (3,) in metres."""

    rotation: NDArray[np.float64]
    centre: NDArray[np.float64]

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 3) of the camera frame, in the world frame."""
        return points @ self.rotation.T + self.centre

    def to_camera(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 3) of the world frame, in the camera frame."""
        return (points - self.centre) @ self.rotation

    def compose(self, inner: Pose) -> Pose:
        """Pose of `inner`, given in this camera's frame, in this pose's world."""
        return Pose(self.rotation @ inner.rotation, self.to_world(inner.centre))

    def relative_to(self, reference: Pose) -> Pose:
        """This pose in the camera frame of `reference`."""
        return Pose(reference.rotation.T @ self.rotation, reference.to_camera(self.centre))


@dataclass(frozen=True, slots=True)
class PosePrior:
    """A pose given by the log for the time of a frame, a prior and never the truth."""

    pose: Pose
    sigma_m: float | None
    sigma_rad: float | None
    source: str  # "poses" or "odometry"

    def sigmas(
        self, default_m: float = USUAL_SIGMA_M, default_rad: float = USUAL_SIGMA_RAD
    ) -> tuple[float, float]:
        """Both standard deviations; the defaults where the log states none."""
        given = (self.sigma_m, default_m), (self.sigma_rad, default_rad)
        sigma_m, sigma_rad = (own if own is not None and own > 0 else other for own, other in given)
        return sigma_m, sigma_rad


@dataclass(frozen=True, slots=True)
class Fix:
    """A satellite fix interpolated to the time of a frame; sigma east, north, up in metres.

    span_s: time between the two fixes it lies between, 0 where it is of that very moment.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    sigma_m: tuple[float, float, float] | None
    span_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Frame:
    """An image message of the chosen camera; `index` counts all of them in the order they were taken in, from 0.

    `data` holds the bytes as recorded: a compressed image (`encoding` "jpeg", "png", ...) or rows of
    `step` bytes in a raw `encoding` ("bgr8", "rgb8", "mono8", ...). Where `status` is not `used`, `data` may be empty.
    `spacing_m` is the nominal distance from the previous used frame (None: unknown). `settled_time_ns` is the capture
    time where clocks were set or wrong, so that neither header nor log time tell it (None: they do). `name`: of the
    file that was imported; `date`: when it was taken, as its camera wrote it (empty: unknown); `grey`:
    its camera sees no colour.
    """

    index: int
    log_time_ns: int
    header_time_ns: int | None
    status: str
    encoding: str
    data: bytes | memoryview = field(repr=False)
    camera: Camera | None
    width: int = 0
    height: int = 0
    step: int = 0
    pose: PosePrior | None = None
    fix: Fix | None = None
    spacing_m: float | None = None
    settled_time_ns: int | None = None
    name: str = ""
    date: str = ""
    grey: bool = False

    @property
    def label(self) -> str:
        """The name of its file, else its number."""
        return self.name or f"frame {self.index}"

    @property
    def frame(self) -> Frame:
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
    """Decoded pixels of a frame: `rgb` (height, width, 3) uint8, `grey` (height, width) uint8.

    Both are None where the frame is not used (any more). levels: `rgb` at full, half and quarter size, (rows, columns,
    3) uint8 each; None before a stage has made them.
    """

    frame: Frame
    rgb: NDArray[np.uint8] | None = field(repr=False)
    grey: NDArray[np.uint8] | None = field(repr=False)
    levels: tuple[NDArray[np.uint8], ...] | None = field(default=None, repr=False)
