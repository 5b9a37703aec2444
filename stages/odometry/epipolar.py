"""Rotation and direction of travel from pairs of rays, without points in space.

Robust least squares on the Sampson distance with five unknowns and priors. `rotation` (3, 3) maps current to previous
camera axes; `direction` (3,) is the unit vector from the previous to the current camera centre, in previous axes.
Together they are the relative pose up to its length.
"""

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
from wayside.stages.kernels import Array, compiled, compiled_within, require_array, shaped

DIFFERENCE_STEP = 1e-6
"""Step of forward differences, radians: half of the digits of a double."""


class EpipolarFit(NamedTuple):
    """Result of `fit_epipolar`: rotation (3, 3), direction (3,), and the Sampson distances (n,), signed, px.

    `jacobian` (5, n + 6): of the residuals in the last iteration, by a rotation vector in previous axes and steps along
    the `tangent_basis` of the direction. `history` (k + 1,), px squared: sum of the squared Sampson distances at the
    start and after each iteration of the last fit.
    """

    rotation: Array
    direction: Array
    distance_px: Array
    jacobian: Array
    history: Array


class _Problem(NamedTuple):
    """Rays (n, 2), prior and settings of a fit; Jacobians, normal equations."""

    previous: Array
    current: Array
    prior: StepConstraints
    focal_px: float
    sigma_px: float
    scale_px: float
    history: Array
    jacobian: Array
    normal: Array
    damped: Array
    right: Array
    step: Array


class _Estimate(NamedTuple):
    """Poses of both cameras, and residuals (n + 6,): Sampson distances, px, then of the prior, sigmas."""

    rotations: Array
    centres: Array
    residuals: Array


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

    `previous`, `current`: rays (n, 2) as (x/z, y/z). `start`: rotation (3, 3) and unit direction (3,). `focal_px`: of
    one unit of the rays. `sigma_px`: standard deviation of a correct pair, the weight of the rays against the prior.
    `scales_px`: where the Cauchy cost of each fit starts to flatten.

    Raises ValueError where an array has another shape or type.
    """
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    known = StepConstraints.of([prior._replace(length_m=1.0, sigma_m=1.0)])
    rotations, centres = np.array([np.eye(3), start[0]]), np.array([np.zeros(3), start[1]])
    best = _Estimate(rotations, centres, np.empty(n + 6))
    history = np.empty(schedule.iterations + 1)
    work = history, np.empty((5, n + 6)), np.empty((5, 5)), np.empty((5, 5)), np.empty(5)
    for scale in scales_px:
        problem = _Problem(previous, current, known, focal_px, sigma_px, scale, *work, np.empty(5))
        trial = _Estimate(best.rotations.copy(), best.centres.copy(), np.empty(n + 6))
        best, _, done = _fit(problem, best, trial, schedule)
    distance = best.residuals[:n]
    history[done] = (distance**2).sum()
    return EpipolarFit(best.rotations[1], best.centres[1], distance, work[1], history[: done + 1])


def sampson_px(
    previous: Array, current: Array, rotation: Array, direction: Array, focal_px: float
) -> Array:
    """Signed Sampson distances (n,) of pairs of rays (n, 2) for a relative pose, in pixels."""
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    turn, ahead = shaped(rotation, (3, 3)), shaped(direction, (3,))
    _sampson(previous, current, turn, ahead, focal_px, result := np.empty(n))
    return result


@compiled_within
def _move(problem: _Problem, estimate: _Estimate, rotation: Array, direction: Array) -> None:
    # By `step` (5,): rotation vector, then at right angles to the direction, which stays of unit length: that holds the
    # baseline.
    step, last, centre = problem.step, estimate.rotations[1], estimate.centres[1]
    turn, basis, square = rotation_from_vector(step[:3]), tangent_basis(centre), 0.0
    for i in range(3):
        row = turn[i]
        for j in range(3):
            rotation[i, j] = row[0] * last[0, j] + row[1] * last[1, j] + row[2] * last[2, j]
        direction[i] = centre[i] + step[3] * basis[0, i] + step[4] * basis[1, i]
        square += direction[i] * direction[i]
    for i in range(3):
        direction[i] /= np.sqrt(square)


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


@compiled_within
def _residuals(problem: _Problem, rotations: Array, centres: Array, result: Array) -> None:
    # Of the rays (n,) in px, then of the prior (6,) in sigmas.
    n = problem.previous.shape[0]
    _sampson(
        problem.previous, problem.current, rotations[1], centres[1], problem.focal_px, result[:n]
    )
    constraint_residuals(rotations, centres, problem.prior, result[n:].reshape(1, 6))


@compiled_within
def _evaluate(problem: _Problem, estimate: _Estimate) -> float:
    residuals, n = estimate.residuals, problem.previous.shape[0]
    _residuals(problem, estimate.rotations, estimate.centres, residuals)
    of_rays, of_prior, product = 0.0, 0.0, 1.0
    for i in range(n):  # a logarithm costs as much as a hundred products
        product *= 1.0 + (residuals[i] / problem.scale_px) ** 2
        if product > 1e150:
            of_rays, product = of_rays + float(np.log(product)), 1.0
    of_rays += float(np.log(product))
    for i in range(n, n + 6):
        of_prior += residuals[i] ** 2
    return of_rays * (problem.scale_px / problem.sigma_px) ** 2 + of_prior


@compiled_within
def _linearise(problem: _Problem, estimate: _Estimate, iteration: int) -> None:
    jacobian, normal, right = problem.jacobian, problem.normal, problem.right
    residuals, n = estimate.residuals, problem.previous.shape[0]
    rotations, centres = estimate.rotations.copy(), estimate.centres.copy()
    for k in range(5):
        problem.step[:] = 0.0
        problem.step[k] = DIFFERENCE_STEP
        _move(problem, estimate, rotations[1], centres[1])
        _residuals(problem, rotations, centres, jacobian[k])
        for i in range(n + 6):
            jacobian[k, i] = (jacobian[k, i] - residuals[i]) / DIFFERENCE_STEP
    normal[:] = 0.0
    right[:] = 0.0
    problem.history[iteration] = 0.0
    for i in range(n + 6):
        weight = 1.0
        if i < n:
            problem.history[iteration] += residuals[i] ** 2
            weight = 1.0 / ((1.0 + (residuals[i] / problem.scale_px) ** 2) * problem.sigma_px**2)
        for k in range(5):
            right[k] -= weight * jacobian[k, i] * residuals[i]
            for m in range(k + 1):
                normal[k, m] += weight * jacobian[k, i] * jacobian[m, i]


@compiled_within
def _solve(problem: _Problem, estimate: _Estimate, damping: float, trial: _Estimate) -> bool:
    for k in range(5):
        problem.step[k] = problem.right[k]
        for m in range(k + 1):
            problem.damped[k, m] = problem.normal[k, m]
        problem.damped[k, k] += damping * problem.normal[k, k] + 1e-9
    if not cholesky_solve(problem.damped, problem.step):
        return False
    _move(problem, estimate, trial.rotations[1], trial.centres[1])
    return True


_minimise = minimiser(_evaluate, _linearise, _solve)


@compiled
def _fit(
    problem: _Problem, start: _Estimate, trial: _Estimate, schedule: Schedule
) -> tuple[_Estimate, float, int]:
    return _minimise(problem, start, trial, schedule)
