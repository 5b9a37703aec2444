"""Rotation and direction of travel from pairs of rays, without points in space.

Robust least squares on the Sampson distance with five unknowns and priors. `rotation` (3, 3) maps current to previous
camera axes; `direction` (3,) is the unit vector from the previous to the current camera centre, in previous axes.
Together they are the relative pose up to its length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.stages.geometry import (
    Schedule,
    cholesky_solve,
    minimiser,
    rotation_from_vector,
    tangent_basis,
    vector_from_rotation,
)
from wayside.stages.kernels import Array, compiled, require_array

DIFFERENCE_STEP = 1e-6
"""Step of forward differences, radians: half of the digits of a double."""


class EpipolarFit(NamedTuple):
    """Result of `fit_epipolar`: rotation (3, 3), direction (3,)."""

    rotation: Array
    direction: Array


class PriorTerms(NamedTuple):
    """Work arrays of the prior: residuals come from an estimate; Jacobian (5, 5), one unknown a row, and scratch."""

    jacobian: Array
    unit: Array
    rotation: Array
    direction: Array


class _Problem(NamedTuple):
    """Rays (n, 2), prior and settings of a fit; tangent basis of the direction, Jacobian, normal equations."""

    previous: Array
    current: Array
    prior: StepPrior
    terms: PriorTerms
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
    """Relative pose, Sampson distances (n,) in px, and residuals (5,) of the prior in sigmas."""

    rotation: Array
    direction: Array
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
    scale_px: float,
    iterations: int = 15,
) -> EpipolarFit:
    """Relative pose that minimises the Sampson distances of rays (Hartley and Zisserman, section 11.4.3).

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
    scale_px
        Distance where the Cauchy cost starts to flatten.
    iterations
        At most this many.

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
    _fit(
        previous,
        current,
        rotation,
        direction,
        _checked(prior),
        focal_px,
        sigma_px,
        scale_px,
        Schedule(iterations),
    )
    return EpipolarFit(rotation, direction)


def _checked(prior: StepPrior) -> StepPrior:
    """The same in the types that compiled code takes; ValueError where an array has another shape."""
    rotation = np.ascontiguousarray(prior.rotation, np.float64)
    direction = np.ascontiguousarray(prior.direction, np.float64)
    sigma = np.ascontiguousarray(prior.sigma_direction, np.float64)
    require_array(rotation, "rotation", np.float64, (3, 3))
    require_array(direction, "direction", np.float64, (3,))
    require_array(sigma, "sigma_direction", np.float64, (2,))
    numbers = float(prior.length_m), float(prior.sigma_m)
    return StepPrior(
        rotation, float(prior.sigma_rotation), direction, sigma, bool(prior.halfway), *numbers
    )


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
def halfway_direction(rotation: Array, direction: Array) -> Array:
    """Direction (3,), given in the axes half way through a rotation, in the axes before it."""
    half: Array = np.dot(rotation_from_vector(0.5 * vector_from_rotation(rotation)), direction)
    return half


@compiled
def updated_pose(
    rotation: Array, direction: Array, basis: Array, step: Array, out_r: Array, out_t: Array
) -> None:
    """Rotation and direction after a step (5,): rotation vector, then along `basis` (2, 3).

    The direction stays of unit length: that holds the baseline.
    """
    out_r[:] = np.dot(rotation_from_vector(step[:3]), rotation)
    square = 0.0
    for i in range(3):
        out_t[i] = direction[i] + step[3] * basis[0, i] + step[4] * basis[1, i]
        square += out_t[i] * out_t[i]
    out_t /= np.sqrt(square)


@compiled
def prior_residuals(rotation: Array, direction: Array, prior: StepPrior, residuals: Array) -> None:
    """Residuals (5,) of the prior in sigmas: rotation about x, y, z, direction sideways and up."""
    vector = vector_from_rotation(np.dot(rotation, prior.rotation.T))
    for i in range(3):
        residuals[i] = vector[i] / prior.sigma_rotation
    expected = halfway_direction(rotation, prior.direction) if prior.halfway else prior.direction
    for i in range(2):
        slope = direction[i] / direction[2] - expected[i] / expected[2]
        residuals[3 + i] = slope / prior.sigma_direction[i]


@compiled
def prior_terms() -> PriorTerms:
    """Work arrays for `prior_jacobian`."""
    return PriorTerms(np.empty((5, 5)), np.empty(5), np.empty((3, 3)), np.empty(3))


