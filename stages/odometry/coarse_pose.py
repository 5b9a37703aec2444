"""Coarse relative pose from matched corners, to about a pixel: it guides the search for ties."""

from __future__ import annotations

from math import radians

import numpy as np

from wayside.schemas.settings import TieSettings
from wayside.stages.geometry import rays_of_ideal, rotation_from_vector, vector_from_rotation
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import (
    EpipolarFit,
    RelativePosePrior,
    fit_epipolar,
    sampson_px,
)
from wayside.stages.odometry.tie_points import KeypointImage, match_corners


def find_coarse_motion(
    before: KeypointImage,
    now: KeypointImage,
    prior: RelativePosePrior,
    predicted: Array,
    slack_px: float,
    settings: TieSettings,
) -> tuple[EpipolarFit | None, int]:
    """Rotation and direction from matched corners, and the number of inliers; None with too few matches.

    Parameters
    ----------
    before, now
        The images.
    prior
        What is known of the relative pose.
    predicted
        Rotation (3, 3) by which corners are predicted.
    slack_px
        Half width of the search band round the prediction.
    settings
        Matching and fits.
    """
    previous, current = _matched_rays(before, now, prior, predicted, slack_px, settings)
    if len(previous) < settings.fewest_coarse:
        return None, 0
    return fit_coarse_motion(previous, current, prior, predicted, now.focal_px, settings)


def fit_coarse_motion(
    previous: Array,
    current: Array,
    prior: RelativePosePrior,
    predicted: Array,
    focal_px: float,
    settings: TieSettings,
) -> tuple[EpipolarFit, int]:
    """Rotation and direction from matched rays (n, 2), to about a pixel, and the number of inliers."""
    best = _released(previous, current, predicted, prior, focal_px, settings)
    inliers = _inliers(previous, current, best, focal_px, settings)
    if inliers < settings.coarse_inlier_ratio * len(previous):
        for yaw_deg in (-settings.other_yaw_deg, settings.other_yaw_deg):
            rotation = rotation_from_vector(np.array([0.0, radians(yaw_deg), 0.0]))
            fit = _released(previous, current, rotation @ predicted, prior, focal_px, settings)
            best = fit if fit.cost < best.cost else best
        inliers = _inliers(previous, current, best, focal_px, settings)
    return best, inliers


def near_coarse_motions(
    before: KeypointImage,
    now: KeypointImage,
    prior: RelativePosePrior,
    predicted: Array,
    slack_px: float,
    settings: TieSettings,
) -> list[EpipolarFit]:
    """Motions of lowest cost near the prediction; parameters as of `find_coarse_motion`."""
    matched = _matched_rays(before, now, prior, predicted, slack_px, settings)
    return fit_near_motions(*matched, prior, predicted, now.focal_px, settings)


def fit_near_motions(
    previous: Array,
    current: Array,
    prior: RelativePosePrior,
    predicted: Array,
    focal_px: float,
    settings: TieSettings,
) -> list[EpipolarFit]:
    """The distinct local minima of lowest cost for matched rays (n, 2), with the direction of travel held.

    A vehicle ahead at our own speed fits a motion without rotation, like far points on a straight road: on a curve in
    haze that can be the global minimum, with the true rotation another minimum near the prediction.
    """
    limit, step = settings.near_yaw_limit_deg, settings.near_yaw_step_deg
    yaws = np.arange(-limit, limit + step / 4, step)
    scales = settings.near_first_scale_px, settings.coarse_last_scale_px
    fits = []
    for yaw_deg in yaws:
        rotation = rotation_from_vector(np.array([0.0, radians(yaw_deg), 0.0])) @ predicted
        fits.append(_held(previous, current, rotation, prior, focal_px, scales, settings))
    distinct: list[EpipolarFit] = []
    for fit in sorted(fits, key=lambda fit: fit.cost):
        apart = [_angle_between(fit.rotation, known.rotation) for known in distinct]
        if min(apart, default=np.inf) > radians(settings.same_rotation_deg):
            distinct.append(fit)
    return distinct[: settings.most_near]


def _matched_rays(
    before: KeypointImage,
    now: KeypointImage,
    prior: RelativePosePrior,
    predicted: Array,
    slack_px: float,
    settings: TieSettings,
) -> tuple[Array, Array]:
    pairs = match_corners(
        before,
        now,
        (predicted, prior.direction),
        slack_px,
        (settings.coarse_bits, settings.coarse_ratio),
        settings,
    )
    previous = rays_of_ideal(before.camera, before.ideal[pairs[:, 0]])
    return previous, rays_of_ideal(now.camera, now.ideal[pairs[:, 1]])


def _angle_between(one: Array, other: Array) -> float:
    return float(np.linalg.norm(vector_from_rotation(np.ascontiguousarray(one.T @ other))))


def _inliers(
    previous: Array, current: Array, fit: EpipolarFit, focal_px: float, settings: TieSettings
) -> int:
    distances = sampson_px(previous, current, fit.rotation, fit.direction, focal_px)
    return int((np.abs(distances) < settings.coarse_inlier_px).sum())


def _released(
    previous: Array,
    current: Array,
    rotation: Array,
    prior: RelativePosePrior,
    focal_px: float,
    settings: TieSettings,
) -> EpipolarFit:
    # In forward motion, direction and yaw have similar effects: the direction is held first.
    scales = (
        settings.coarse_first_scale_px,
        settings.coarse_second_scale_px,
        settings.coarse_last_scale_px,
    )
    fit = _held(previous, current, rotation, prior, focal_px, scales, settings)
    return fit_epipolar(
        previous,
        current,
        (fit.rotation, fit.direction),
        prior,
        focal_px=focal_px,
        sigma_px=settings.coarse_sigma_px,
        scale_px=settings.coarse_last_scale_px,
    )


def with_held_direction(prior: RelativePosePrior, settings: TieSettings) -> RelativePosePrior:
    """The prior with a standard deviation of the direction that holds it."""
    sigma = np.minimum(prior.sigma_direction, radians(settings.held_direction_deg))
    return prior._replace(sigma_direction=sigma)


def _held(
    previous: Array,
    current: Array,
    rotation: Array,
    prior: RelativePosePrior,
    focal_px: float,
    scales_px: tuple[float, ...],
    settings: TieSettings,
) -> EpipolarFit:
    """Fits with the direction of travel held, one after the other with decreasing scales."""
    held = with_held_direction(prior, settings)
    start = (rotation, prior.direction)
    for scale in scales_px:
        fit = fit_epipolar(
            previous,
            current,
            start,
            held,
            focal_px=focal_px,
            sigma_px=settings.coarse_sigma_px,
            scale_px=scale,
        )
        start = (fit.rotation, fit.direction)
    return fit
