"""Relative pose of two images by tie points: coarse from matched corners, then fine from registered ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import radians

import numpy as np

from wayside.schemas.settings import TieSettings
from wayside.stages.geometry import rays_of_ideal, rotation_from_vector
from wayside.stages.kernels import Array
from wayside.stages.odometry.coarse_pose import (
    find_coarse_motion,
    near_coarse_motions,
    with_held_direction,
)
from wayside.stages.odometry.epipolar import (
    EpipolarFit,
    RelativePosePrior,
    fit_epipolar,
    halfway_direction,
    sampson_px,
)
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.tie_points import (
    GroundPlane,
    KeypointImage,
    RegisteredTies,
    register_road,
    register_ties,
)


@dataclass(frozen=True, slots=True)
class RelativePose:
    """Rotation and direction as in `fit_epipolar`, the prior, the ties, their rays (n, 2), and the inliers (n,)."""

    rotation: Array
    direction: Array
    prior: RelativePosePrior
    tied: RegisteredTies
    previous: Array
    current: Array
    inlier: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    @property
    def inliers(self) -> int:
        """Number of inliers."""
        return int(self.inlier.sum())


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
    prior, ground = expected.prior, mount.ground(expected.baseline_m)
    coarse, inliers = find_coarse_motion(
        before, now, prior, expected.search, expected.slack_px, settings
    )
    if inliers < settings.enough_coarse:
        wide, more = find_coarse_motion(
            before, now, prior, expected.straight[0], settings.wide_slack_px, settings
        )
        if more > inliers:
            coarse, inliers = wide, more
    if coarse is None or inliers < fewest:
        return None
    pose = _refine(before, now, (coarse.rotation, coarse.direction), prior, ground, settings)
    if pose.inliers < settings.inlier_ratio * len(pose.inlier):
        # With a wrong rotation the inlier ratio is low. Of all starts, that with the most inliers is kept.
        starts = _other_starts(before, now, expected, pose, settings)
        others = [_refine(before, now, start, prior, ground, settings) for start in starts]
        pose = max(pose, *others, key=lambda one: one.inliers)
    if mount.strays(pose.rotation, pose.direction):
        travel = mount.travel.direction
        held = prior._replace(
            direction=travel,
            sigma_direction=np.full(2, radians(settings.held_direction_deg)),
            halfway=True,
        )
        start = pose.rotation, halfway_direction(pose.rotation, travel)
        pose = _refine(before, now, start, held, ground, settings)
    return pose if pose.inliers >= fewest else None


def _other_starts(
    before: KeypointImage,
    now: KeypointImage,
    expected: MotionPrior,
    pose: RelativePose,
    settings: TieSettings,
) -> list[tuple[Array, Array]]:
    """Rotations and directions to start from: the current pose, minima near the prediction, yaws off it."""
    prior = expected.prior
    fits = near_coarse_motions(before, now, prior, expected.search, expected.slack_px, settings)
    wide, _ = find_coarse_motion(
        before, now, prior, expected.straight[0], settings.wide_slack_px, settings
    )
    fits += [] if wide is None else [wide]
    starts = [(pose.rotation, pose.direction), *((fit.rotation, fit.direction) for fit in fits)]
    steps = np.arange(-settings.start_yaws, settings.start_yaws + 1)
    for yaw in np.radians(np.round(settings.start_yaw_step_deg * steps, 6)):
        rotation = rotation_from_vector(np.array([0.0, yaw, 0.0])) @ expected.search
        starts.append((rotation, _prior_direction(rotation, prior)))
    return starts


def _prior_direction(rotation: Array, prior: RelativePosePrior) -> Array:
    return halfway_direction(rotation, prior.direction) if prior.halfway else prior.direction


def _refine(
    before: KeypointImage,
    now: KeypointImage,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    ground: GroundPlane | None,
    settings: TieSettings,
) -> RelativePose:
    # Ties selected by a motion are biased towards it: they are selected again while it still changes.
    tied = register_ties(before, now, *start, settings, ground)
    pose = fit_relative_pose(before, now, tied, start, prior, settings)
    for _ in range(settings.rounds - 1):
        if np.abs(pose.direction - start[1]).max() < radians(settings.settled_deg):
            break
        start = pose.rotation, pose.direction
        tied = register_ties(before, now, *start, settings, ground, tied)
        pose = fit_relative_pose(before, now, tied, start, prior, settings)
    if ground is None:
        return pose
    start = pose.rotation, pose.direction
    tied = register_road(before, now, *start, ground, tied, settings)
    return fit_relative_pose(before, now, tied, start, prior, settings)


def fit_relative_pose(
    before: KeypointImage,
    now: KeypointImage,
    tied: RegisteredTies,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    settings: TieSettings,
) -> RelativePose:
    """Robust fit of rotation and direction to registered ties, from a start within a few pixels.

    A vehicle ahead at our own speed does not move in the image, like far points on a straight road: on a curve in haze
    it can hold a third of the ties, and the fit follows it. So where the inlier ratio is low, small random groups of
    ties give other starts, and the fit of lowest cost is kept (RANSAC, Fischler and Bolles 1981).
    """
    previous = rays_of_ideal(before.camera, tied.previous)
    current = rays_of_ideal(now.camera, tied.current)
    focal_px = now.focal_px
    best = _fine_fit(previous, current, start, prior, focal_px, settings)
    inlier = np.abs(sampson_px(previous, current, *best[:2], focal_px)) < settings.inlier_px
    enough = len(previous) >= settings.groups
    if enough and inlier.sum() < settings.inlier_ratio * len(previous):
        groups = _grouped_starts(previous, current, start, prior, focal_px, settings)
        fits = [_fine_fit(previous, current, g[:2], prior, focal_px, settings) for g in groups]
        best = min((best, *fits), key=lambda fit: fit.cost)
        inlier = np.abs(sampson_px(previous, current, *best[:2], focal_px)) < settings.inlier_px
    return RelativePose(best.rotation, best.direction, prior, tied, previous, current, inlier)


def _grouped_starts(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    focal_px: float,
    settings: TieSettings,
) -> list[EpipolarFit]:
    """Fits to random groups of four ties: the few of lowest robust cost over all ties."""
    held = with_held_direction(prior, settings)
    start = start[0], _prior_direction(start[0], prior)
    random = np.random.default_rng(settings.group_seed)
    scale = settings.fine_first_scale_px
    fits, costs = [], []
    for _ in range(settings.groups):
        rows = random.choice(len(previous), 4, replace=False)
        fit = fit_epipolar(
            previous[rows],
            current[rows],
            start,
            held,
            focal_px=focal_px,
            sigma_px=settings.sigma_px,
            scale_px=settings.group_scale_px,
        )
        distances = sampson_px(previous, current, fit.rotation, fit.direction, focal_px)
        fits.append(fit)
        costs.append(float(np.log1p((distances / scale) ** 2).sum()))
    return [fits[k] for k in np.argsort(costs, kind="stable")[: settings.best_groups]]


def _fine_fit(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    focal_px: float,
    settings: TieSettings,
) -> EpipolarFit:
    for scale in (settings.fine_first_scale_px, settings.fine_last_scale_px):
        fit = fit_epipolar(
            previous,
            current,
            start,
            prior,
            focal_px=focal_px,
            sigma_px=settings.sigma_px,
            scale_px=scale,
        )
        start = (fit.rotation, fit.direction)
    return fit
