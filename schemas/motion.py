"""How the camera moved, and what was followed and measured while it did."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Frame, Pose
from wayside.schemas.regions import Candidates, Look


@dataclass(frozen=True, slots=True)
class Ties:
    """Tie points between the previous and the current frame: ideal (undistorted) pixels, shape (n, 2) each.

    inlier (n,) bool: agrees with the adjusted motion. point (n, 3) float64: in the current camera frame, metres,
    nan where it cannot be triangulated. rows (n, 2) int64: corners of both frames that the tie stems from (-1: none),
    by which ties of several steps are one track; warp (n, 3): how the surroundings of `previous` lie in the current
    frame (stretch along u, shear of u by v, stretch along v); sigma_px (n,): how far the patch may slide along its
    edges. All None where they were not kept.
    """

    previous: NDArray[np.float64]
    current: NDArray[np.float64]
    inlier: NDArray[np.bool_]
    point: NDArray[np.float64]
    rows: NDArray[np.int64] | None = None
    warp: NDArray[np.float64] | None = None
    sigma_px: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True)
class StepPrior:
    """What was known of a step before looking.

    rotation (3, 3), sigma_rotation in radians (inf: unknown); direction of travel (3,), sigma_direction (2,) as slopes
    sideways and up, in the axes half way through the turn where `halfway`, else in the previous camera's; length_m of
    the step and its sigma_m.
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
    camera in the drive's own frame (origin at the first used camera, its axes), steps chained; covariance (6, 6)
    of the step (rotation vector, rad, then translation, m) or None; source: "start", "straight", "odometry",
    "poses" or "fixes" (the prior); residuals (eq. 7.5 as RMS per coordinate, px) of straight-line and adjusted motion.
    expected: the step by the prior alone, that the adjustment began from (None where there was no adjustment);
    history_px: RMS of eq. 7.5 per coordinate over all ties at the start of the adjustment and after each iteration.
    length_ratio: length of the step over that of the step before by points common to both alone, and its scatter;
    prior: what was known of the step before looking (None: nothing).
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


@dataclass(frozen=True, slots=True)
class Moved:
    """A look with the camera's motion; `motion` is None where the frame is not used."""

    look: Look
    motion: Motion | None


@dataclass(frozen=True, slots=True)
class View:
    """One frame's measurement of a place: candidate `row` of frame `frame`, ideal pixels."""

    frame: int
    row: int
    u_px: float
    v_px: float
    box: tuple[float, float, float, float]
    residual_px: float


@dataclass(frozen=True, slots=True)
class Place:
    """A thing seen in several frames, in three dimensions, with the verdict on it.

    position (3,), covariance (3, 3): metres in the camera frame of `best_frame` (right, down, ahead);
    normal (3,): of the face there, pointing to the camera; offset (3,): right of the path, above the camera's path,
    along it, all at the sign (metres); score: log odds that it is a sign; evidence: what the judge of places saw, in
    the order of its model's features.
    """

    track_id: int
    views: tuple[View, ...]
    position: NDArray[np.float64]
    covariance: NDArray[np.float64]
    offset: NDArray[np.float64]
    station_m: float
    best_frame: int
    best_time_ns: int
    best_box: tuple[float, float, float, float]
    best_pose: Pose
    width_m: float
    height_m: float
    sigma_width_m: float
    sigma_height_m: float
    facing_deg: float
    sigma_facing_deg: float
    color: str | None
    color_distance: float
    shape: str | None
    shape_distance: float
    score: float
    residual_px: float
    verdict: str
    back: bool = False
    assembly: int = -1
    evidence: tuple[float, ...] = field(default=(), repr=False)


@dataclass(frozen=True, slots=True)
class Settled:
    """A frame whose candidates are all decided: the end of the flow, ready for the tables.

    track_id (n,) int32 (-1: none), residual_px (n,) float32 per candidate row; places: those that ended here, each
    given once.
    Pixels are gone by now; `frame.data` keeps the bytes as recorded.
    """

    frame: Frame
    motion: Motion | None
    candidates: Candidates
    track_id: NDArray[np.int32]
    residual_px: NDArray[np.float32]
    region_count: int
    rows: tuple[int, int]
    places: tuple[Place, ...] = field(default=())
    left_out: int = 0
