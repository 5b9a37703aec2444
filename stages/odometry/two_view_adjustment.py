"""Two-view bundle adjustment with the length of the baseline held (report chapter 8).

The report's unknowns are the second camera's centre on the sphere of the known baseline, its rotation, and the points.
The cost is the sum of the residuals of eq. 7.5, here with a Cauchy cost and with priors of the motion. Points are
eliminated by the Schur complement. A point is two coordinates of its ray in the first image and an inverse depth, so
that far points keep the equations regular. Inverse depths are in units of the baseline: its length drops out and only
scales the result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.stages.geometry import (
    Schedule,
    cholesky_solve,
    invert_symmetric,
    minimiser,
    tangent_basis,
)
from wayside.stages.kernels import Array, compiled, require_array
from wayside.stages.odometry.epipolar import (
    PriorTerms,
    RelativePosePrior,
    add_prior,
    prior_jacobian,
    prior_residuals,
    prior_terms,
    updated_pose,
)

FLOOR = 1e-9
"""Added to every diagonal: an unknown without measurements stays where it is."""


class TwoViewAdjustment(NamedTuple):
    """Result of `adjust_two_views`.

    rotation (3, 3), direction (3,): pose of the second camera in the first one's frame, up to its length;
    point (n, 3): ray (x/z, y/z) in the first image, and baseline over depth; squares (n,): eq. 7.5 of each point, px
    squared; covariance (5, 5) of the rotation vector (rad, first camera's axes) and of the direction along
    `tangent_basis` (rad), points eliminated; cost and iterations;
    history (iterations + 1,): mean of eq. 7.5 over the points, px squared, at the start and after each iteration.
    """

    rotation: Array
    direction: Array
    point: Array
    squares: Array
    covariance: Array
    cost: float
    iterations: int
    history: Array


class _Problem(NamedTuple):
    """Rays (n, 2), prior, settings; normal equations in blocks: motion (5, 5), mixed (n, 5, 3), points (n, 3, 3)."""

    previous: Array
    current: Array
    prior: RelativePosePrior
    terms: PriorTerms
    focal_px: Array
    sigma_px: float
    scale_px: float
    history: Array
    basis: Array
    motion: Array
    motion_right: Array
    mixed: Array
    own: Array
    own_right: Array
    inverses: Array
    reduced: Array
    step: Array


class _Estimate(NamedTuple):
    """Relative pose, points (n, 3), eq. 7.5 of each (n,), and residuals (5,) of the prior in sigmas."""

    rotation: Array
    direction: Array
    point: Array
    squares: Array
    known: Array


def adjust_two_views(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: RelativePosePrior,
    *,
    focal_px: tuple[float, float],
    sigma_px: float,
    scale_px: float,
    iterations: int = 20,
) -> TwoViewAdjustment:
    """Adjust motion and points together to the rays of two images.

    Parameters
    ----------
    previous, current
        Rays (n, 2) as (x/z, y/z), of the same points.
    start
        Rotation (3, 3) and unit direction (3,) to start from.
    prior
        What is known beforehand.
    focal_px
        fx, fy.
    sigma_px
        Standard deviation of a coordinate of a correct tie.
    scale_px
        Root of eq. 7.5 where the Cauchy cost of a point starts to flatten.
    iterations
        At most this many.

    Returns
    -------
    TwoViewAdjustment
        covariance is nan where the normal equations are singular (no points and no prior).

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
    history, covariance = np.empty(iterations + 1), np.empty((5, 5))
    best, cost, done = _adjust(
        previous,
        current,
        rotation,
        direction,
        prior.checked(),
        np.array(focal_px, np.float64),
        sigma_px,
        scale_px,
        Schedule(iterations),
        history,
        covariance,
    )
    return TwoViewAdjustment(*best[:4], covariance, float(cost), int(done), history[: done + 1])


@compiled
def _first_points(
    previous: Array, current: Array, rotation: Array, direction: Array, point: Array
) -> None:
    # Inverse depth that brings the ray of the first image closest to that of the second one.
    t = np.dot(rotation.T, direction)
    v = np.empty(3)
    for i in range(previous.shape[0]):
        for k in range(3):
            v[k] = (
                rotation[0, k] * previous[i, 0] + rotation[1, k] * previous[i, 1] + rotation[2, k]
            )
        # (v - rho t) is parallel to q: least squares for rho of the cross product with q
        x, y = current[i, 0], current[i, 1]
        a0, a1 = v[1] - v[2] * y, v[2] * x - v[0]
        b0, b1 = t[1] - t[2] * y, t[2] * x - t[0]
        square = b0 * b0 + b1 * b1
        point[i, 0], point[i, 1] = previous[i, 0], previous[i, 1]
        rho = (a0 * b0 + a1 * b1) / square if square > 1e-12 else 0.0
        # in front of the second camera, and little beyond infinity
        point[i, 2] = min(max(rho, -0.05), 0.9)


@compiled
def _squares(
    previous: Array,
    current: Array,
    rotation: Array,
    direction: Array,
    point: Array,
    focal_px: Array,
    squares: Array,
) -> None:
    r, t = rotation, direction
    for i in range(previous.shape[0]):
        a, b, rho = point[i, 0], point[i, 1], point[i, 2]
        v0, v1, v2 = a - rho * t[0], b - rho * t[1], 1.0 - rho * t[2]
        z = r[0, 2] * v0 + r[1, 2] * v1 + r[2, 2] * v2
        if z < 1e-3:
            squares[i] = 1e12
            continue
        x = (r[0, 0] * v0 + r[1, 0] * v1 + r[2, 0] * v2) / z
        y = (r[0, 1] * v0 + r[1, 1] * v1 + r[2, 1] * v2) / z
        squares[i] = (
            (focal_px[0] * (a - previous[i, 0])) ** 2
            + (focal_px[1] * (b - previous[i, 1])) ** 2
            + (focal_px[0] * (x - current[i, 0])) ** 2
            + (focal_px[1] * (y - current[i, 1])) ** 2
        )


@compiled
def _evaluate(problem: _Problem, estimate: _Estimate) -> float:
    _squares(
        problem.previous,
        problem.current,
        estimate.rotation,
        estimate.direction,
        estimate.point,
        problem.focal_px,
        estimate.squares,
    )
    prior_residuals(estimate.rotation, estimate.direction, problem.prior, estimate.known)
    total = 0.0
    for i in range(estimate.squares.shape[0]):
        total += np.log1p(estimate.squares[i] / problem.scale_px**2)
    total *= (problem.scale_px / problem.sigma_px) ** 2
    for i in range(5):
        total += estimate.known[i] ** 2
    return total


@compiled
def _linearise(problem: _Problem, estimate: _Estimate, iteration: int) -> None:
    r, t, point, squares = estimate.rotation, estimate.direction, estimate.point, estimate.squares
    previous, current, focal_px = problem.previous, problem.current, problem.focal_px
    sigma_px, scale_px, basis = problem.sigma_px, problem.scale_px, problem.basis
    motion, motion_right, mixed = problem.motion, problem.motion_right, problem.mixed
    own, own_right = problem.own, problem.own_right
    problem.history[iteration] = squares.sum() / max(previous.shape[0], 1)
    basis[:] = tangent_basis(t)
    motion[:] = 0.0
    motion_right[:] = 0.0
    row_m, row_p = np.empty((2, 5)), np.empty((2, 3))
    d = np.empty((3, 5))
    for i in range(previous.shape[0]):
        weight = 1.0 / ((1.0 + squares[i] / scale_px**2) * sigma_px**2)
        a, b, rho = point[i, 0], point[i, 1], point[i, 2]
        v0, v1, v2 = a - rho * t[0], b - rho * t[1], 1.0 - rho * t[2]
        z = max(1e-3, r[0, 2] * v0 + r[1, 2] * v1 + r[2, 2] * v2)
        x = (r[0, 0] * v0 + r[1, 0] * v1 + r[2, 0] * v2) / z
        y = (r[0, 1] * v0 + r[1, 1] * v1 + r[2, 1] * v2) / z
        # derivatives of R'(m - rho t): by rotation R'[v]x, by direction -rho R' basis
        for k in range(3):
            d[k, 0] = r[1, k] * v2 - r[2, k] * v1
            d[k, 1] = r[2, k] * v0 - r[0, k] * v2
            d[k, 2] = r[0, k] * v1 - r[1, k] * v0
            for j in range(2):
                d[k, 3 + j] = -rho * (
                    r[0, k] * basis[j, 0] + r[1, k] * basis[j, 1] + r[2, k] * basis[j, 2]
                )
        fu, fv = focal_px[0] / z, focal_px[1] / z
        for k in range(5):
            row_m[0, k] = fu * (d[0, k] - x * d[2, k])
            row_m[1, k] = fv * (d[1, k] - y * d[2, k])
        for k in range(2):
            row_p[0, k] = fu * (r[k, 0] - x * r[k, 2])
            row_p[1, k] = fv * (r[k, 1] - y * r[k, 2])
        t0 = r[0, 0] * t[0] + r[1, 0] * t[1] + r[2, 0] * t[2]
        t1 = r[0, 1] * t[0] + r[1, 1] * t[1] + r[2, 1] * t[2]
        t2 = r[0, 2] * t[0] + r[1, 2] * t[1] + r[2, 2] * t[2]
        row_p[0, 2] = -fu * (t0 - x * t2)
        row_p[1, 2] = -fv * (t1 - y * t2)
        g0, g1 = focal_px[0] * (x - current[i, 0]), focal_px[1] * (y - current[i, 1])
        for k in range(5):
            motion_right[k] -= weight * (row_m[0, k] * g0 + row_m[1, k] * g1)
            for j in range(k + 1):
                motion[k, j] += weight * (row_m[0, k] * row_m[0, j] + row_m[1, k] * row_m[1, j])
            for j in range(3):
                mixed[i, k, j] = weight * (row_m[0, k] * row_p[0, j] + row_m[1, k] * row_p[1, j])
        for k in range(3):
            own_right[i, k] = -weight * (row_p[0, k] * g0 + row_p[1, k] * g1)
            for j in range(3):
                own[i, k, j] = weight * (row_p[0, k] * row_p[0, j] + row_p[1, k] * row_p[1, j])
        own_right[i, 0] -= weight * focal_px[0] ** 2 * (a - previous[i, 0])
        own_right[i, 1] -= weight * focal_px[1] ** 2 * (b - previous[i, 1])
        own[i, 0, 0] += weight * focal_px[0] ** 2
        own[i, 1, 1] += weight * focal_px[1] ** 2
    prior_jacobian(r, t, basis, problem.prior, estimate.known, problem.terms)
    add_prior(estimate.known, problem.terms, motion, motion_right)


@compiled
def _reduce(problem: _Problem, damping: float) -> None:
    # Schur complement of the points: (5, 5), lower half.
    motion, mixed, inverses = problem.motion, problem.mixed, problem.inverses
    own_right, reduced, right = problem.own_right, problem.reduced, problem.step
    for k in range(5):
        right[k] = problem.motion_right[k]
        for j in range(k + 1):
            reduced[k, j] = motion[k, j]
        reduced[k, k] += damping * motion[k, k] + FLOOR
    y = np.empty(3)
    for i in range(mixed.shape[0]):
        invert_symmetric(problem.own[i], damping, FLOOR, inverses[i])
        for k in range(5):
            for j in range(3):
                y[j] = (
                    mixed[i, k, 0] * inverses[i, 0, j]
                    + mixed[i, k, 1] * inverses[i, 1, j]
                    + mixed[i, k, 2] * inverses[i, 2, j]
                )
            right[k] -= y[0] * own_right[i, 0] + y[1] * own_right[i, 1] + y[2] * own_right[i, 2]
            for j in range(k + 1):
                reduced[k, j] -= (
                    y[0] * mixed[i, j, 0] + y[1] * mixed[i, j, 1] + y[2] * mixed[i, j, 2]
                )


@compiled
def _solve(problem: _Problem, estimate: _Estimate, damping: float, trial: _Estimate) -> bool:
    _reduce(problem, damping)
    step, mixed, inverses = problem.step, problem.mixed, problem.inverses
    if not cholesky_solve(problem.reduced, step, 5):
        return False
    updated_pose(
        estimate.rotation, estimate.direction, problem.basis, step, trial.rotation, trial.direction
    )
    rest = np.empty(3)
    for i in range(mixed.shape[0]):
        for k in range(3):
            rest[k] = problem.own_right[i, k]
            for j in range(5):
                rest[k] -= mixed[i, j, k] * step[j]
        for k in range(3):
            trial.point[i, k] = estimate.point[i, k] + (
                inverses[i, k, 0] * rest[0]
                + inverses[i, k, 1] * rest[1]
                + inverses[i, k, 2] * rest[2]
            )
    return True


_minimise = minimiser(_evaluate, _linearise, _solve)


@compiled
def _adjust(
    previous: Array,
    current: Array,
    rotation: Array,
    direction: Array,
    prior: RelativePosePrior,
    focal_px: Array,
    sigma_px: float,
    scale_px: float,
    schedule: Schedule,
    history: Array,
    covariance: Array,
) -> tuple[_Estimate, float, int]:
    n = previous.shape[0]
    problem = _Problem(
        previous, current, prior, prior_terms(), focal_px, sigma_px, scale_px, history,
        np.empty((2, 3)), np.empty((5, 5)), np.empty(5), np.empty((n, 5, 3)), np.empty((n, 3, 3)),
        np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((5, 5)), np.empty(5),
    )  # fmt: skip
    start = _Estimate(rotation, direction, np.empty((n, 3)), np.empty(n), np.empty(5))
    trial = _Estimate(np.empty((3, 3)), np.empty(3), np.empty((n, 3)), np.empty(n), np.empty(5))
    _first_points(previous, current, rotation, direction, start.point)
    best, cost, done = _minimise(problem, start, trial, schedule)
    _linearise(problem, best, done)
    for k in range(5):
        _reduce(problem, 0.0)
        problem.step[:] = 0.0
        problem.step[k] = 1.0
        if cholesky_solve(problem.reduced, problem.step, 5):
            covariance[k] = problem.step
        else:
            covariance[k] = np.nan
    return best, cost, done
