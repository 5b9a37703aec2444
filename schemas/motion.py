"""Motion of the camera between images, and the tie points it was measured by."""

from dataclasses import dataclass
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections
from wayside.schemas.frame import Frame, Pose, PosePrior

ROUGH_LENGTHS = ("fixes", "points", "speed")
"""Sources that know the length of a step only roughly: the path of the whole drive determines it."""


@dataclass(frozen=True, slots=True)
class Ties:
    """Tie points between the previous and the current frame, n rows."""

    previous: NDArray[np.float64]
    """Where they are in the previous frame, (n, 2), ideal (undistorted) pixels."""
    current: NDArray[np.float64]
    """Where they are in the current frame, (n, 2), ideal pixels."""
    inlier: NDArray[np.bool_]
    """Whether they are near enough to the measured motion, (n,)."""
    point: NDArray[np.float64]
    """In the current camera frame, (n, 3), metres. nan: not triangulated."""
    rows: NDArray[np.int64]
    """Corners of both frames that were matched, (n, 2). -1: none. They link ties of several steps to a track."""
    warp: NDArray[np.float64]
    """Map of the patch to the current frame, (n, 3): stretch along u, shear of u by v, stretch along v."""
    sigma_px: NDArray[np.float64]
    """Standard deviation of the registration along the worst direction of the patch, (n,)."""
    scatter: float = 1.0
    """Errors of the ties by their residuals, over the stated ones. 1: as stated."""


class StepPrior(NamedTuple):
    """What is known of a step before its images are compared."""

    rotation: NDArray[np.float64]
    """(3, 3)."""
    sigma_rotation: float
    """Radians. inf: unknown."""
    direction: NDArray[np.float64]
    """Direction of travel, (3,)."""
    sigma_direction: NDArray[np.float64]
    """Slopes sideways and up, (2,)."""
    halfway: bool
    """Whether `direction` is in axes half way through the rotation (constant on an arc), else the previous ones."""
    length_m: float
    """Length of the step."""
    sigma_m: float
    """Standard deviation of the length."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The step from the previous used frame to this one."""

    pose: Pose
    """Camera in the frame of the drive (the first used camera), from chained steps."""
    step: Pose | None = None
    """Camera in the frame of the previous camera. None: the first used frame."""
    covariance: NDArray[np.float64] | None = None
    """Of the step, (6, 6): rotation vector, rad, then translation, m. None: unknown."""
    source: str = "start"
    """Prior of the step, a key of `MOTION_SOURCES`."""
    baseline_m: float = 0.0
    """Length of the step."""
    station_m: float = 0.0
    """Distance travelled from the first used frame."""
    ties: Ties | None = None
    """Tie points to the previous frame. None: none."""
    residual_straight_px: float = nan
    """RMS of eq. 7.5 a coordinate with the straight motion of the prior."""
    residual_px: float = nan
    """RMS of eq. 7.5 a coordinate with the motion that is used."""
    adjusted: bool = False
    """Whether the motion was adjusted."""
    iterations: int = 0
    """Iterations of the adjustment."""
    camera_height_m: float = nan
    """Above the road below. nan: unknown."""
    straight: Pose | None = None
    """The step along a straight line of its length. None: nothing was measured."""
    history_px: tuple[float, ...] = ()
    """RMS of eq. 7.5 of the inliers, at the start and after each iteration."""
    length_ratio: tuple[float, float] = (nan, nan)
    """Length over that of the step before, by points common to both, and its standard deviation."""
    prior: StepPrior | None = None
    """What is known of the step before its images are compared. None: nothing."""
    given: PosePrior | None = None
    """Pose that the log states, its standard deviations as the drive has shown them. None: none."""


@dataclass(frozen=True, slots=True)
class PosedDetections:
    """Detections of an image with the motion of the camera."""

    detections: Detections
    """What the image shows."""
    motion: Motion | None
    """None: the frame is not used."""

    @property
    def frame(self) -> Frame:
        """The frame that the image belongs to."""
        return self.detections.frame
