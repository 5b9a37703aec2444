"""Length of a step: what the log says of it, and what points say that were seen in the step before, too.

Points give the ratio of two lengths: by them alone the logarithm of the length is a Gaussian random walk. Triggers are
dropped, and vehicles brake: where that walk leaves a stated spacing by more than chance, the length follows it. What
poses, fixes and the last speed say is averaged with it, or one of both is left out.
"""

from dataclasses import dataclass
from math import exp, hypot, inf, isfinite, log, nan, sqrt

from wayside.schemas.settings import MotionSettings
from wayside.stages.odometry.motion_prior import DOUBT_SIGMAS, SPACING_SCATTER, MotionPrior

COMMON_SIGMA = 0.004
"""Smallest relative error of the length by common points."""
MOST_DOUBTS = {"poses": 0, "odometry": 0, "fixes": 2}
"""Steps in a row for which points overrule a source: a fix that jumps does so out and back."""


@dataclass(frozen=True, slots=True)
class StepLength:
    """Length of a step and what the next one needs of it."""

    length_m: float = nan
    sigma_m: float = 0.0
    doubts: int = 0
    """Steps in a row up to this one in which points contradict what was expected."""
    spacing_m: float = nan
    walk: tuple[float, float] = (0.0, 0.0)
    """Logarithm of the length in stated spacings by points alone, with its sigma; the spacing is its broad prior."""
    length_in_spacings: float = nan
    """Where points contradict a stated spacing, else nan."""


def step_length(
    last: StepLength,
    by_points: tuple[float, float],
    expected: MotionPrior,
    settings: MotionSettings,
) -> StepLength:
    """Mean of the length by points and of the one that is expected; where they contradict each other, one of both.

    `by_points`: length by points common with the step before and its scatter, metres; nan where there are too few.
    """
    given, sigma = expected.prior.length_m, expected.prior.sigma_m
    spacing, (carried, scatter) = expected.spacing_m, by_points
    if not carried > 0:
        varies = isfinite(last.length_in_spacings)
        walk = (last.walk[0], SPACING_SCATTER) if varies else (0.0, sigma / given)
        return StepLength(given, sigma, last.doubts, spacing, walk, last.length_in_spacings)
    relative, walk = max(scatter / carried, COMMON_SIGMA), (0.0, 0.0)
    if isfinite(spacing):
        given, sigma = spacing, settings.spacing_sigma_m
        walk = _walked(last, log(carried / last.length_m * last.spacing_m / spacing), relative)
        if abs(walk[0]) > DOUBT_SIGMAS * hypot(sigma / spacing, walk[1]):
            share = exp(walk[0])
            length = share * spacing
            return StepLength(length, length * walk[1], last.doubts + 1, spacing, walk, share)
    known = last.sigma_m / last.length_m if isfinite(last.length_m) else 0.0
    carried_sigma = carried * hypot(known, relative)
    weight = 1 / (1 + (carried_sigma / sigma) ** 2)
    doubts = 0
    if abs(carried - given) > DOUBT_SIGMAS * hypot(sigma, carried_sigma):
        doubts = last.doubts + 1
        follows = not isfinite(spacing) and doubts <= MOST_DOUBTS.get(expected.source, inf)
        weight = 1.0 if follows else 0.0
    sigma = carried_sigma * sqrt(weight) if weight else sigma
    return StepLength(given + weight * (carried - given), sigma, doubts, spacing, walk)


def _walked(last: StepLength, change: float, relative: float) -> tuple[float, float]:
    """The random walk after a step, pulled to the stated spacing: errors of ratios add up without end."""
    place = last.walk[0] + (change if isfinite(change) else 0.0)
    variance = last.walk[1] ** 2 + relative**2
    weight = 1 / (1 + variance / SPACING_SCATTER**2)
    return weight * place, sqrt(weight * variance)
