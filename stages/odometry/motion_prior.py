"""What to expect of the step to the next picture: a straight line, odometry, poses or fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, isfinite, nan, radians, sqrt

import numpy as np

from wayside.schemas.errors import InputError
from wayside.schemas.frame import Fix, Frame, Pose, PosePrior
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import RelativePosePrior, halfway_direction

POSE_SIGMA_M, POSE_SIGMA_RAD = 0.03, radians(0.1)
"""Of one pose, where the log does not say."""
FIX_SIGMA_M, FIX_STEP_SHARE = 1.5, 0.2
"""Of one fix, where the log does not say; and the noise of the way between two as a share of it: the error varies
slowly, so most of it is common to both."""
EARTH_M = 6_371_000.0
POSE_SLACK_PX, TURN_SLACK_PX, FIRST_SLACK_PX = 12.0, 45.0, 120.0
"""How far from the prediction corners are looked for: with a pose; with the turn of the step before; with nothing."""
SHORTEST_M, FASTEST_MPS = 0.02, 150.0
"""A step is no shorter, and nothing on a road that fast: fixes further apart jump, and say nothing of the way."""
MOST_TRIGGERS, HARDEST_MPS2 = 5, 12.0
"""Triggers that one step may have lost, with its own; more than tyres hold."""
FEWEST_SPEEDS, MOST_SPEEDS, ALIKE_SPEED = 3, 5, 0.25
"""Steps that say the usual speed, at least and at most, and how far off it a step may be."""


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """A step before looking.

    prior: of rotation and direction; baseline_m with sigma_m; straight: rotation and direction to fall back on;
    search: rotation (3, 3) round which corners are matched, slack_px far; source: "straight", "odometry", "poses"
    or "fixes"; triggers: so many spacings make the baseline, by the times of the pictures.
    """

    prior: RelativePosePrior
    baseline_m: float
    sigma_m: float
    straight: tuple[Array, Array]
    search: Array
    slack_px: float
    source: str
    triggers: int = 1


@dataclass(frozen=True, slots=True)
class TravelDirection:
    """Direction of travel (3,) of a camera fixed to a vehicle, half way through each turn; sigma (2,) in radians."""

    direction: Array
    sigma: Array


def predict_motion(
    before: Frame,
    now: Frame,
    law: TravelDirection,
    last_turn: Array | None,
    *,
    spacing_sigma_m: float,
    speeds: Sequence[float] = (),
) -> MotionPrior:
    """The step between two frames by the best source there is: poses, then spacing, then fixes.

    last_turn (3, 3): rotation of the step before, None where it is not known; speeds: those of the last few steps as
    `trigger_speed` gives them, the newest last.

    Raises
    ------
    InputError
        Where none of them gives the distance.
    """
    if before.pose is not None and now.pose is not None:
        step = now.pose.pose.relative_to(before.pose.pose)
        if float(np.linalg.norm(step.centre)) > SHORTEST_M:
            return _by_poses(before.pose, now.pose, step, law)
    triggers = 1
    if now.spacing_m is not None:
        triggers = triggers_between(trigger_speed(before, now), now.spacing_m, speeds)
        baseline, sigma, source = triggers * now.spacing_m, spacing_sigma_m, "straight"
    elif before.fix is not None and now.fix is not None:
        baseline, sigma = _between_fixes(before.fix, now.fix, (now.time_ns - before.time_ns) * 1e-9)
        source = "fixes"
    else:
        raise InputError(
            f"frame {now.index}: wanted the distance from the picture before it, found no pose, spacing or fix; "
            "give the distance between pictures (--spacing 26.4ft)"
        )
    prior = RelativePosePrior(np.eye(3), inf, law.direction, law.sigma, True)
    return MotionPrior(
        prior,
        max(baseline, SHORTEST_M),
        sigma,
        (np.eye(3), law.direction),
        np.eye(3) if last_turn is None else np.linalg.matrix_power(last_turn, triggers),
        FIRST_SLACK_PX if last_turn is None else TURN_SLACK_PX,
        source,
        triggers,
    )


def trigger_speed(before: Frame, now: Frame) -> float:
    """Speed between two pictures if no trigger was lost, metres a second; nan where the log does not say when or where.

    Of times that the camera gave: those of the log follow what writes it.
    """
    if before.header_time_ns is None or now.header_time_ns is None or now.spacing_m is None:
        return nan
    seconds = (now.header_time_ns - before.header_time_ns) * 1e-9
    return now.spacing_m / seconds if seconds > 0 else nan


def triggers_between(speed: float, spacing_m: float, speeds: Sequence[float]) -> int:
    """How many spacings apart two pictures are, by their speed if it were one, and those of the steps before.

    A camera that is triggered by the way of its vehicle takes a picture every spacing. Where one is lost, the next
    comes so late that the vehicle would have had to brake harder than tyres hold: then as many were lost as keep its
    usual speed. Nothing is known of the first few steps, or where the vehicle is slow enough to brake.
    """
    known = [one for one in speeds if isfinite(one)]
    if len(known) < FEWEST_SPEEDS or not isfinite(speed):
        return 1
    usual, last = float(np.median(known)), known[-1]
    hardest = HARDEST_MPS2 * 0.5 * (spacing_m / speed + spacing_m / last)
    triggers = min(max(round(usual / speed), 1), MOST_TRIGGERS)
    return (
        triggers
        if last - speed > hardest and abs(triggers * speed / usual - 1) < ALIKE_SPEED
        else 1
    )


def _by_poses(first: PosePrior, second: PosePrior, step: Pose, law: TravelDirection) -> MotionPrior:
    sigma_m = sqrt(2.0) * max(_or(first.sigma_m, POSE_SIGMA_M), _or(second.sigma_m, POSE_SIGMA_M))
    sigma_rad = sqrt(2.0) * max(
        _or(first.sigma_rad, POSE_SIGMA_RAD), _or(second.sigma_rad, POSE_SIGMA_RAD)
    )
    baseline = float(np.linalg.norm(step.centre))
    direction = step.centre / baseline
    # The direction between two noisy positions is no better than the mount's: take both by their weights.
    given, habit = (sigma_m / baseline) ** -2, law.sigma**-2
    expected = halfway_direction(np.ascontiguousarray(step.rotation), law.direction)
    slopes = (given * direction[:2] / direction[2] + habit * expected[:2] / expected[2]) / (
        given + habit
    )
    both = np.array([slopes[0], slopes[1], 1.0])
    prior = RelativePosePrior(
        step.rotation, sigma_rad, both / np.linalg.norm(both), (given + habit) ** -0.5, False
    )
    return MotionPrior(
        prior,
        baseline,
        sigma_m,
        (step.rotation, direction),
        step.rotation,
        POSE_SLACK_PX,
        second.source,
    )


def fix_distance_m(first: Fix, second: Fix) -> float:
    """Distance between two fixes a few metres apart, on a sphere."""
    north = radians(second.latitude_deg - first.latitude_deg) * EARTH_M
    east = radians(second.longitude_deg - first.longitude_deg) * EARTH_M
    east *= cos(radians(first.latitude_deg))
    up = second.altitude_m - first.altitude_m
    return float(np.sqrt(north * north + east * east + up * up))


def _between_fixes(first: Fix, second: Fix, gap_s: float) -> tuple[float, float]:
    """Distance and its sigma, metres; where fixes jump, half of what a vehicle can go, give or take as much."""
    baseline, sigma = fix_distance_m(first, second), _fix_sigma_m(first, second)
    reach = FASTEST_MPS * gap_s
    if 0 < reach < baseline - 3 * sigma:
        return reach / 2, reach / 2
    return baseline, sigma


def _fix_sigma_m(first: Fix, second: Fix) -> float:
    known = [max(f.sigma_m[:2]) for f in (first, second) if f.sigma_m is not None]
    return FIX_STEP_SHARE * max(known, default=FIX_SIGMA_M)


def _or(value: float | None, default: float) -> float:
    return default if value is None or not value > 0 else value
