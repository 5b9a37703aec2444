"""The step between two pictures from their tie points: coarse by matches, then fine by registered ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wayside.stages.geometry import rays_of_ideal, rotation_from_vector
from wayside.stages.kernels import Array
from wayside.stages.odometry.coarse_pose import HELD_SIGMA, find_coarse_motion, near_coarse_motions
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
    REGISTERED_SIGMA_PX,
    GroundPlane,
    KeypointImage,
    RegisteredTies,
    register_road,
    register_ties,
)

WIDE_SLACK_PX, ENOUGH_AGREEING = 160.0, 60
"""Where fewer matches agree, corners are looked for once more, this far from a straight line."""
AGAIN_RAD, ROUNDS = np.radians(0.1), 3
"""Ties are chosen again while that moves the direction by more, so often at most."""
STARTS_RAD = np.radians([-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9])
"""Yaws off the prediction from which ties are looked for as well, where they quarrel."""
FINE_SCALES_PX, INLIER_PX = (0.6, 0.24), 0.4
"""Robust scales of the fit to registered ties, and the distance up to which a tie agrees."""
CLEAR_SHARE, GROUPS, BEST_GROUPS, GROUP_PX, GROUP_SEED = 0.75, 60, 4, 20.0, 1
"""Where fewer of the ties agree, so many groups of four, chosen at random, are asked and the best few followed; robust
scale of a group; the seed is fixed, as one pair of pictures has one step."""


@dataclass(frozen=True, slots=True)
class RelativePose:
    """A measured step: rotation and direction as in `numerics.epipolar`, the ties, which of them agree."""

    rotation: Array
    direction: Array
    prior: RelativePosePrior
    tied: RegisteredTies
    previous: Array
    current: Array
    inlier: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    @property
    def clear(self) -> bool:
        """Whether most of the ties agree."""
        return bool(self.inlier.sum() >= CLEAR_SHARE * len(self.previous))


RelativePoseEstimator = Callable[
    [KeypointImage, KeypointImage, MotionPrior, Mount, int], RelativePose | None
]


def estimate_relative_pose(
    before: KeypointImage, now: KeypointImage, expected: MotionPrior, vehicle: Mount, fewest: int
) -> RelativePose | None:
    """Step between two pictures: coarse motion, then ties registered by it; None with fewer than `fewest` ties."""
    prior, ground = expected.prior, vehicle.ground(expected.baseline_m)
    coarse, agreeing = find_coarse_motion(before, now, prior, expected.search, expected.slack_px)
    if agreeing < ENOUGH_AGREEING:
        wide, more = find_coarse_motion(before, now, prior, expected.straight[0], WIDE_SLACK_PX)
        if more > agreeing:
            coarse, agreeing = wide, more
    if coarse is None or agreeing < fewest:
        return None
    step = _refine(before, now, coarse.rotation, coarse.direction, prior, ground)
    if not step.clear:
        # Ties of a wrong turn are few and quarrel; of all that may have been, most ties agree with the right one.
        starts = _other_starts(before, now, expected, step)
        others = [_refine(before, now, *start, prior, ground) for start in starts]
        step = max(step, *others, key=lambda one: int(one.inlier.sum()))
    if vehicle.strays(step.rotation, step.direction):
        law = vehicle.law
        kept = expected.prior._replace(
            direction=law.direction,
            sigma_direction=np.array([HELD_SIGMA, HELD_SIGMA]),
            halfway=True,
        )
        step = _refine(
            before,
            now,
            step.rotation,
            halfway_direction(step.rotation, law.direction),
            kept,
            ground,
        )
    return step if step.inlier.sum() >= fewest else None


def _other_starts(
    before: KeypointImage, now: KeypointImage, expected: MotionPrior, step: RelativePose
) -> list[tuple[Array, Array]]:
    """Rotations and directions to start from: where the step is by now, near the prediction, far off it."""
    prior = expected.prior
    fits = near_coarse_motions(before, now, prior, expected.search, expected.slack_px)
    wide, _ = find_coarse_motion(before, now, prior, expected.straight[0], WIDE_SLACK_PX)
    fits += [] if wide is None else [wide]
    starts = [(step.rotation, step.direction), *((fit.rotation, fit.direction) for fit in fits)]
    for yaw in STARTS_RAD:
        turn = rotation_from_vector(np.array([0.0, yaw, 0.0])) @ expected.search
        ahead = halfway_direction(turn, prior.direction) if prior.halfway else prior.direction
        starts.append((turn, ahead))
    return starts


def _refine(
    before: KeypointImage,
    now: KeypointImage,
    rotation: Array,
    direction: Array,
    prior: RelativePosePrior,
    ground: GroundPlane | None,
) -> RelativePose:
    # Ties chosen by a motion tend to confirm it: choose again while it still moves.
    tied = register_ties(before, now, rotation, direction, ground)
    step = fit_relative_pose(before, now, tied, (rotation, direction), prior)
    for _ in range(ROUNDS - 1):
        if np.abs(step.direction - direction).max() < AGAIN_RAD:
            break
        rotation, direction = step.rotation, step.direction
        tied = register_ties(before, now, rotation, direction, ground, tied)
        step = fit_relative_pose(before, now, tied, (rotation, direction), prior)
    if ground is None:
        return step
    tied = register_road(before, now, step.rotation, step.direction, ground, tied)
    return fit_relative_pose(before, now, tied, (step.rotation, step.direction), prior)


def fit_relative_pose(
    before: KeypointImage,
    now: KeypointImage,
    tied: RegisteredTies,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
) -> RelativePose:
    """Rotation and direction that fit registered ties best, from a start a few pixels away at most.

    A vehicle ahead at our own pace stands still in the picture, like far things on a straight road: on a curve in haze
    it may hold a third of the ties, and the fit follows it. So where many ties do not agree, small groups of them say
    what else the step may have been, and the best fit is kept (RANSAC, Fischler and Bolles 1981).
    """
    previous = rays_of_ideal(before.camera, tied.previous)
    current = rays_of_ideal(now.camera, tied.current)
    focal_px = now.focal_px
    best = _fine_fit(previous, current, start, prior, focal_px)
    inlier = np.abs(sampson_px(previous, current, *best[:2], focal_px)) < INLIER_PX
    if len(previous) >= GROUPS and inlier.sum() < CLEAR_SHARE * len(previous):
        groups = _grouped_starts(previous, current, start, prior, focal_px)
        fits = [_fine_fit(previous, current, g[:2], prior, focal_px) for g in groups]
        best = min((best, *fits), key=lambda fit: fit.cost)
        inlier = np.abs(sampson_px(previous, current, *best[:2], focal_px)) < INLIER_PX
    return RelativePose(best.rotation, best.direction, prior, tied, previous, current, inlier)


def _grouped_starts(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    focal_px: float,
) -> list[EpipolarFit]:
    """The few best steps of those that groups of four ties say, by how all ties agree with them."""
    held = prior._replace(sigma_direction=np.minimum(prior.sigma_direction, HELD_SIGMA))
    ahead = halfway_direction(start[0], prior.direction) if prior.halfway else prior.direction
    random = np.random.default_rng(GROUP_SEED)
    fits, costs = [], []
    for _ in range(GROUPS):
        rows = random.choice(len(previous), 4, replace=False)
        fit = _fitted(previous[rows], current[rows], (start[0], ahead), held, focal_px, GROUP_PX)
        gaps = sampson_px(previous, current, fit.rotation, fit.direction, focal_px)
        fits.append(fit)
        costs.append(float(np.log1p((gaps / FINE_SCALES_PX[0]) ** 2).sum()))
    return [fits[k] for k in np.argsort(costs, kind="stable")[:BEST_GROUPS]]


def _fine_fit(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    focal_px: float,
) -> EpipolarFit:
    for scale in FINE_SCALES_PX:
        fit = _fitted(previous, current, start, prior, focal_px, scale)
        start = (fit.rotation, fit.direction)
    return fit


def _fitted(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    focal_px: float,
    scale_px: float,
) -> EpipolarFit:
    return fit_epipolar(
        previous,
        current,
        start,
        prior,
        focal_px=focal_px,
        sigma_px=REGISTERED_SIGMA_PX,
        scale_px=scale_px,
    )
