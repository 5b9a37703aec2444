"""Motion of the camera between images, and the tie points it was measured by."""

from __future__ import annotations

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
    """Tie points between the previous and the current frame: ideal (undistorted) pixels, shape (n, 2) each.

    inlier (n,) bool: within the inlier distance of the measured motion. point (n, 3) float64: in the current camera
    frame, metres, nan where it cannot be triangulated. rows (n, 2) int64: corners of both frames that were matched (-1:
    none), by which ties of several steps form a track; warp (n, 3): affine map of the surroundings of `previous` to the
    current frame (stretch along u, shear of u by v, stretch along v); sigma_px (n,): standard deviation of the
    registration along the patch's worst direction. scatter: errors of the ties over those that the settings state, by
    the residuals of the step (1: as stated).
    """

    previous: NDArray[np.float64]
    current: NDArray[np.float64]
    inlier: NDArray[np.bool_]
    point: NDArray[np.float64]
    rows: NDArray[np.int64]
    warp: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    scatter: float = 1.0


class StepPrior(NamedTuple):
    """What is known of a step before its images are compared.

    rotation (3, 3) with sigma_rotation in radians (inf: unknown). Direction of travel (3,) with sigma_direction (2,)
    as slopes sideways and up: in the axes half way through the rotation where `halfway` (a camera fixed to a vehicle
    that drives an arc travels there in a constant direction, that of the chord), else in the previous camera's axes.
    length_m of the step and its sigma_m.
    """

    rotation: NDArray[np.float64]
    sigma_rotation: float
    direction: NDArray[np.float64]
    sigma_direction: NDArray[np.float64]
    halfway: bool
    length_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Motion:
    """The step from the previous used frame to this one.

    step: pose of the current camera in the previous camera's frame (None at the first used frame); pose: of the
    camera in the drive's own frame (origin and axes of the first used camera), by chained steps; covariance (6, 6)
    of the step (rotation vector, rad, then translation, m) or None; source: "start", "straight", "points",
    "odometry", "poses", "fixes" or "speed" (the prior); residuals (eq. 7.5 as RMS per coordinate, px) of straight-line
    and adjusted motion.
    expected: the step by the prior alone (None where there was no measurement);
    history_px: RMS of eq. 7.5 per coordinate over the inliers at the start of the adjustment and after each iteration.
    length_ratio: length of the step over that of the step before, by points common to both, and its scatter;
    prior: what is known of the step before its images are compared (None: nothing);
    given: the log's pose of the frame, with its standard deviations as the drive has shown them.
    """

    pose: Pose
    step: Pose | None
    covariance: NDArray[np.float64] | None
    source: str
    baseline_m: float
    station_m: float
    ties: Ties | None
    residual_straight_px: float
    residual_px: float
    adjusted: bool
    iterations: int
    camera_height_m: float  # above the road below, nan where unknown
    expected: Pose | None = None
    history_px: tuple[float, ...] = ()
    length_ratio: tuple[float, float] = (nan, nan)
    prior: StepPrior | None = None
    given: PosePrior | None = None


@dataclass(frozen=True, slots=True)
class PosedDetections:
    """Detections of an image with the camera's motion; `motion` is None where the frame is not used."""

    detections: Detections
    motion: Motion | None

    @property
    def frame(self) -> Frame:
        """The frame that the image belongs to."""
        return self.detections.frame
