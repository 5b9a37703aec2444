"""Length of a step: what the log says of it, and what points say that were seen in the step before, too.

Points give the ratio of two lengths. Images a stated spacing apart are taken as exactly that, as in the report, until
points show for several steps that the spacing changes. An example is a camera that is released by time, on a vehicle
that brakes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, isfinite, log, nan, pi, prod, sqrt

from wayside.schemas.settings import MotionSettings
from wayside.stages.odometry.motion_prior import DOUBT_SIGMAS, SPACING_SCATTER, MotionPrior

COMMON_SIGMA = 0.004
"""Smallest relative error of the length by common points."""
SPACING_TOLERANCE = 0.15
"""Relative deviation of a length from a multiple of the spacing."""
MOST_TRIGGERS = 5
"""Triggers in one step at most, its own included."""
MOST_DROPPED = 2
"""Steps in a row that may have lost triggers."""
MOST_DOUBTS = 2
"""Steps in a row for which common points overrule fixes."""


@dataclass(frozen=True, slots=True)
class SpacingCheck:
    """Whether steps of a stated spacing are all of that length, by points.

    `spacing_m` as stated. `length_m` with its sigma_m: of the step by points, each from the one before, about the
    spacing. `change`: logarithm of the length by points over the spacing, where the step before was held at its own, 0
    where there are too few points. `scatter`: of changes about those before them, the mean of `counted` ones.
    `evidence`: for lengths that change steadily. `varies`: the spacing does, from here on.
    """

    spacing_m: float
    length_m: float
    sigma_m: float
    change: float = 0.0
    scatter: float = 0.0
    counted: int = 0
    evidence: float = 0.0
    varies: bool = False


@dataclass(frozen=True, slots=True)
class StepLength:
    """Length of a step and what the next one needs of it.

    `length_m` with its sigma_m, as used. `dropped`, `doubts`: steps in a row up to this one that lost triggers, and in
    which points contradict what was expected. `check`: of a stated spacing.
    """

    length_m: float = nan
    sigma_m: float = 0.0
    dropped: int = 0
    doubts: int = 0
    check: SpacingCheck | None = None

    @property
    def length_in_spacings(self) -> float:
        """Length in stated spacings where points have shown that these vary, else nan."""
        if self.check is None or not self.check.varies:
            return nan
        return self.check.length_m / self.check.spacing_m


def step_length(
    last: StepLength,
    by_points: tuple[float, float],
    expected: MotionPrior,
    settings: MotionSettings,
) -> StepLength:
    """Length of a step from points common with the step before and from the prior.

    None of the points was found by its depth. A stated spacing is held, or a multiple of it where the points say that
    triggers were dropped, as long as it does not vary. Distances between poses or fixes are noisy, so they are averaged
    with the length by points. Where both differ by many sigmas, a fix has jumped, which takes two steps (out and back),
    or the vehicle brakes; if it lasts, the points are wrong.

    Parameters
    ----------
    last
        Length of the step before.
    by_points
        Length by points and its scatter, metres; nan where there are too few.
    expected
        The prior.
    settings
        Scatter of a stated spacing.
    """
    given, sigma = expected.prior.length_m, expected.prior.sigma_m
    if isfinite(expected.spacing_m):
        return _of_spacing(last, by_points, expected.spacing_m, settings)
    carried, scatter = by_points
    if not isfinite(carried):
        return StepLength(given, sigma, last.dropped, last.doubts)
    carried_sigma = hypot(last.sigma_m, max(scatter, COMMON_SIGMA * carried))
    if abs(carried - given) > DOUBT_SIGMAS * hypot(sigma, carried_sigma):
        doubts = last.doubts + 1
        jumps = expected.source == "fixes" and doubts <= MOST_DOUBTS
        jumps |= expected.source == "speed"
        length, sigma = (carried, carried_sigma) if jumps else (given, sigma)
        return StepLength(length, sigma, last.dropped, doubts)
    weight = sigma**2 / (sigma**2 + carried_sigma**2)
    length = given + weight * (carried - given)
    return StepLength(length, sigma * sqrt(1 - weight), last.dropped)


def _of_spacing(
    last: StepLength, by_points: tuple[float, float], spacing_m: float, settings: MotionSettings
) -> StepLength:
    """Length of a step whose spacing is stated."""
    check = _checked(last, by_points, spacing_m, settings)
    if check.varies:
        return StepLength(check.length_m, check.sigma_m, check=check)
    if not isfinite(by_points[0]):
        return StepLength(spacing_m, settings.spacing_sigma_m, last.dropped, check=check)
    steps = round(by_points[0] / spacing_m)
    near = abs(by_points[0] / spacing_m - steps) < SPACING_TOLERANCE * steps
    dropped = last.dropped + 1 if near and 1 < steps <= MOST_TRIGGERS else 0
    # Triggers are not dropped in many steps in a row: then the points have a wrong scale.
    length = steps * spacing_m if 0 < dropped <= MOST_DROPPED else spacing_m
    return StepLength(length, settings.spacing_sigma_m, dropped, check=check)


def _checked(
    last: StepLength, by_points: tuple[float, float], spacing_m: float, settings: MotionSettings
) -> SpacingCheck:
    """The length by points alone, and whether it has changed for so long that the spacing varies.

    Errors of points, of triggers and of single steps come and go: the changes of neighbouring steps do not agree. Where
    a vehicle brakes they do, and differ by little. The sum of their products in squared sigmas, less 1 for each step
    and never below 0, is a CUSUM test (Page 1954): it decides where `MOST_DOUBTS` products of `DOUBT_SIGMAS` each
    would.
    """
    before = last.check
    if before is None:
        return SpacingCheck(spacing_m, spacing_m, settings.spacing_sigma_m)
    broad, carried = SPACING_SCATTER * spacing_m, by_points[0]
    if not carried > 0:
        length = before.length_m / before.spacing_m * spacing_m
        return replace(before, spacing_m=spacing_m, length_m=length, sigma_m=broad, change=0.0)
    relative = max(by_points[1] / carried, COMMON_SIGMA)
    length = before.length_m * carried / last.length_m
    variance = (length * hypot(before.sigma_m / before.length_m, relative)) ** 2
    weight = broad**2 / (broad**2 + variance)
    change = log(carried / spacing_m)
    # of a normal distribution: two values differ by 2 / sqrt(pi) sigmas on average
    apart = sqrt(pi) / 2 * abs(change - before.change)
    counted = before.counted + 1
    scatter = before.scatter + (apart - before.scatter) / counted
    limit = DOUBT_SIGMAS * max(relative, scatter)
    both = (min(max(one, -limit), limit) * DOUBT_SIGMAS / limit for one in (change, before.change))
    evidence = max(0.0, before.evidence + prod(both) - 1)
    return SpacingCheck(
        spacing_m,
        spacing_m + weight * (length - spacing_m),
        sqrt(weight * variance),
        change,
        scatter,
        counted,
        evidence,
        before.varies or evidence > MOST_DOUBTS * DOUBT_SIGMAS**2,
    )
