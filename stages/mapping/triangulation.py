"""Points in space from all their views (report chapter 8), started from the midpoint of two of them (chapter 7)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import Schedule, cholesky_solve, meet_rays, minimiser
from wayside.stages.kernels import Array, compiled, shaped

CAUCHY_SIGMAS = 2.385
"""Residual where a Cauchy cost starts to flatten: 95 % efficiency on normal errors (Holland and Welsch 1977)."""
POINT_ITERATIONS = 30
"""Of the triangulation of a point at most."""
POINT_GAIN = 1e-12
"""Triangulation ends where an iteration lowers the cost by a smaller fraction."""


class _Problem(NamedTuple):
    """Views of a point, their sigmas (n,), and normal equations (3, 3); cauchy: sigmas where the cost flattens.

    fit (2,): weighted chi square and the sum of the weights.
    """

    rotations: Array
    centres: Array
    rays: Array
    sigma: Array
    cauchy: float
    matrix: Array
    damped: Array
    right: Array
    step: Array
    fit: Array


class _Estimate(NamedTuple):
    """Point (3,) in the world and its residuals (n, 2), unit of the rays."""

    point: Array
    residuals: Array


def triangulate_views(
    rotations: NDArray[np.floating[Any]],
    centres: NDArray[np.floating[Any]],
    rays: NDArray[np.floating[Any]],
    sigma: NDArray[np.floating[Any]],
    iterations: int = POINT_ITERATIONS,
) -> tuple[Array, Array]:
    """Point with the lowest robust reprojection cost over all views.

    The start is the midpoint of the pair of views with the lowest cost over all views. Levenberg-Marquardt follows on
    the residuals with a Cauchy cost, which bounds the influence of a wrong view.

    Parameters
    ----------
    rotations
        World from camera, (n, 3, 3).
    centres
        Camera centres in the world, (n, 3), metres.
    rays
        Ideal image coordinates (x/z, y/z), (n, 2).
    sigma
        Standard deviation of the rays per coordinate, (n,), same unit as the rays.
    iterations
        After the midpoint, at most.

    Returns
    -------
    point
        (3,) in the world; nan where there are fewer than two views, or all rays are parallel.
    covariance
        (3, 3), square metres; scaled up where the residuals are larger than the sigmas, never down.

    Raises
    ------
    ValueError
        Where shapes do not fit or a sigma is not positive.
    """
    turns, origins = shaped(rotations, (-1, 3, 3)), shaped(centres, (-1, 3))
    seen, spread = shaped(rays, (-1, 2)), shaped(sigma, (-1,))
    if not len(turns) == len(origins) == len(seen) == len(spread):
        raise ValueError(
            f"rotations, centres, rays and sigmas differ in number: {len(turns)}, {len(origins)}, {len(seen)}, "
            f"{len(spread)}"
        )
    if not (spread > 0).all():
        raise ValueError(f"a sigma is not positive: {spread.min()}")
    point, covariance = np.full(3, np.nan), np.full((3, 3), np.nan)
    schedule = Schedule(iterations, POINT_GAIN, damping=1e-4, offset=1.0)
    _triangulate(turns, origins, seen, spread, CAUCHY_SIGMAS, schedule, point, covariance)
    return point, covariance


@compiled
def _evaluate(problem: _Problem, estimate: _Estimate) -> float:
    # Residuals are projection less ray; inf where the point lies behind the camera, which adds a large constant.
    point, residuals, total = estimate.point, estimate.residuals, 0.0
    for k in range(residuals.shape[0]):
        r, centre, ray = problem.rotations[k], problem.centres[k], problem.rays[k]
        a, b, c = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
        z = r[0, 2] * a + r[1, 2] * b + r[2, 2] * c
        if z > 1e-6:
            residuals[k, 0] = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / z - ray[0]
            residuals[k, 1] = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / z - ray[1]
        else:
            residuals[k] = np.inf
        square = residuals[k, 0] ** 2 + residuals[k, 1] ** 2
        total += np.log1p(min(square / (problem.sigma[k] * problem.cauchy) ** 2, 1e12))
    return total


@compiled
def _start(problem: _Problem, estimate: _Estimate, best: Array) -> bool:
    # The midpoint of the pair of views that has the lowest cost over all views; False where no pair meets.
    rotations, rays, centres = problem.rotations, problem.rays, problem.centres
    n = rotations.shape[0]
    directions = np.empty((n, 3))
    for k in range(n):
        for i in range(3):
            r = rotations[k, i]
            directions[k, i] = r[0] * rays[k, 0] + r[1] * rays[k, 1] + r[2]
    point, gap, along = np.empty((1, 3)), np.empty(1), np.empty((1, 2))
    lowest, found = np.inf, False
    for i in range(n):
        for j in range(i + 1, n):
            first, second = directions[i : i + 1], directions[j : j + 1]
            meet_rays(centres[i], centres[j], first, second, point, gap, along)
            if not np.isfinite(gap[0]):
                continue
            estimate.point[:] = point[0]
            cost = _evaluate(problem, estimate)
            if cost < lowest:
                lowest, found = cost, True
                best[:] = point[0]
    return found


@compiled
def _linearise(problem: _Problem, estimate: _Estimate, iteration: int) -> None:
    # Weighted J'J and -J'r, weighted chi square and the sum of weights.
    point, residuals, sigma = estimate.point, estimate.residuals, problem.sigma
    centres, matrix, right = problem.centres, problem.matrix, problem.right
    matrix[:] = 0.0
    right[:] = 0.0
    problem.fit[:] = 0.0
    row = np.empty((2, 3))
    for k in range(residuals.shape[0]):
        if not np.isfinite(residuals[k, 0]):
            continue
        r = problem.rotations[k]
        a, b, c = point[0] - centres[k, 0], point[1] - centres[k, 1], point[2] - centres[k, 2]
        z = r[0, 2] * a + r[1, 2] * b + r[2, 2] * c
        u = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / z
        v = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / z
        for i in range(3):
            row[0, i] = (r[i, 0] - u * r[i, 2]) / z
            row[1, i] = (r[i, 1] - v * r[i, 2]) / z
        square = (residuals[k, 0] ** 2 + residuals[k, 1] ** 2) / sigma[k] ** 2
        robust = 1.0 / (1.0 + square / problem.cauchy**2)
        problem.fit[0] += robust * square
        problem.fit[1] += robust
        weight = robust / sigma[k] ** 2
        for i in range(3):
            right[i] -= weight * (row[0, i] * residuals[k, 0] + row[1, i] * residuals[k, 1])
            for j in range(3):
                matrix[i, j] += weight * (row[0, i] * row[0, j] + row[1, i] * row[1, j])


@compiled
def _solve(problem: _Problem, estimate: _Estimate, damping: float, trial: _Estimate) -> bool:
    problem.damped[:] = problem.matrix
    for i in range(3):
        problem.damped[i, i] *= 1.0 + damping
    problem.step[:] = problem.right
    solved = cholesky_solve(problem.damped, problem.step)
    trial.point[:] = estimate.point + problem.step
    return solved


_minimise = minimiser(_evaluate, _linearise, _solve)


@compiled
def _triangulate(
    rotations: Array,
    centres: Array,
    rays: Array,
    sigma: Array,
    cauchy: float,
    schedule: Schedule,
    point: Array,
    covariance: Array,
) -> None:
    n = rotations.shape[0]
    start = _Estimate(np.empty(3), np.empty((n, 2)))
    trial = _Estimate(np.empty(3), np.empty((n, 2)))
    problem = _Problem(
        rotations, centres, rays, sigma, cauchy,
        np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(2),
    )  # fmt: skip
    if not _start(problem, trial, start.point):
        return
    best, _, _ = _minimise(problem, start, trial, schedule)
    _linearise(problem, best, 0)
    # 2 n measurements less 3 unknowns, each view counted by its weight
    freedom = 2.0 * problem.fit[1] - 3.0
    inflation = max(1.0, problem.fit[0] / freedom) if freedom > 0 else 1.0
    point[:] = best.point
    for i in range(3):
        problem.damped[:] = problem.matrix
        problem.step[:] = 0.0
        problem.step[i] = 1.0
        if cholesky_solve(problem.damped, problem.step):
            covariance[i] = problem.step * inflation
