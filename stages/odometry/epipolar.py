"""Rotation and direction of travel from pairs of rays, without points in space.

Robust least squares on the Sampson distance with five unknowns and priors. `rotation` (3, 3) maps current to previous
camera axes; `direction` (3,) is the unit vector from the previous to the current camera centre, in previous axes.
Together they are the relative pose up to its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment import StepConstraints, constraint_residuals
from wayside.stages.geometry import (
    Schedule,
    cholesky_solve,
    minimiser,
    rotation_from_vector,
    tangent_basis,
)
from wayside.stages.kernels import Array, compiled, require_array

DIFFERENCE_STEP = 1e-6
"""Step of forward differences, radians: half of the digits of a double."""


class EpipolarFit(NamedTuple):
    """Result of `fit_epipolar`: rotation (3, 3), direction (3,)."""

    rotation: Array
    direction: Array


class _Problem(NamedTuple):
    """Rays (n, 2), prior and settings of a fit; tangent basis of the direction, Jacobians, normal equations."""

    previous: Array
    current: Array
    prior: StepConstraints
    focal_px: float
    sigma_px: float
    scale_px: float
    basis: Array
    jacobian: Array
    normal: Array
    right: Array
    damped: Array
    step: Array


class _Estimate(NamedTuple):
    """Poses of both cameras, Sampson distances (n,) in px, and residuals (1, 6) of the prior in sigmas."""

    rotations: Array
    centres: Array
    distances: Array
    known: Array


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
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    rotation = np.array(start[0], np.float64).reshape(3, 3)
    direction = np.array(start[1], np.float64).reshape(3)
    known = StepConstraints.of([prior._replace(length_m=1.0, sigma_m=1.0)])
    for scale in scales_px:
        _fit(previous, current, rotation, direction, known, focal_px, sigma_px, scale, schedule)
    return EpipolarFit(rotation, direction)


def sampson_px(
    previous: Array, current: Array, rotation: Array, direction: Array, focal_px: float
) -> Array:
    """Signed Sampson distances (n,) of pairs of rays (n, 2) for a relative pose, in pixels."""
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    result = np.empty(n)
    _sampson(
        previous,
        current,
        np.ascontiguousarray(rotation, np.float64),
        np.ascontiguousarray(direction, np.float64),
        focal_px,
        result,
    )
    return result


@compiled
def _updated_pose(
    rotation: Array, direction: Array, basis: Array, step: Array, out_r: Array, out_t: Array
) -> None:
    # After a step (5,): rotation vector, then along `basis` (2, 3). The direction stays of unit length: that holds the
    # baseline.
    out_r[:] = np.dot(rotation_from_vector(step[:3]), rotation)
    square = 0.0
    for i in range(3):
        out_t[i] = direction[i] + step[3] * basis[0, i] + step[4] * basis[1, i]
        square += out_t[i] * out_t[i]
    out_t /= np.sqrt(square)


@compiled
def _sampson(
    previous: Array,
    current: Array,
    rotation: Array,
    direction: Array,
    focal_px: float,
    result: Array,
) -> None:
    # Coplanarity: p . (t x R q) = 0, that is p' E q with E = [t]x R.
    e = np.empty((3, 3))
    t = direction
    for j in range(3):
        e[0, j] = t[1] * rotation[2, j] - t[2] * rotation[1, j]
        e[1, j] = t[2] * rotation[0, j] - t[0] * rotation[2, j]
        e[2, j] = t[0] * rotation[1, j] - t[1] * rotation[0, j]
    for i in range(previous.shape[0]):
        x, y, u, v = previous[i, 0], previous[i, 1], current[i, 0], current[i, 1]
        a = e[0, 0] * u + e[0, 1] * v + e[0, 2]
        b = e[1, 0] * u + e[1, 1] * v + e[1, 2]
        c = e[2, 0] * u + e[2, 1] * v + e[2, 2]
        p = e[0, 0] * x + e[1, 0] * y + e[2, 0]
        q = e[0, 1] * x + e[1, 1] * y + e[2, 1]
        square = a * a + b * b + p * p + q * q
        # All epipolar lines meet at the focus of expansion: the distance is undefined there.
        result[i] = focal_px * (x * a + y * b + c) / np.sqrt(max(square, 1e-12))


@compiled
def _evaluate(problem: _Problem, estimate: _Estimate) -> float:
    _sampson(
        problem.previous,
        problem.current,
        estimate.rotations[1],
        estimate.centres[1],
        problem.focal_px,
        estimate.distances,
    )
    constraint_residuals(estimate.rotations, estimate.centres, problem.prior, estimate.known)
    total = 0.0
    for i in range(estimate.distances.shape[0]):
        total += np.log1p((estimate.distances[i] / problem.scale_px) ** 2)
    total *= (problem.scale_px / problem.sigma_px) ** 2
    for i in range(6):
        total += estimate.known[0, i] ** 2
    return total


@compiled
def _linearise(problem: _Problem, estimate: _Estimate, iteration: int) -> None:
    jacobian, normal, right = problem.jacobian, problem.normal, problem.right
    problem.basis[:] = tangent_basis(estimate.centres[1])
    n = problem.previous.shape[0]
    rotations, centres = estimate.rotations.copy(), estimate.centres.copy()
    known, unit = np.empty((1, 6)), np.empty(5)
    for k in range(5):
        unit[:] = 0.0
        unit[k] = DIFFERENCE_STEP
        _updated_pose(
            estimate.rotations[1],
            estimate.centres[1],
            problem.basis,
            unit,
            rotations[1],
            centres[1],
        )
        _sampson(
            problem.previous,
            problem.current,
            rotations[1],
            centres[1],
            problem.focal_px,
            jacobian[k],
        )
        constraint_residuals(rotations, centres, problem.prior, known)
        for i in range(n):
            jacobian[k, i] = (jacobian[k, i] - estimate.distances[i]) / DIFFERENCE_STEP
        for i in range(6):
            jacobian[k, n + i] = (known[0, i] - estimate.known[0, i]) / DIFFERENCE_STEP
    normal[:] = 0.0
    right[:] = 0.0
    for i in range(n + 6):
        if i < n:
            residual = estimate.distances[i]
            weight = 1.0 / ((1.0 + (residual / problem.scale_px) ** 2) * problem.sigma_px**2)
        else:
            residual, weight = estimate.known[0, i - n], 1.0
        for k in range(5):
            right[k] -= weight * jacobian[k, i] * residual
            for m in range(k + 1):
                normal[k, m] += weight * jacobian[k, i] * jacobian[m, i]


@compiled
def _solve(problem: _Problem, estimate: _Estimate, damping: float, trial: _Estimate) -> bool:
    problem.damped[:] = problem.normal
    for k in range(5):
        problem.damped[k, k] += damping * problem.normal[k, k] + 1e-9
    problem.step[:] = problem.right
    if not cholesky_solve(problem.damped, problem.step):
        return False
    _updated_pose(
        estimate.rotations[1],
        estimate.centres[1],
        problem.basis,
        problem.step,
        trial.rotations[1],
        trial.centres[1],
    )
    return True


_minimise = minimiser(_evaluate, _linearise, _solve)


@compiled
def _fit(
    previous: Array,
    current: Array,
    rotation: Array,
    direction: Array,
    prior: StepConstraints,
    focal_px: float,
    sigma_px: float,
    scale_px: float,
    schedule: Schedule,
) -> None:
    # Rotation and direction are the start and become the result.
    n = previous.shape[0]
    problem = _Problem(
        previous, current, prior, focal_px, sigma_px, scale_px, np.empty((2, 3)), np.empty((5, n + 6)),
        np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5),
    )  # fmt: skip
    start = _Estimate(np.zeros((2, 3, 3)), np.zeros((2, 3)), np.empty(n), np.empty((1, 6)))
    for k in range(3):
        start.rotations[0, k, k] = 1.0
    start.rotations[1] = rotation
    start.centres[1] = direction
    trial = _Estimate(start.rotations.copy(), start.centres.copy(), np.empty(n), np.empty((1, 6)))
    best, _, _ = _minimise(problem, start, trial, schedule)
    rotation[:] = best.rotations[1]
    direction[:] = best.centres[1]
