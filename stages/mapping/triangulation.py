"""Points in space from all their views together (report chapter 8), started from the midpoint of two (chapter 7)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import cholesky_solve, meet_rays
from wayside.stages.kernels import Array, compiled, shaped

CAUCHY = 2.385
"""Gaps beyond this many sigmas lose most of their weight (95 % efficiency on clean data)."""


def triangulate_views(
    rotations: NDArray[np.floating[Any]],
    centres: NDArray[np.floating[Any]],
    rays: NDArray[np.floating[Any]],
    sigma: NDArray[np.floating[Any]],
) -> tuple[Array, Array, Array]:
    """Point that fits all its views best, weighted and robust.

    The start is the midpoint of that pair of views which explains all of them best; then Levenberg-Marquardt on
    the gaps in the pictures with Cauchy weights, so that one wrong view among several does little harm.

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

    Returns
    -------
    point
        (3,) in the world; nan where there are fewer than two views, or all rays are parallel.
    covariance
        (3, 3), square metres; scaled up where the gaps are larger than the sigmas say, never down.
    residuals
        (n,) length of the gap between ray and point in each picture, unit of the rays; inf where the point lies
        behind the camera.
    """
    turns, origins = shaped(rotations, (-1, 3, 3)), shaped(centres, (-1, 3))
    seen, spread = shaped(rays, (-1, 2)), shaped(sigma, (-1,))
    if not len(turns) == len(origins) == len(seen) == len(spread):
        raise ValueError(
            "wanted as many rotations, centres, rays and sigmas, "
            f"found {len(turns)}, {len(origins)}, {len(seen)}, {len(spread)}"
        )
    _refuse_idle_sigma(spread)
    point, covariance, residuals = np.empty(3), np.empty((3, 3)), np.empty(len(turns))
    _triangulate(turns, origins, seen, spread, point, covariance, residuals)
    return point, covariance, residuals


def triangulate_many(
    first: NDArray[np.integer[Any]],
    rotations: NDArray[np.floating[Any]],
    centres: NDArray[np.floating[Any]],
    rays: NDArray[np.floating[Any]],
    sigma: NDArray[np.floating[Any]],
) -> tuple[Array, Array, Array]:
    """`triangulate_views` for many points in one call.

    Point i has the views `first[i]` to `first[i + 1]` (exclusive) of the other arrays, `first` being (points + 1,).
    Returns points (p, 3), covariances (p, 3, 3) and residuals (views,).
    """
    start = np.ascontiguousarray(first, np.int64)
    turns, origins = shaped(rotations, (-1, 3, 3)), shaped(centres, (-1, 3))
    seen, spread = shaped(rays, (-1, 2)), shaped(sigma, (-1,))
    if not len(turns) == len(origins) == len(seen) == len(spread):
        raise ValueError("wanted as many rotations, centres, rays and sigmas")
    if start.ndim != 1 or len(start) == 0 or start[0] != 0 or start[-1] != len(turns):
        raise ValueError("wanted `first` to run from 0 to the number of views")
    if (np.diff(start) < 0).any():
        raise ValueError("wanted `first` in ascending order")
    _refuse_idle_sigma(spread)
    count = len(start) - 1
    points, covariances = np.empty((count, 3)), np.empty((count, 3, 3))
    residuals = np.empty(len(turns))
    _triangulate_many(start, turns, origins, seen, spread, points, covariances, residuals)
    return points, covariances, residuals


def _refuse_idle_sigma(sigma: Array) -> None:
    if not (sigma > 0).all():
        raise ValueError(f"wanted positive sigmas, found {sigma.min()}")


@compiled
def _gaps(rotations: Array, centres: Array, rays: Array, point: Array, gaps: Array) -> None:
    # gaps (n, 2): projection minus ray; inf where the point lies behind the camera.
    for k in range(rotations.shape[0]):
        r = rotations[k]
        a, b, c = point[0] - centres[k, 0], point[1] - centres[k, 1], point[2] - centres[k, 2]
        z = r[0, 2] * a + r[1, 2] * b + r[2, 2] * c
        if z > 1e-6:
            gaps[k, 0] = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / z - rays[k, 0]
            gaps[k, 1] = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / z - rays[k, 1]
        else:
            gaps[k] = np.inf


@compiled
def _robust_cost(gaps: Array, sigma: Array) -> float:
    total = 0.0
    for k in range(gaps.shape[0]):
        square = (gaps[k, 0] ** 2 + gaps[k, 1] ** 2) / (sigma[k] * CAUCHY) ** 2
        # A view that has the point behind it costs a lot, and the same wherever the point is.
        total += np.log1p(min(square, 1e12))
    return total


@compiled
def _start(
    rotations: Array, centres: Array, rays: Array, sigma: Array, gaps: Array, best: Array
) -> bool:
    # The midpoint of the pair of views that explains all views best; False where no pair meets.
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
            meet_rays(
                centres[i],
                centres[j],
                directions[i : i + 1],
                directions[j : j + 1],
                point,
                gap,
                along,
            )
            if not np.isfinite(gap[0]):
                continue
            _gaps(rotations, centres, rays, point[0], gaps)
            cost = _robust_cost(gaps, sigma)
            if cost < lowest:
                lowest, found = cost, True
                best[:] = point[0]
    return found


@compiled
def _normal_equations(
    rotations: Array,
    centres: Array,
    gaps: Array,
    sigma: Array,
    point: Array,
    matrix: Array,
    right: Array,
) -> tuple[float, float]:
    # Weighted J'J and -J'gap; returns weighted chi square and the sum of weights.
    matrix[:] = 0.0
    right[:] = 0.0
    chi, weights = 0.0, 0.0
    row = np.empty((2, 3))
    for k in range(rotations.shape[0]):
        if not np.isfinite(gaps[k, 0]):
            continue
        r = rotations[k]
        a, b, c = point[0] - centres[k, 0], point[1] - centres[k, 1], point[2] - centres[k, 2]
        z = r[0, 2] * a + r[1, 2] * b + r[2, 2] * c
        u = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / z
        v = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / z
        for i in range(3):
            row[0, i] = (r[i, 0] - u * r[i, 2]) / z
            row[1, i] = (r[i, 1] - v * r[i, 2]) / z
        square = (gaps[k, 0] ** 2 + gaps[k, 1] ** 2) / sigma[k] ** 2
        robust = 1.0 / (1.0 + square / CAUCHY**2)
        chi += robust * square
        weights += robust
        weight = robust / sigma[k] ** 2
        for i in range(3):
            right[i] -= weight * (row[0, i] * gaps[k, 0] + row[1, i] * gaps[k, 1])
            for j in range(3):
                matrix[i, j] += weight * (row[0, i] * row[0, j] + row[1, i] * row[1, j])
    return chi, weights


@compiled
def _triangulate(
    rotations: Array,
    centres: Array,
    rays: Array,
    sigma: Array,
    point: Array,
    covariance: Array,
    residuals: Array,
) -> None:
    n = rotations.shape[0]
    gaps, trial_gaps = np.empty((n, 2)), np.empty((n, 2))
    matrix, damped, right, step = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    if n < 2 or not _start(rotations, centres, rays, sigma, gaps, point):
        point[:] = np.nan
        covariance[:] = np.nan
        residuals[:] = np.nan
        return
    _gaps(rotations, centres, rays, point, gaps)
    cost = _robust_cost(gaps, sigma)
    damping = 1e-4
    for _ in range(30):
        _normal_equations(rotations, centres, gaps, sigma, point, matrix, right)
        better = False
        for _ in range(8):
            damped[:] = matrix
            for i in range(3):
                damped[i, i] *= 1.0 + damping
            step[:] = right
            if cholesky_solve(damped, step, 3):
                trial = point + step
                _gaps(rotations, centres, rays, trial, trial_gaps)
                trial_cost = _robust_cost(trial_gaps, sigma)
                if trial_cost <= cost:
                    better = True
                    break
            damping *= 10.0
        if not better:
            break
        gain = cost - trial_cost
        point[:] = trial
        gaps[:] = trial_gaps
        cost = trial_cost
        damping = max(1e-9, damping * 0.1)
        if gain < 1e-12 * (1.0 + cost):
            break
    chi, weights = _normal_equations(rotations, centres, gaps, sigma, point, matrix, right)
    # 2 n measurements less 3 unknowns, counting each view by its weight
    freedom = 2.0 * weights - 3.0
    inflation = max(1.0, chi / freedom) if freedom > 0 else 1.0
    for i in range(3):
        damped[:] = matrix
        step[:] = 0.0
        step[i] = 1.0
        if cholesky_solve(damped, step, 3):
            covariance[i] = step * inflation
        else:
            covariance[i] = np.nan
    for k in range(n):
        residuals[k] = np.sqrt(gaps[k, 0] ** 2 + gaps[k, 1] ** 2)


@compiled
def _triangulate_many(
    first: NDArray[np.int64],
    rotations: Array,
    centres: Array,
    rays: Array,
    sigma: Array,
    points: Array,
    covariances: Array,
    residuals: Array,
) -> None:
    for i in range(first.shape[0] - 1):
        a, b = first[i], first[i + 1]
        _triangulate(
            rotations[a:b],
            centres[a:b],
            rays[a:b],
            sigma[a:b],
            points[i],
            covariances[i],
            residuals[a:b],
        )
