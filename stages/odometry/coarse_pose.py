"""Coarse relative pose from matched corners, to about a pixel: it guides the search for ties."""

from __future__ import annotations

from math import radians

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.schemas.settings import TieSettings
from wayside.stages.geometry import rays_of_ideal
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import (
    EpipolarFit,
    fit_epipolar,
    sampson_px,
)
from wayside.stages.odometry.tie_points import KeypointImage, match_corners


def find_coarse_motion(
    before: KeypointImage,
    now: KeypointImage,
    prior: StepPrior,
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
    pairs = match_corners(
        before,
        now,
        (predicted, prior.direction),
        slack_px,
        (settings.coarse_bits, settings.coarse_ratio),
        settings,
    )
    if len(pairs) < settings.fewest_coarse:
        return None, 0
    previous = rays_of_ideal(before.camera, before.ideal[pairs[:, 0]])
    current = rays_of_ideal(now.camera, now.ideal[pairs[:, 1]])
    return fit_coarse_motion(previous, current, prior, predicted, now.focal_px, settings)


def fit_coarse_motion(
    previous: Array,
    current: Array,
    prior: StepPrior,
    predicted: Array,
    focal_px: float,
    settings: TieSettings,
) -> tuple[EpipolarFit, int]:
    """Rotation and direction from matched rays (n, 2), to about a pixel, and the number of inliers."""
    fit = _released(previous, current, predicted, prior, focal_px, settings)
    return fit, _inliers(previous, current, fit, focal_px, settings)


def _inliers(
    previous: Array, current: Array, fit: EpipolarFit, focal_px: float, settings: TieSettings
) -> int:
    distances = sampson_px(previous, current, fit.rotation, fit.direction, focal_px)
    return int((np.abs(distances) < settings.coarse_inlier_px).sum())


def _released(
    previous: Array,
    current: Array,
    rotation: Array,
    prior: StepPrior,
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


def _held(
    previous: Array,
    current: Array,
    rotation: Array,
    prior: StepPrior,
    focal_px: float,
    scales_px: tuple[float, ...],
    settings: TieSettings,
) -> EpipolarFit:
    """Fits with the direction of travel held, one after the other with decreasing scales."""
    sigma = np.minimum(prior.sigma_direction, radians(settings.held_direction_deg))
    held = prior._replace(sigma_direction=sigma)
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
