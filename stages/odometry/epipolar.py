"""Rotation and direction of travel from ray pairs, without points in space.

Levenberg-Marquardt on the Sampson distance with five unknowns, robust, with priors. `rotation` turns current into
previous camera axes, `direction` is the unit vector from the previous to the current camera centre, in previous
axes: together, but for the length, the pose of the current camera in the previous one's frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.stages.geometry import (
    cholesky_solve,
    rotation_from_vector,
    tangent_basis,
    vector_from_rotation,
)
from wayside.stages.kernels import Array, compiled, require_array

DIFFERENCE_STEP = 1e-6


class RelativePosePrior(NamedTuple):
    """What is known of a step before looking.

    rotation (3, 3) with sigma_rotation in radians (inf: unknown). Direction of travel (3,) with sigma_direction (2,)
    in radians, sideways and up: in the axes half way through the turn where `halfway` (a camera fixed to a vehicle
    that drives an arc travels there in a constant direction: the chord's), else in the previous camera's.
    """

    rotation: Array
    sigma_rotation: float
    direction: Array
    sigma_direction: Array
    halfway: bool

    def checked(self) -> RelativePosePrior:
        """The same in the types that compiled code takes."""
        rotation = np.ascontiguousarray(self.rotation, np.float64)
        direction = np.ascontiguousarray(self.direction, np.float64)
        sigma = np.ascontiguousarray(self.sigma_direction, np.float64)
        require_array(rotation, "rotation", np.float64, (3, 3))
        require_array(direction, "direction", np.float64, (3,))
        require_array(sigma, "sigma_direction", np.float64, (2,))
        return RelativePosePrior(
            rotation, float(self.sigma_rotation), direction, sigma, bool(self.halfway)
        )


class EpipolarFit(NamedTuple):
    """Result of `fit_epipolar`: rotation (3, 3), direction (3,), cost, iterations."""

    rotation: Array
    direction: Array
    cost: float
    iterations: int


def fit_epipolar(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    *,
    focal_px: float,
    sigma_px: float,
    scale_px: float,
    iterations: int = 15,
) -> EpipolarFit:
    """Motion that puts the rays on common planes.

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
        Standard deviation of a good ray, px: the weight of the rays against the prior.
    scale_px
        Distance where the Cauchy cost starts to flatten.
    iterations
        At most this many.
    """
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    rotation = np.array(start[0], np.float64).reshape(3, 3)
    direction = np.array(start[1], np.float64).reshape(3)
    cost, steps = _fit(
        previous,
        current,
        rotation,
        direction,
        prior.checked(),
        focal_px,
        sigma_px,
        scale_px,
        iterations,
    )
    return EpipolarFit(rotation, direction, float(cost), int(steps))


def sampson_px(
    previous: Array, current: Array, rotation: Array, direction: Array, focal_px: float
) -> Array:
    """Signed Sampson distance (n,) of ray pairs (n, 2) to the motion, in pixels."""
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
    """Direction (3,) of the axes half way through a rotation, in the axes before it."""
    half: Array = np.dot(rotation_from_vector(0.5 * vector_from_rotation(rotation)), direction)
    return half


@compiled
def prior_residuals(
    rotation: Array,
    direction: Array,
    prior: RelativePosePrior,
    gaps: Array,
) -> None:
    """Distances (5,) to the prior in sigmas: rotation about x, y, z, direction sideways and up."""
    turn = vector_from_rotation(np.dot(rotation, prior.rotation.T))
    for i in range(3):
        gaps[i] = turn[i] / prior.sigma_rotation
    expected = halfway_direction(rotation, prior.direction) if prior.halfway else prior.direction
    for i in range(2):
        slope = direction[i] / direction[2] - expected[i] / expected[2]
        gaps[3 + i] = slope / prior.sigma_direction[i]


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
        # At the focus of expansion every line passes: no distance can be told.
        result[i] = focal_px * (x * a + y * b + c) / np.sqrt(max(square, 1e-12))


@compiled
def updated_pose(
    rotation: Array, direction: Array, basis: Array, step: Array, out_r: Array, out_t: Array
) -> None:
    """Rotation and direction after a step (5,): rotation vector, then along `basis` (2, 3).

    The direction stays of unit length: this is what holds the baseline.
    """
    out_r[:] = np.dot(rotation_from_vector(step[:3]), rotation)
    square = 0.0
    for i in range(3):
        out_t[i] = direction[i] + step[3] * basis[0, i] + step[4] * basis[1, i]
        square += out_t[i] * out_t[i]
    out_t /= np.sqrt(square)


@compiled
def _cost(gaps: Array, known: Array, sigma_px: float, scale_px: float) -> float:
    total = 0.0
    for i in range(gaps.shape[0]):
        total += np.log1p((gaps[i] / scale_px) ** 2)
    total *= (scale_px / sigma_px) ** 2
    for i in range(5):
        total += known[i] ** 2
    return total


@compiled
def _fit(
    previous: Array,
    current: Array,
    rotation: Array,
    direction: Array,
    prior: RelativePosePrior,
    focal_px: float,
    sigma_px: float,
    scale_px: float,
    iterations: int,
) -> tuple[float, int]:
    n = previous.shape[0]
    gaps, slopes = np.empty(n), np.empty((5, n))
    known, known_slopes = np.empty(5), np.empty((5, 5))
    trial_r, trial_t, step = np.empty((3, 3)), np.empty(3), np.empty(5)
    normal, right, damped = np.empty((5, 5)), np.empty(5), np.empty((5, 5))

    _sampson(previous, current, rotation, direction, focal_px, gaps)
    prior_residuals(rotation, direction, prior, known)
    cost = _cost(gaps, known, sigma_px, scale_px)
    damping, done = 1e-3, 0
    while done < iterations:
        done += 1
        basis = tangent_basis(direction)
        for k in range(5):
            step[:] = 0.0
            step[k] = DIFFERENCE_STEP
            updated_pose(rotation, direction, basis, step, trial_r, trial_t)
            _sampson(previous, current, trial_r, trial_t, focal_px, slopes[k])
            prior_residuals(trial_r, trial_t, prior, known_slopes[k])
            for i in range(n):
                slopes[k, i] = (slopes[k, i] - gaps[i]) / DIFFERENCE_STEP
            for i in range(5):
                known_slopes[k, i] = (known_slopes[k, i] - known[i]) / DIFFERENCE_STEP
        for k in range(5):
            right[k] = 0.0
            for m in range(k + 1):
                normal[k, m] = 0.0
            for i in range(5):
                right[k] -= known_slopes[k, i] * known[i]
                for m in range(k + 1):
                    normal[k, m] += known_slopes[k, i] * known_slopes[m, i]
        for i in range(n):
            weight = 1.0 / ((1.0 + (gaps[i] / scale_px) ** 2) * sigma_px**2)
            for k in range(5):
                right[k] -= weight * slopes[k, i] * gaps[i]
                for m in range(k + 1):
                    normal[k, m] += weight * slopes[k, i] * slopes[m, i]
        better, gain = False, 0.0
        for _ in range(8):
            damped[:] = normal
            for k in range(5):
                damped[k, k] += damping * normal[k, k] + 1e-9
            step[:] = right
            if cholesky_solve(damped, step, 5):
                updated_pose(rotation, direction, basis, step, trial_r, trial_t)
                _sampson(previous, current, trial_r, trial_t, focal_px, slopes[0])
                prior_residuals(trial_r, trial_t, prior, known_slopes[0])
                trial_cost = _cost(slopes[0], known_slopes[0], sigma_px, scale_px)
                if trial_cost < cost:
                    better, gain = True, cost - trial_cost
                    break
            damping *= 10.0
        if not better:
            break
        rotation[:] = trial_r
        direction[:] = trial_t
        gaps[:] = slopes[0]
        known[:] = known_slopes[0]
        cost -= gain
        damping = max(1e-9, damping * 0.1)
        if gain < 1e-7 * cost:
            break
    return cost, done
