"""Coarse relative pose from matched corners, to about a pixel: it guides the search for ties."""

from __future__ import annotations

from math import radians

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.schemas.settings import TieSettings
from wayside.stages.geometry import Schedule, rays_of_ideal
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
    # In forward motion, direction and yaw have similar effects: the direction is held first.
    s = settings
    sigma = np.minimum(prior.sigma_direction, radians(s.held_direction_deg))
    scales = (s.coarse_first_scale_px, s.coarse_second_scale_px, s.coarse_last_scale_px)
    fit: tuple[Array, Array] = predicted, prior.direction
    for known, scales_px in ((prior._replace(sigma_direction=sigma), scales), (prior, scales[-1:])):
        fit = fit_epipolar(
            previous,
            current,
            fit,
            known,
            focal_px=focal_px,
            sigma_px=s.coarse_sigma_px,
            scales_px=scales_px,
            schedule=Schedule(s.fit_iterations, s.fit_gain),
        )
    distances = sampson_px(previous, current, *fit, focal_px)
    return EpipolarFit(*fit), int((np.abs(distances) < s.coarse_inlier_px).sum())
