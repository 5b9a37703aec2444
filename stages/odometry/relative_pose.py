"""Relative pose of two images by tie points: coarse from matched corners, then fine from registered ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import radians

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.schemas.settings import TieSettings
from wayside.stages.adjustment import tie_scatter
from wayside.stages.geometry import (
    Schedule,
    halfway_direction,
    rays_of_ideal,
    rotation_from_vector,
)
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import EpipolarFit, fit_epipolar, sampson_px
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.tie_points import (
    GroundPlane,
    KeypointImage,
    RegisteredTies,
    match_corners,
    register_road,
    register_ties,
)


@dataclass(frozen=True, slots=True)
class RelativePose:
    """Rotation and direction as in `fit_epipolar`, the ties, their rays (n, 2), and the inliers (n,)."""

    rotation: Array
    direction: Array
    tied: RegisteredTies
    previous: Array
    current: Array
    inlier: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    @property
    def inliers(self) -> int:
        """Number of inliers."""
        return int(self.inlier.sum())

    def scatter(self, focal_px: float, settings: TieSettings) -> float:
        """Errors of the inliers over those that the settings state; see `tie_scatter`."""
        held = self.previous[self.inlier], self.current[self.inlier]
        distance = sampson_px(*held, self.rotation, self.direction, focal_px)
        return tie_scatter(distance, settings)


RelativePoseEstimator = Callable[
    [KeypointImage, KeypointImage, MotionPrior, Mount, int, TieSettings], RelativePose | None
]


def estimate_relative_pose(
    before: KeypointImage,
    now: KeypointImage,
    expected: MotionPrior,
    mount: Mount,
    fewest: int,
    settings: TieSettings,
) -> RelativePose | None:
    """Relative pose of two images: coarse motion, then ties registered by it.

    Parameters
    ----------
    before, now
        The images.
    expected
        What is expected of the step.
    mount
        Of the camera, as learnt so far.
    fewest
        Fewest inliers.
    settings
        Matching, registration and fits.

    Returns
    -------
    RelativePose
        None with fewer than `fewest` inliers.
    """
    prior, ground = expected.prior, mount.ground(expected.prior.length_m)
    coarse, inliers = find_coarse_motion(
        before, now, prior, expected.search, expected.slack_px, settings
    )
    if coarse is None or inliers < fewest:
        return None
    pose = _refine(before, now, (coarse.rotation, coarse.direction), prior, ground, settings)
    if pose.inliers < settings.inlier_ratio * len(pose.inlier):
        # With a wrong rotation the inlier ratio is low. Of all starts, that with the most inliers is kept.
        starts = _other_starts(before, now, expected, pose, settings)
        others = [_refine(before, now, start, prior, ground, settings) for start in starts]
        pose = max(pose, *others, key=lambda one: one.inliers)
    return pose if pose.inliers >= fewest else None


def _other_starts(
    before: KeypointImage,
    now: KeypointImage,
    expected: MotionPrior,
    pose: RelativePose,
    settings: TieSettings,
) -> list[tuple[Array, Array]]:
    """Rotations and directions to start from: the current pose, a fit in a wide band, yaws off the prediction."""
    prior = expected.prior
    wide, _ = find_coarse_motion(
        before, now, prior, expected.straight[0], settings.wide_slack_px, settings
    )
    starts = [(pose.rotation, pose.direction)]
    starts += [] if wide is None else [(wide.rotation, wide.direction)]
    steps = np.arange(-settings.start_yaws, settings.start_yaws + 1)
    for yaw in np.radians(np.round(settings.start_yaw_step_deg * steps, 6)):
        rotation = rotation_from_vector(np.array([0.0, yaw, 0.0])) @ expected.search
        ahead = halfway_direction(rotation, prior.direction) if prior.halfway else prior.direction
        starts.append((rotation, ahead))
    return starts


def _refine(
    before: KeypointImage,
    now: KeypointImage,
    start: tuple[Array, Array],
    prior: StepPrior,
    ground: GroundPlane | None,
    settings: TieSettings,
) -> RelativePose:
    # Ties selected by a motion are biased towards it: they are selected again while it still changes.
    tied = None
    for _ in range(settings.rounds):
        tied = register_ties(before, now, *start, settings, ground, tied)
        pose = fit_relative_pose(before, now, tied, start, prior, settings)
        change = np.abs(pose.direction - start[1]).max()
        start = pose.rotation, pose.direction
        if change < radians(settings.settled_deg):
            break
    if ground is None:
        return pose
    tied = register_road(before, now, *start, ground, pose.tied, settings)
    return fit_relative_pose(before, now, tied, start, prior, settings)


def fit_relative_pose(
    before: KeypointImage,
    now: KeypointImage,
    tied: RegisteredTies,
    start: tuple[Array, Array],
    prior: StepPrior,
    settings: TieSettings,
) -> RelativePose:
    """Robust fit of rotation and direction to registered ties, from a start within a few pixels."""
    previous = rays_of_ideal(before.camera, tied.previous)
    current = rays_of_ideal(now.camera, tied.current)
    focal_px = now.focal_px
    rotation, direction = fit_epipolar(
        previous,
        current,
        start,
        prior,
        focal_px=focal_px,
        sigma_px=settings.sigma_px,
        scales_px=(settings.fine_first_scale_px, settings.fine_last_scale_px),
        schedule=Schedule(settings.fit_iterations, settings.fit_gain),
    )
    inlier = (
        np.abs(sampson_px(previous, current, rotation, direction, focal_px)) < settings.inlier_px
    )
    return RelativePose(rotation, direction, tied, previous, current, inlier)


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
