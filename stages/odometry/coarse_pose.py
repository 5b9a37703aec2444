"""The step between two pictures to a pixel or so, from matched corners: where ties are looked for closely."""

from __future__ import annotations

from math import radians

import numpy as np

from wayside.stages.geometry import rays_of_ideal, rotation_from_vector, vector_from_rotation
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import (
    EpipolarFit,
    RelativePosePrior,
    fit_epipolar,
    sampson_px,
)
from wayside.stages.odometry.tie_points import KeypointImage, match_corners

FARTHEST_BITS, FARTHEST_RATIO = 64, 0.85
"""Descriptor distance of a match in wide bands, and its share of the next best's."""
OTHER_STARTS_DEG, CLEAR_SHARE = (-1.5, 1.5), 0.5
"""Yaws off the prediction that are tried too where fewer of the matches agree with what was found from it."""
SCALES_PX, SIGMA_PX = (20.0, 5.0, 1.5), 1.0
"""Robust scales of the fit, one after the other, and the error of a corner."""
YAWS_DEG, YAW_SCALES_PX, SAME_YAW_DEG, MOST_YAWS = np.arange(-2.4, 2.5, 0.4), (3.0, 1.5), 0.3, 3
"""Yaws round the prediction from which near solutions are sought, with their robust scales; solutions that are one, and
how many of the best are taken."""
HELD_SIGMA = radians(0.1)
"""Of the direction of travel where it is held."""


def find_coarse_motion(
    before: KeypointImage,
    now: KeypointImage,
    prior: RelativePosePrior,
    predicted: Array,
    slack_px: float,
) -> tuple[EpipolarFit | None, int]:
    """Rotation and direction from matched corners, and how many of them agree.

    Parameters
    ----------
    before, now
        The two views.
    prior
        What is known of the step.
    predicted
        Rotation (3, 3) to search around.
    slack_px
        How far off the prediction matches are looked for.
    """
    previous, current = _matched_rays(before, now, prior, predicted, slack_px)
    if len(previous) < 8:
        return None, 0
    return fit_coarse_motion(previous, current, prior, predicted, now.focal_px)


def fit_coarse_motion(
    previous: Array, current: Array, prior: RelativePosePrior, predicted: Array, focal_px: float
) -> tuple[EpipolarFit, int]:
    """Rotation and direction from matched rays (n, 2), good to a pixel or so, and how many of them agree."""
    best = _released(previous, current, predicted, prior, focal_px)
    agreeing = _agreeing(previous, current, best, focal_px)
    if agreeing < CLEAR_SHARE * len(previous):
        for yaw_deg in OTHER_STARTS_DEG:
            turn = rotation_from_vector(np.array([0.0, radians(yaw_deg), 0.0]))
            fit = _released(previous, current, turn @ predicted, prior, focal_px)
            best = fit if fit.cost < best.cost else best
        agreeing = _agreeing(previous, current, best, focal_px)
    return best, agreeing


def near_coarse_motions(
    before: KeypointImage,
    now: KeypointImage,
    prior: RelativePosePrior,
    predicted: Array,
    slack_px: float,
) -> list[EpipolarFit]:
    """The few motions that matched corners agree with best; parameters as of `find_coarse_motion`."""
    matched = _matched_rays(before, now, prior, predicted, slack_px)
    return fit_near_motions(*matched, prior, predicted, now.focal_px)


def fit_near_motions(
    previous: Array, current: Array, prior: RelativePosePrior, predicted: Array, focal_px: float
) -> list[EpipolarFit]:
    """The best few of the motions that matched rays (n, 2) agree with at all, the direction of travel held.

    A vehicle ahead that keeps our pace agrees with no turn at all, like far things on a straight road: on a curve in
    haze that may be the best fit from afar, and what the roadside says another one near by.
    """
    fits = []
    for yaw_deg in YAWS_DEG:
        turn = rotation_from_vector(np.array([0.0, radians(yaw_deg), 0.0])) @ predicted
        fits.append(_held(previous, current, turn, prior, focal_px, YAW_SCALES_PX))
    distinct: list[EpipolarFit] = []
    for fit in sorted(fits, key=lambda fit: fit.cost):
        apart = [_turn_between(fit.rotation, known.rotation) for known in distinct]
        if min(apart, default=np.inf) > radians(SAME_YAW_DEG):
            distinct.append(fit)
    return distinct[:MOST_YAWS]


def _matched_rays(
    before: KeypointImage,
    now: KeypointImage,
    prior: RelativePosePrior,
    predicted: Array,
    slack_px: float,
) -> tuple[Array, Array]:
    pairs = match_corners(
        before, now, predicted, prior.direction, slack_px, FARTHEST_BITS, FARTHEST_RATIO
    )
    previous = rays_of_ideal(before.camera, before.ideal[pairs[:, 0]])
    return previous, rays_of_ideal(now.camera, now.ideal[pairs[:, 1]])


def _turn_between(one: Array, other: Array) -> float:
    return float(np.linalg.norm(vector_from_rotation(np.ascontiguousarray(one.T @ other))))


def _agreeing(previous: Array, current: Array, fit: EpipolarFit, focal_px: float) -> int:
    gaps = sampson_px(previous, current, fit.rotation, fit.direction, focal_px)
    return int((np.abs(gaps) < 3 * SIGMA_PX).sum())


def _released(
    previous: Array, current: Array, rotation: Array, prior: RelativePosePrior, focal_px: float
) -> EpipolarFit:
    # Forward motion leaves a free direction and the yaw to imitate each other: hold the direction first.
    fit = _held(previous, current, rotation, prior, focal_px, SCALES_PX)
    return fit_epipolar(
        previous,
        current,
        (fit.rotation, fit.direction),
        prior,
        focal_px=focal_px,
        sigma_px=SIGMA_PX,
        scale_px=SCALES_PX[-1],
    )


def _held(
    previous: Array,
    current: Array,
    rotation: Array,
    prior: RelativePosePrior,
    focal_px: float,
    scales_px: tuple[float, ...],
) -> EpipolarFit:
    """The fit with the direction of travel held, ever narrower."""
    held = prior._replace(sigma_direction=np.minimum(prior.sigma_direction, HELD_SIGMA))
    start = (rotation, prior.direction)
    for scale in scales_px:
        fit = fit_epipolar(
            previous,
            current,
            start,
            held,
            focal_px=focal_px,
            sigma_px=SIGMA_PX,
            scale_px=scale,
        )
        start = (fit.rotation, fit.direction)
    return fit
