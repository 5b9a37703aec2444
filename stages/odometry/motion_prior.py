"""What is expected of the step to the next image: by poses, odometry, spacing, fixes, or the step before."""

from collections import deque
from dataclasses import dataclass, field, replace
from math import cos, inf, isfinite, nan, radians, sqrt

import numpy as np

from wayside.schemas.errors import InputError
from wayside.schemas.frame import (
    EARTH_RADIUS_M,
    USUAL_SIGMA_M,
    USUAL_SIGMA_RAD,
    Fix,
    Frame,
    Pose,
    PosePrior,
)
from wayside.schemas.motion import StepPrior
from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import halfway_direction, turn_deg, vector_from_rotation
from wayside.stages.kernels import Array
from wayside.stages.odometry.pair_adjustment import PairAdjustment

_LEAST_COSINE = 1e-6
"""Of the angle between the direction of travel that poses give and the optical axis."""
SPACING_SCATTER = 0.3
"""Relative scatter of the distance between images about the stated one, where points show that it varies: as of lengths
taken from fixes."""
FIX_SIGMA_M = 1.5
"""Standard deviation of a fix where the log states none, m."""
FIX_STEP_FRACTION = 0.2
"""Error of the distance between two fixes, as a fraction of a fix's: most of it is common to both."""
POSE_SLACK_PX, ROTATION_SLACK_PX, FIRST_SLACK_PX = 12.0, 45.0, 120.0
"""Half width of the search band, px: with poses, with the rotation of the step before, with neither."""
SHORTEST_M = 0.02
"""Shortest step, m."""
FASTEST_MPS, JUMP_SIGMAS = 150.0, 3.0
"""Fixes have jumped that imply a higher speed, m/s, by more than so many standard deviations of their distance: of
normal errors one in 700 lies beyond."""
ACCELERATION_MPS2 = 2.0
"""Scatter of the vehicle's acceleration where only the last speed tells the length of a step, m/s^2: hard but usual
braking is 3 to 4."""
DOUBT_SIGMAS = 3.0
"""Difference of two lengths of a step, and length of a step back, that is more than chance, in standard deviations."""

PRIOR_STEPS, MEMORY = 3, 60
"""Steps that the usual noise counts for, and steps that are remembered: a receiver loses and finds its signal."""
MEDIANS = np.array([1.386, 2.366])
"""Of chi squared with two and with three degrees of freedom: direction across the travel, rotation."""


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """What is expected of a step before its images are compared.

    `prior`: of rotation, direction and length. `straight`: rotation and direction to fall back on. `search`: rotation
    (3, 3) by which corners are predicted. `slack_px`: half width of the band they are matched in. `source`: "straight",
    "points", "odometry", "poses", "fixes" or "speed". `spacing_m`: the stated one of the first two, else nan.
    """

    prior: StepPrior
    straight: tuple[Array, Array]
    search: Array
    slack_px: float
    source: str
    spacing_m: float = nan


@dataclass(frozen=True, slots=True)
class TravelDirection:
    """Direction of travel (3,) of a camera fixed to a vehicle, in the axes half way through a step; sigma (2,), rad."""

    direction: Array
    sigma: Array


def predict_motion(
    before: Frame,
    now: Frame,
    travel: TravelDirection,
    last_rotation: Array | None,
    speed_mps: float,
    settings: MotionSettings,
    length_in_spacings: float = nan,
) -> MotionPrior:
    """Expected step between two frames by the best source: poses, then spacing, then fixes, then the last speed.

    Poses that stand still give way to a known spacing. Where a straight line may stand for a step (`residual_px`), as
    in the report, their distance is the spacing. Where points have shown that the spacing varies, the step is as long
    in spacings as the one before.

    `last_rotation` (3, 3), `speed_mps`: of the step before. None and nan: unknown.
    `length_in_spacings`: its length in stated spacings where these vary, else nan.

    Raises InputError where no source gives the distance.
    """
    spacing_m = nan if now.spacing_m is None else max(now.spacing_m, SHORTEST_M)
    if before.pose is not None and now.pose is not None:
        step = now.pose.pose.relative_to(before.pose.pose)
        length = float(np.linalg.norm(step.centre))
        if length > SHORTEST_M or now.spacing_m is None:
            if settings.residual_px == 0:
                return _by_poses(before.pose, now.pose, step, travel)
            spacing_m = max(length, SHORTEST_M)
    seconds = (now.time_ns - before.time_ns) * 1e-9
    if isfinite(spacing_m) and isfinite(length_in_spacings):
        baseline, sigma = length_in_spacings * spacing_m, SPACING_SCATTER * spacing_m
        source = "points"
    elif isfinite(spacing_m):
        baseline, sigma, source = spacing_m, settings.spacing_sigma_m, "straight"
    elif before.fix is not None and now.fix is not None:
        baseline, sigma = _between_fixes(before.fix, now.fix, seconds)
        source = "fixes"
    elif speed_mps > 0:
        # Beyond the last fix or in a gap of them: points seen in both steps measure the length.
        baseline, sigma = speed_mps * seconds, ACCELERATION_MPS2 * seconds**2
        source = "speed"
    else:
        raise InputError(
            f"frame {now.index}: no pose, spacing or fix gives the distance from the image before it. "
            "Give the distance between images (--spacing 26.4ft)."
        )
    length_m = max(baseline, SHORTEST_M)
    prior = StepPrior(np.eye(3), inf, travel.direction, travel.sigma, True, length_m, sigma)
    straight, search, slack_px = (np.eye(3), travel.direction), last_rotation, ROTATION_SLACK_PX
    if search is None:
        search, slack_px = np.eye(3), FIRST_SLACK_PX
    return MotionPrior(prior, straight, search, slack_px, source, spacing_m)


