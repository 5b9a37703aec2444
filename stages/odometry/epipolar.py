"""Rotation and direction of travel from pairs of rays, without points in space.

Robust least squares on the Sampson distance with five unknowns and priors. `rotation` (3, 3) maps current to previous
camera axes; `direction` (3,) is the unit vector from the previous to the current camera centre, in previous axes.
Together they are the relative pose up to its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment import StepConstraints, constraint_residuals
from wayside.stages.geometry import (
    Schedule,
    minimiser,
    rotation_from_vector,
    tangent_basis,
)
from wayside.stages.kernels import Array, require_array

DIFFERENCE_STEP = 1e-6
"""Step of forward differences, radians: half of the digits of a double."""
FLOOR = 1e-9
"""Added to the diagonal of the normal equations: what nothing measures stays where it is."""


class EpipolarFit(NamedTuple):
    """Result of `fit_epipolar`: rotation (3, 3), direction (3,)."""

    rotation: Array
    direction: Array


@dataclass
class _Problem:
    """Rays (n, 3), the prior of one step for each of five pairs of cameras, and the normal equations at an estimate."""

    previous: Array
    current: Array
    prior: StepConstraints
    focal_px: float
    sigma_px: float
    scale_px: float
    basis: Array = field(init=False)
    normal: Array = field(init=False)
    right: Array = field(init=False)


@dataclass
class _Estimate:
    """Relative pose, Sampson distances (n,) in px and residuals (6,) of the prior in sigmas."""

    rotation: Array
    direction: Array
    distances: Array = field(default_factory=lambda: np.zeros(0))
    known: Array = field(default_factory=lambda: np.zeros(0))


def fit_epipolar(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: StepPrior,
    *,
    focal_px: float,
    sigma_px: float,
    scales_px: Sequence[float],
    schedule: Schedule,
) -> EpipolarFit:
    """Relative pose that minimises the Sampson distances of rays (Hartley and Zisserman, section 11.4.3).

    One fit for each scale, from the result of the one before: a wide cost finds the minimum that a narrow one refines.

    Parameters
    ----------
    previous, current
        Rays (n, 2) as (x/z, y/z).
    start
        Rotation (3, 3) and unit direction (3,).
    prior
        What is known beforehand.
    focal_px
        Pixels of one unit of the rays.
    sigma_px
        Standard deviation of the distance of a correct pair, px: the weight of the rays against the prior.
    scales_px
        Distance where the Cauchy cost starts to flatten, of each fit.
    schedule
        When a fit ends.

    Raises
    ------
    ValueError
        Where an array has another shape or type.
    """
    p, q = _homogeneous(previous, current)
    estimate = _Estimate(np.asarray(start[0], np.float64), np.asarray(start[1], np.float64))
    priors = StepConstraints.of([prior._replace(length_m=1.0, sigma_m=1.0)] * 5)
    priors = priors._replace(frames=np.array([[0, k] for k in range(1, 6)], np.int64))
    for scale_px in scales_px:
        problem = _Problem(p, q, priors, focal_px, sigma_px, scale_px)
        trial = _Estimate(estimate.rotation, estimate.direction)
        estimate, _, _ = _minimise(problem, estimate, trial, schedule)
    return EpipolarFit(estimate.rotation, estimate.direction)


def sampson_px(
    previous: Array, current: Array, rotation: Array, direction: Array, focal_px: float
) -> Array:
    """Signed Sampson distances (n,) of pairs of rays (n, 2) for a relative pose, in pixels."""
    distances: Array = _sampson(
        *_homogeneous(previous, current), rotation[None], direction[None], focal_px
    )[0]
    return distances


def _homogeneous(previous: Array, current: Array) -> tuple[Array, Array]:
    """Rays as columns (3, n)."""
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    ones = np.ones((1, n))
    return np.concatenate([previous.T, ones]), np.concatenate([current.T, ones])


def _sampson(p: Array, q: Array, rotations: Array, directions: Array, focal_px: float) -> Array:
    """Distances (k, n) for k relative poses."""
    # Coplanarity: p . (t x R q) = 0, that is p' E q with E = [t]x R.
    essential = np.cross(directions[:, :, None], rotations, axis=1)
    line = np.einsum("kij,jn->kin", essential, q)
    back = np.einsum("kji,jn->kin", essential[:, :, :2], p)
    squares = line[:, 0] ** 2 + line[:, 1] ** 2 + back[:, 0] ** 2 + back[:, 1] ** 2
    # All epipolar lines meet at the focus of expansion: the distance is undefined there.
    gap = np.einsum("in,kin->kn", p, line)
    return np.asarray(focal_px * gap / np.sqrt(np.maximum(squares, 1e-12)))


def _known(prior: StepConstraints, rotations: Array, directions: Array) -> Array:
    """Residuals (k, 6) of the prior for k relative poses, in sigmas."""
    count = len(rotations)
    residuals = np.empty((count, 6))
    some = StepConstraints._make(column[:count] for column in prior)
    with_first = (
        np.concatenate([np.eye(3)[None], rotations]),
        np.concatenate([np.zeros((1, 3)), directions]),
    )
    constraint_residuals(*with_first, some, residuals)
    return residuals


def _moved(estimate: _Estimate, basis: Array, step: Array) -> tuple[Array, Array]:
    """The relative pose after a step (5,): rotation vector, then along `basis` (2, 3)."""
    direction = estimate.direction + step[3:] @ basis
    # It stays of unit length: that holds the baseline.
    direction /= np.sqrt((direction**2).sum())
    return np.dot(rotation_from_vector(step[:3]), estimate.rotation), direction


def _evaluate(problem: _Problem, estimate: _Estimate) -> float:
    poses = estimate.rotation[None], estimate.direction[None]
    (estimate.distances,) = _sampson(problem.previous, problem.current, *poses, problem.focal_px)
    (estimate.known,) = _known(problem.prior, *poses)
    costs = np.log1p((estimate.distances / problem.scale_px) ** 2)
    of_rays = (problem.scale_px / problem.sigma_px) ** 2 * costs.sum()
    return float(of_rays + (estimate.known**2).sum())


def _linearise(problem: _Problem, estimate: _Estimate, iteration: int) -> None:
    problem.basis = tangent_basis(estimate.direction)
    moved = [_moved(estimate, problem.basis, step) for step in DIFFERENCE_STEP * np.eye(5)]
    poses = np.array([one[0] for one in moved]), np.array([one[1] for one in moved])
    distances = _sampson(problem.previous, problem.current, *poses, problem.focal_px)
    by_distance = (distances - estimate.distances) / DIFFERENCE_STEP
    by_known = (_known(problem.prior, *poses) - estimate.known) / DIFFERENCE_STEP
    flattened = 1.0 + (estimate.distances / problem.scale_px) ** 2
    weighted = by_distance / (flattened * problem.sigma_px**2)
    problem.normal = np.einsum("kn,mn->km", weighted, by_distance)
    problem.normal += np.einsum("kn,mn->km", by_known, by_known)
    problem.right = -np.einsum("kn,n->k", weighted, estimate.distances)
    problem.right -= np.einsum("kn,n->k", by_known, estimate.known)


def _solve(problem: _Problem, estimate: _Estimate, damping: float, trial: _Estimate) -> bool:
    damped = problem.normal + np.diag(damping * np.diag(problem.normal) + FLOOR)
    try:
        step: Array = np.asarray(np.linalg.solve(damped, problem.right), np.float64)
    except np.linalg.LinAlgError:
        return False
    trial.rotation, trial.direction = _moved(estimate, problem.basis, step)
    return bool(np.isfinite(step).all())


_minimise = minimiser(_evaluate, _linearise, _solve, plain=True)
