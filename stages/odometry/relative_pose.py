"""Relative pose of two images by tie points: coarse from matched corners, then fine from registered ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, radians, sqrt
from typing import NamedTuple

import numpy as np

from wayside.schemas.motion import StepPrior, Ties
from wayside.stages.adjustment import TIE_ERRORS, tie_scatter
from wayside.stages.geometry import (
    Schedule,
    halfway_direction,
    rays_of_ideal,
    rotation_from_vector,
)
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import EpipolarFit, fit_epipolar, sampson_px
from wayside.stages.odometry.pair_adjustment import FINE_LAST_SCALE_PX
from wayside.stages.odometry.tie_points import (
    COARSE_BITS,
    COARSE_RATIO,
    GroundPlane,
    KeypointImage,
    PairMotion,
    RegisteredTies,
    register_road,
    register_ties,
)

FIT_ITERATIONS = 15
"""Of a fit at most."""
FIT_GAIN = 1e-7
"""A fit ends where an iteration lowers the cost by a smaller fraction."""
COARSE_SIGMA_PX = 1.0
"""Standard deviation of a matched corner."""
COARSE_SCALES_PX = (1.5,)
"""Cauchy scales of the coarse fits, one after the other."""
COARSE_INLIER_PX = 3.0
"""Sampson distance of an inlier of a coarse fit."""
FEWEST_COARSE = 8
"""Fewest matches for a coarse fit."""
FINE_FIRST_SCALE_PX = 0.6
"""Cauchy scale of the first fine fit."""
INLIER_PX = 0.4
"""Sampson distance of an inlier of a fine fit."""
SETTLED_DEG = 0.2
"""Ties are registered again while the direction changes more."""
ROUNDS = 3
"""Rounds of registration at most."""
SAMPLES, SAMPLED = 400, 4
"""Random samples, and matches in each: where two of five matches are right, ten samples are."""
INLIER_RATIO = 0.75
"""With a smaller share of inliers, a fit is made from the consensus of the ties as well."""
SLACK_PX = 12.0
"""Half width of the bands that corners are matched in by a rotation that is about known."""
TURN_SLACK = 0.2
"""The same by no rotation, in focal lengths: the tangent of 11 degrees that a vehicle turns between two images."""
COARSE_CORNERS = 1000
"""Corners of each image that are matched in so wide a band: the best of all cells."""


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

    def scatter(self, focal_px: float) -> float:
        """Errors of the inliers over the stated ones; see `tie_scatter`."""
        held = self.previous[self.inlier], self.current[self.inlier]
        distance = sampson_px(*held, self.rotation, self.direction, focal_px)
        return tie_scatter(distance)

    def ties(self, points: Array, scatter: float) -> Ties:
        """The ties with their points (n, 3) in the second camera."""
        t = self.tied
        return Ties(t.previous, t.current, self.inlier, points, t.rows, t.warp, t.sigma, scatter)


class TiedPair(NamedTuple):
    """Ties of two images, and the motion that they fit without what other steps have shown."""

    motion: PairMotion
    tied: RegisteredTies


def tie_pair(
    before: KeypointImage, now: KeypointImage, prior: StepPrior, fewest: int
) -> TiedPair | None:
    """Ties of two images by these images and what the log says of them: coarse motion, then ties registered by it.

    Returns None with fewer than `fewest` inliers.
    """
    coarse, inliers = find_coarse_motion(before, now, prior)
    if coarse is None or inliers < fewest:
        return None
    pair, tied = PairMotion(before, now, coarse.rotation, coarse.direction), None
    # Ties selected by a motion are biased towards it: they are selected again while it still changes.
    for _ in range(ROUNDS):
        tied = register_ties(pair, tied)
        start = pair.rotation, pair.direction
        pose = fit_relative_pose(before, now, tied, start, prior)
        if pose.inliers < INLIER_RATIO * len(pose.inlier):
            pose = max(pose, fit_to_most(pose, pair, prior), key=lambda one: one.inliers)
        pair = replace(pair, rotation=pose.rotation, direction=pose.direction)
        if np.abs(pose.direction - start[1]).max() < radians(SETTLED_DEG):
            break
    return TiedPair(pair, pose.tied)


def estimate_relative_pose(
    found: TiedPair, prior: StepPrior, ground: GroundPlane | None, fewest: int
) -> RelativePose | None:
    """Relative pose by the ties of two images, more ties on the road, and all that is known.

    Returns None with fewer than `fewest` inliers.
    """
    pair, tied = found
    if ground is not None:
        tied = register_road(pair, ground, tied)
    pose = fit_relative_pose(pair.before, pair.now, tied, (pair.rotation, pair.direction), prior)
    return pose if pose.inliers >= fewest else None


def fit_relative_pose(
    before: KeypointImage,
    now: KeypointImage,
    tied: RegisteredTies,
    start: tuple[Array, Array],
    prior: StepPrior,
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
        sigma_px=TIE_ERRORS.sigma_px,
        scales_px=(FINE_FIRST_SCALE_PX, FINE_LAST_SCALE_PX),
        schedule=Schedule(FIT_ITERATIONS, FIT_GAIN),
    )
    inlier = np.abs(sampson_px(previous, current, rotation, direction, focal_px)) < INLIER_PX
    return RelativePose(rotation, direction, tied, previous, current, inlier)


def fit_to_most(pose: RelativePose, pair: PairMotion, prior: StepPrior) -> RelativePose:
    """The fit from what most ties agree with: a vehicle ahead that keeps our pace makes a curve look straight."""
    focal_px = pair.now.focal_px
    start = common_motion(pose.previous, pose.current, prior, focal_px, 2 * INLIER_PX)
    return fit_relative_pose(pair.before, pair.now, pose.tied, start, prior)


def find_coarse_motion(
    before: KeypointImage, now: KeypointImage, prior: StepPrior
) -> tuple[EpipolarFit | None, int]:
    """Rotation and direction from matched corners, and the number of inliers; None with too few matches.

    Without poses, the vehicle may have turned: the best corners are matched in wide bands, and tell where to search.
    """
    pair = PairMotion(before, now, prior.rotation, prior.direction)
    if not isfinite(prior.sigma_rotation):
        wide = pair.matches(TURN_SLACK * now.focal_px, COARSE_BITS, COARSE_RATIO, COARSE_CORNERS)
        if len(wide) < FEWEST_COARSE:
            return None, 0
        rays = pair.rays(wide)
        pair = replace(
            pair, **common_motion(*rays, prior, now.focal_px, COARSE_INLIER_PX)._asdict()
        )
    pairs = pair.matches(SLACK_PX, COARSE_BITS, COARSE_RATIO)
    if len(pairs) < FEWEST_COARSE:
        return None, 0
    start = EpipolarFit(pair.rotation, pair.direction)
    return fit_coarse_motion(*pair.rays(pairs), prior, start, now.focal_px)


def fit_coarse_motion(
    previous: Array, current: Array, prior: StepPrior, start: EpipolarFit, focal_px: float
) -> tuple[EpipolarFit, int]:
    """Rotation and direction from matched rays (n, 2), to about a pixel, and the number of inliers."""
    fit = fit_epipolar(
        previous,
        current,
        start,
        prior,
        focal_px=focal_px,
        sigma_px=COARSE_SIGMA_PX,
        scales_px=COARSE_SCALES_PX,
        schedule=Schedule(FIT_ITERATIONS, FIT_GAIN),
    )
    distance = sampson_px(previous, current, *fit, focal_px)
    return fit, int((np.abs(distance) < COARSE_INLIER_PX).sum())


def common_motion(
    previous: Array, current: Array, prior: StepPrior, focal_px: float, within_px: float
) -> EpipolarFit:
    """Rotation and direction that most pairs of rays (n, 2) agree with to within some px, of random samples of them.

    Consensus by the truncated squares of all pairs (Torr and Zisserman 2000). For a small rotation w and change u of
    the direction d, which turns half with w, the epipolar constraint of rays p and q is linear:
    (p x d) . q + w . (q x (p x d) + d x (q x p) / 2) + u . (q x p) = 0.
    """
    ones, ahead = np.ones((len(previous), 1)), prior.direction
    p, q = np.hstack([previous, ones]), np.hstack([current, ones])
    across, normal = np.cross(p, ahead), np.cross(q, p)
    slopes = np.hstack([np.cross(q, across) + np.cross(ahead, normal) / 2, normal[:, :2]])
    # In pixels, as the Sampson distance at no rotation.
    scale = focal_px / np.maximum(np.linalg.norm(across[:, :2], axis=1), 1e-3) / sqrt(2.0)
    slopes *= scale[:, None]
    still = (across * q).sum(axis=1) * scale
    rows = np.random.default_rng(0).integers(len(p), size=(SAMPLES, SAMPLED))
    some, loose = slopes[rows], np.diag([0.0, 0.0, 0.0, *prior.sigma_direction**-2])
    normals = some.swapaxes(1, 2) @ some + loose + 1e-6 * np.eye(5)
    found = np.linalg.solve(normals, -(some.swapaxes(1, 2) @ still[rows][..., None]))[..., 0]
    off = (found @ slopes.T + still) / within_px
    best = found[np.minimum(off * off, 1.0).sum(axis=1).argmin()]
    rotation = rotation_from_vector(best[:3])
    moved = halfway_direction(rotation, ahead + np.append(best[3:], 0.0))
    return EpipolarFit(rotation, moved / np.linalg.norm(moved))
