"""Relative pose of two images by tie points: coarse from matched corners, then fine from registered ones."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from wayside.schemas.motion import StepPrior, Ties
from wayside.stages.adjustment import TIE_ERRORS
from wayside.stages.geometry import halfway_direction, rays_of_ideal, rotation_from_vector
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import EpipolarFit, fit_epipolar
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.pair_adjustment import FINE_LAST_SCALE_PX, FIT
from wayside.stages.odometry.tie_points import (
    COARSE_BITS,
    COARSE_RATIO,
    GUIDED_WIDTH_PX,
    KeypointImage,
    PairMotion,
    RegisteredTies,
    register_road,
    register_ties,
)

COARSE_SIGMA_PX = 1.0
"""Standard deviation of a matched corner."""
COARSE_SCALES_PX = 20.0, 5.0, 1.5
"""Cauchy scales of the coarse fits, one after the other."""
COARSE_INLIER_PX = 3.0
"""Sampson distance of an inlier of a coarse fit."""
FEWEST_COARSE = 8
"""Fewest matches for a coarse fit."""
HELD_DIRECTION_DEG = 0.1
"""Standard deviation of a direction of travel that is held."""
FINE_FIRST_SCALE_PX = 0.6
"""Cauchy scale of the first fine fit."""
INLIER_PX = 0.4
"""Sampson distance of an inlier of a fine fit."""
INLIER_RATIO = 0.5
"""Below this share of inliers other starts are tried: no other motion has more ties than one that half of them show."""
ROUNDS = 3
"""Ties are registered again while the epipole moves by more than the width of their bands, so often at most."""
START_YAW_STEP_DEG, START_YAWS = 0.3, 3
"""Step of the yaws from which ties are registered again, and their number on either side of the prediction."""


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

    def ties(self, points: Array, scatter: float) -> Ties:
        """The ties with their points (n, 3) in the second camera."""
        t = self.tied
        return Ties(t.previous, t.current, self.inlier, points, t.rows, t.warp, t.sigma, scatter)


RelativePoseEstimator = Callable[
    [KeypointImage, KeypointImage, MotionPrior, Mount, int], RelativePose | None
]


def estimate_relative_pose(
    before: KeypointImage,
    now: KeypointImage,
    expected: MotionPrior,
    mount: Mount,
    fewest: int,
) -> RelativePose | None:
    """Relative pose of two images: coarse motion, then ties registered by it.

    Returns None with fewer than `fewest` inliers.
    """
    prior, ground = expected.prior, mount.ground(expected.prior.length_m)
    coarse, inliers = find_coarse_motion(before, now, prior, expected.search, expected.slack_px)
    if coarse is None or inliers < fewest:
        return None
    pair = PairMotion(before, now, coarse.rotation, coarse.direction, ground)
    pose = _refine(pair, prior)
    if pose.inliers < INLIER_RATIO * len(pose.inlier):
        # With a wrong rotation the inlier ratio is low. Of all starts, that with the most inliers is kept.
        others = (_refine(start, prior) for start in _turned(pair, expected))
        pose = max(pose, *others, key=lambda one: one.inliers)
    return pose if pose.inliers >= fewest else None


def _turned(pair: PairMotion, expected: MotionPrior) -> Iterator[PairMotion]:
    """The pair with rotations that are yaws off the prediction."""
    prior = expected.prior
    for step in range(-START_YAWS, START_YAWS + 1):
        yaw = np.array([0.0, radians(START_YAW_STEP_DEG * step), 0.0])
        rotation = rotation_from_vector(yaw) @ expected.search
        ahead = halfway_direction(rotation, prior.direction) if prior.halfway else prior.direction
        yield replace(pair, rotation=rotation, direction=ahead)


def _refine(pair: PairMotion, prior: StepPrior) -> RelativePose:
    # Ties selected by a motion are biased towards it: they are selected again while it still changes.
    tied = None
    for _ in range(ROUNDS):
        tied, last = register_ties(pair, tied), pair.direction
        pose = fit_relative_pose(pair, tied, prior)
        pair = replace(pair, rotation=pose.rotation, direction=pose.direction)
        if np.abs(pose.direction - last).max() * pair.now.focal_px < GUIDED_WIDTH_PX:
            break
    if pair.ground is None:
        return pose
    return fit_relative_pose(pair, register_road(pair, pair.ground, pose.tied), prior)


def fit_relative_pose(pair: PairMotion, tied: RegisteredTies, prior: StepPrior) -> RelativePose:
    """Robust fit of rotation and direction to registered ties, from a motion within a few pixels."""
    previous = rays_of_ideal(pair.before.camera, tied.previous)
    current = rays_of_ideal(pair.now.camera, tied.current)
    fit = fit_epipolar(
        previous,
        current,
        (pair.rotation, pair.direction),
        prior,
        focal_px=pair.now.focal_px,
        sigma_px=TIE_ERRORS.sigma_px,
        scales_px=(FINE_FIRST_SCALE_PX, FINE_LAST_SCALE_PX),
        schedule=FIT,
    )
    inlier = np.abs(fit.distance_px) < INLIER_PX
    return RelativePose(fit.rotation, fit.direction, tied, previous, current, inlier)


def find_coarse_motion(
    before: KeypointImage, now: KeypointImage, prior: StepPrior, predicted: Array, slack_px: float
) -> tuple[EpipolarFit | None, int]:
    """Rotation and direction from matched corners, and the number of inliers; None with too few matches.

    predicted: rotation (3, 3) by which corners are predicted. slack_px: half width of the band round the prediction.
    """
    pair = PairMotion(before, now, predicted, prior.direction)
    pairs = pair.matches(slack_px, COARSE_BITS, COARSE_RATIO, before.stride)
    if len(pairs) < FEWEST_COARSE:
        return None, 0
    previous = rays_of_ideal(before.camera, before.ideal[pairs[:, 0]])
    current = rays_of_ideal(now.camera, now.ideal[pairs[:, 1]])
    return fit_coarse_motion(previous, current, prior, predicted, now.focal_px)


def fit_coarse_motion(
    previous: Array, current: Array, prior: StepPrior, predicted: Array, focal_px: float
) -> tuple[EpipolarFit, int]:
    """Rotation and direction from matched rays (n, 2), to about a pixel, and the number of inliers."""
    # In forward motion, direction and yaw have similar effects: the direction is held first.
    sigma = np.minimum(prior.sigma_direction, radians(HELD_DIRECTION_DEG))
    start = predicted, prior.direction
    held = prior._replace(sigma_direction=sigma)
    for known, scales_px in ((held, COARSE_SCALES_PX), (prior, COARSE_SCALES_PX[-1:])):
        fit = fit_epipolar(
            previous,
            current,
            start,
            known,
            focal_px=focal_px,
            sigma_px=COARSE_SIGMA_PX,
            scales_px=scales_px,
            schedule=FIT,
        )
        start = fit.rotation, fit.direction
    return fit, int((np.abs(fit.distance_px) < COARSE_INLIER_PX).sum())