@compiled
def prior_jacobian(
    rotation: Array,
    direction: Array,
    basis: Array,
    prior: StepPrior,
    known: Array,
    terms: PriorTerms,
) -> None:
    """Forward differences of the prior's residuals `known` (5,) by the five unknowns."""
    for k in range(5):
        terms.unit[:] = 0.0
        terms.unit[k] = DIFFERENCE_STEP
        updated_pose(rotation, direction, basis, terms.unit, terms.rotation, terms.direction)
        prior_residuals(terms.rotation, terms.direction, prior, terms.jacobian[k])
        for i in range(5):
            terms.jacobian[k, i] = (terms.jacobian[k, i] - known[i]) / DIFFERENCE_STEP


@compiled
def add_prior(known: Array, terms: PriorTerms, normal: Array, right: Array) -> None:
    """Add the prior to normal equations (5, 5), lower half, and their right side (5,)."""
    for k in range(5):
        for i in range(5):
            right[k] -= terms.jacobian[k, i] * known[i]
            for m in range(k + 1):
                normal[k, m] += terms.jacobian[k, i] * terms.jacobian[m, i]


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
        estimate.rotation,
        estimate.direction,
        problem.focal_px,
        estimate.distances,
    )
    prior_residuals(estimate.rotation, estimate.direction, problem.prior, estimate.known)
    total = 0.0
    for i in range(estimate.distances.shape[0]):
        total += np.log1p((estimate.distances[i] / problem.scale_px) ** 2)
    total *= (problem.scale_px / problem.sigma_px) ** 2
    for i in range(5):
        total += estimate.known[i] ** 2
    return total


@compiled
def _linearise(problem: _Problem, estimate: _Estimate, iteration: int) -> None:
    rotation, direction = estimate.rotation, estimate.direction
    terms, jacobian, normal, right = problem.terms, problem.jacobian, problem.normal, problem.right
    problem.basis[:] = tangent_basis(direction)
    n = problem.previous.shape[0]
    for k in range(5):
        terms.unit[:] = 0.0
        terms.unit[k] = DIFFERENCE_STEP
        updated_pose(
            rotation, direction, problem.basis, terms.unit, terms.rotation, terms.direction
        )
        _sampson(
            problem.previous,
            problem.current,
            terms.rotation,
            terms.direction,
            problem.focal_px,
            jacobian[k],
        )
        for i in range(n):
            jacobian[k, i] = (jacobian[k, i] - estimate.distances[i]) / DIFFERENCE_STEP
    normal[:] = 0.0
    right[:] = 0.0
    prior_jacobian(rotation, direction, problem.basis, problem.prior, estimate.known, terms)
    add_prior(estimate.known, terms, normal, right)
    for i in range(n):
        distance = estimate.distances[i]
        weight = 1.0 / ((1.0 + (distance / problem.scale_px) ** 2) * problem.sigma_px**2)
        for k in range(5):
            right[k] -= weight * jacobian[k, i] * distance
            for m in range(k + 1):
                normal[k, m] += weight * jacobian[k, i] * jacobian[m, i]


@compiled
def _solve(problem: _Problem, estimate: _Estimate, damping: float, trial: _Estimate) -> bool:
    problem.damped[:] = problem.normal
    for k in range(5):
        problem.damped[k, k] += damping * problem.normal[k, k] + 1e-9
    problem.step[:] = problem.right
    if not cholesky_solve(problem.damped, problem.step, 5):
        return False
    updated_pose(
        estimate.rotation,
        estimate.direction,
        problem.basis,
        problem.step,
        trial.rotation,
        trial.direction,
    )
    return True


_minimise = minimiser(_evaluate, _linearise, _solve)


@compiled
def _fit(
    previous: Array,
    current: Array,
    rotation: Array,
    direction: Array,
    prior: StepPrior,
    focal_px: float,
    sigma_px: float,
    scale_px: float,
    schedule: Schedule,
) -> None:
    # Rotation and direction are the start and become the result.
    n = previous.shape[0]
    problem = _Problem(
        previous, current, prior, prior_terms(), focal_px, sigma_px, scale_px,
        np.empty((2, 3)), np.empty((5, n)), np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5),
    )  # fmt: skip
    start = _Estimate(rotation.copy(), direction.copy(), np.empty(n), np.empty(5))
    trial = _Estimate(np.empty((3, 3)), np.empty(3), np.empty(n), np.empty(5))
    best, _, _ = _minimise(problem, start, trial, schedule)
    rotation[:] = best.rotation
    direction[:] = best.direction