def _by_poses(
    first: PosePrior, second: PosePrior, step: Pose, travel: TravelDirection
) -> MotionPrior:
    pairs = zip(first.sigmas(), second.sigmas(), strict=True)
    sigma_m, sigma_rad = (sqrt(2.0) * max(pair) for pair in pairs)
    length = float(np.linalg.norm(step.centre))
    baseline = max(length, SHORTEST_M)
    # Poses of a vehicle that stands tell no direction.
    direction = step.centre / length if length > SHORTEST_M else travel.direction
    # The direction between two noisy positions is no more accurate than the mount's: weighted mean of both.
    given, mounted = (sigma_m / baseline) ** -2, travel.sigma**-2
    expected = halfway_direction(np.ascontiguousarray(step.rotation), travel.direction)
    slopes = expected[:2] / expected[2]
    backward = step.centre[2] < -DOUBT_SIGMAS * sigma_m
    if backward or direction[2] > _LEAST_COSINE:
        slopes = (given * direction[:2] / direction[2] + mounted * slopes) / (given + mounted)
    else:
        given = 0.0  # no camera of a vehicle looks across its way: such poses are not of this one
    both = np.array([slopes[0], slopes[1], 1.0]) * (-1.0 if backward else 1.0)
    both, scatter = both / np.linalg.norm(both), (given + mounted) ** -0.5
    prior = StepPrior(step.rotation, sigma_rad, both, scatter, False, baseline, sigma_m)
    motion = step.rotation, direction
    return MotionPrior(prior, motion, step.rotation, POSE_SLACK_PX, second.source)


def fix_distance_m(first: Fix, second: Fix) -> float:
    """Distance between two fixes a few metres apart, on a sphere."""
    north = radians(second.latitude_deg - first.latitude_deg) * EARTH_RADIUS_M
    east = radians(turn_deg(first.longitude_deg, second.longitude_deg)) * EARTH_RADIUS_M
    east *= cos(radians(first.latitude_deg))
    up = second.altitude_m - first.altitude_m
    return float(np.sqrt(north * north + east * east + up * up))


def _between_fixes(first: Fix, second: Fix, seconds: float) -> tuple[float, float]:
    """Distance and its sigma, metres; where fixes jump, both are half of the farthest that a vehicle can go."""
    known = [max(f.sigma_m[:2]) for f in (first, second) if f.sigma_m is not None]
    sigma = FIX_STEP_FRACTION * max(known, default=FIX_SIGMA_M)
    baseline = fix_distance_m(first, second)
    reach = FASTEST_MPS * seconds
    if 0 < reach < baseline - JUMP_SIGMAS * sigma:
        return reach / 2, reach / 2
    return baseline, sigma


@dataclass(slots=True)
class PoseNoise:
    """Variance (2,) of the positions, m^2, and rotations, rad^2, of poses whose log states none.

    A pose is compared with the adjusted step, which rests on it in part. The mean square of its error is the square of
    the difference plus the variance of the adjusted step: the expectation step of Dempster, Laird and Rubin (1977).
    Medians over the last steps keep single wrong poses and steps from counting. Only directions show the error of
    positions, so it includes what the rotation of the earlier pose adds to them.
    """

    variance: Array = field(default_factory=lambda: np.array([USUAL_SIGMA_M, USUAL_SIGMA_RAD]) ** 2)
    squares: deque[Array] = field(init=False)

    def __post_init__(self) -> None:
        self.squares = deque([self.variance] * PRIOR_STEPS, maxlen=MEMORY)

    def of(self, frame: Frame) -> Frame:
        """The frame with the noise learnt so far in its pose, where it has one."""
        if frame.pose is None:
            return frame
        sigma_m, sigma_rad = frame.pose.sigmas(*np.sqrt(self.variance).tolist())
        return replace(frame, pose=replace(frame.pose, sigma_m=sigma_m, sigma_rad=sigma_rad))

    def learn(self, expected: MotionPrior, adjusted: PairAdjustment) -> None:
        """Take in a step that was expected by poses and adjusted to its images."""
        if expected.prior.halfway:  # no poses, or only their distance
            return
        rotation, direction = expected.straight
        turned = vector_from_rotation(adjusted.rotation @ rotation.T)
        aside = np.cross(adjusted.direction, direction)
        square = np.array([aside @ aside, turned @ turned]) / MEDIANS
        variance = np.diag(adjusted.covariance)
        square += variance[3:].sum() / 2, variance[:3].sum() / 3
        square[0] *= expected.prior.length_m**2
        self.squares.append(square / 2)  # two poses of the same noise
        self.variance = np.median(np.array(self.squares), axis=0)
