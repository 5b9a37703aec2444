"""Points in space from all their views (report chapter 8), started from the midpoint of two of them (chapter 7)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import invert_symmetric, meet_rays
from wayside.stages.kernels import Array, compiled, compiled_within, shaped

CAUCHY_SIGMAS = 2.385
"""Residual where a Cauchy cost starts to flatten: 95 % efficiency on normal errors (Holland and Welsch 1977)."""
POINT_ITERATIONS = 30
"""Of the triangulation of a point at most."""
POINT_GAIN = 1e-12
"""Triangulation ends where an iteration lowers the cost by a smaller fraction."""
HALVINGS = 10
"""A step that raises the cost is halved so many times at most."""


class Views(NamedTuple):
    """World from camera (m, 3, 3), camera centres (m, 3); camera (n,) of the rays (n, 2), and their sigma (n,)."""

    rotations: Array
    centres: Array
    camera: NDArray[np.int64]
    rays: Array
    sigma: Array


class _Normal(NamedTuple):
    """Normal equations of a point, (3, 3) and (3,); fit (2,): weighted chi square and the sum of the weights."""

    matrix: Array
    right: Array
    fit: Array


def triangulate_views(
    rotations: Array, centres: Array, rays: Array, sigma: Array
) -> tuple[Array, Array]:
    """Point with the lowest robust reprojection cost over all views.

    The start is the midpoint of the pair of views with the lowest cost over all views. Gauss-Newton follows on the
    residuals with a Cauchy cost, which bounds the influence of a wrong view.

    `rotations` (n, 3, 3), `centres` (n, 3): world from camera, metres. `rays` (n, 2), `sigma` (n,): ideal image
    coordinates (x/z, y/z), and their standard deviation per coordinate, same unit.

    Returns the point (3,) in the world and its covariance (3, 3), square metres. Both are nan with fewer than two views
    or parallel rays. The covariance is scaled up where the residuals are larger than the sigmas, never down.

    Raises ValueError where shapes do not fit or a sigma is not positive.
    """
    n = len(rotations)
    sigma = shaped(sigma, (n,))
    if not (sigma > 0).all():
        raise ValueError(f"a sigma is not positive: {sigma.min()}")
    poses = shaped(rotations, (n, 3, 3)), shaped(centres, (n, 3))
    views = Views(*poses, np.arange(n), shaped(rays, (n, 2)), sigma)
    point, covariance = np.empty(3), np.empty((3, 3))
    inflation = solve_point(views, point, covariance)
    return point, covariance * inflation


@compiled
def solve_point(views: Views, point: Array, inverse: Array) -> float:
    """Fill the point and the inverse of its normal equations; returns the factor of the latter by the residuals."""
    normal = _Normal(np.empty((3, 3)), np.empty(3), np.empty(2))
    other, trial = _Normal(np.empty((3, 3)), np.empty(3), np.empty(2)), np.empty(3)
    point[:], inverse[:] = np.nan, np.nan
    cost = _start(views, normal, point)
    if not np.isfinite(cost):
        return 1.0
    _linearise(views, point, normal)
    for _ in range(POINT_ITERATIONS):
        if not invert_symmetric(normal.matrix, 0.0, 0.0, inverse) > 0:
            break
        before, length, right = cost, 1.0, normal.right
        for _ in range(HALVINGS + 1):
            for i in range(3):
                row = inverse[i]
                step = row[0] * right[0] + row[1] * right[1] + row[2] * right[2]
                trial[i] = point[i] + length * step
            cost = _linearise(views, trial, other)
            if cost <= before:
                break
            length /= 2
        if not cost <= before:
            break
        point[0], point[1], point[2] = trial
        normal, other = other, normal
        if before - cost <= POINT_GAIN * before:
            break
    if not invert_symmetric(normal.matrix, 0.0, 0.0, inverse) > 0:
        return np.nan
    # 2 n measurements less 3 unknowns, each view counted by its weight
    freedom = 2.0 * normal.fit[1] - 3.0
    return max(1.0, normal.fit[0] / freedom) if freedom > 0 else 1.0


@compiled_within
def _start(views: Views, normal: _Normal, best: Array) -> float:
    # Fills `best` with the midpoint of two views that has the lowest cost over all views; inf where no two meet.
    n = views.rays.shape[0]
    directions = np.empty((n, 3))
    for k in range(n):
        x, y = views.rays[k]
        for i in range(3):
            r = views.rotations[views.camera[k], i]
            directions[k, i] = r[0] * x + r[1] * y + r[2]
    point, gap, along = np.empty((1, 3)), np.empty(1), np.empty((1, 2))
    lowest = np.inf
    for i in range(n):
        for j in range(i + 1, n):
            first, second = directions[i : i + 1], directions[j : j + 1]
            c0, c1 = views.centres[views.camera[i]], views.centres[views.camera[j]]
            meet_rays(c0, c1, first, second, point, gap, along)
            if not np.isfinite(gap[0]):
                continue
            cost = _linearise(views, point[0], normal)
            if cost < lowest:
                lowest = cost
                best[0], best[1], best[2] = point[0]
    return lowest


@compiled_within
def _linearise(views: Views, point: Array, normal: _Normal) -> float:
    # The cost, and weighted J'J and -J'r. A view whose camera is behind the point adds a large constant.
    matrix, right, fit = normal
    matrix[:] = 0.0
    right[:] = 0.0
    fit[:] = 0.0
    cost, row = 0.0, np.empty((2, 3))
    for k in range(views.rays.shape[0]):
        r, sigma = views.rotations[views.camera[k]], views.sigma[k]
        x, y, z = projected(point, r, views.centres[views.camera[k]])
        if not z > 1e-6:
            cost += np.log1p(1e12)
            continue
        u, v = x - views.rays[k, 0], y - views.rays[k, 1]
        square = (u * u + v * v) / sigma**2
        cost += np.log1p(min(square / CAUCHY_SIGMAS**2, 1e12))
        robust = 1.0 / (1.0 + square / CAUCHY_SIGMAS**2)
        fit[0] += robust * square
        fit[1] += robust
        weight = robust / sigma**2
        for i in range(3):
            row[0, i] = (r[i, 0] - x * r[i, 2]) / z
            row[1, i] = (r[i, 1] - y * r[i, 2]) / z
        for i in range(3):
            right[i] -= weight * (row[0, i] * u + row[1, i] * v)
            for j in range(3):
                matrix[i, j] += weight * (row[0, i] * row[0, j] + row[1, i] * row[1, j])
    return cost


@compiled_within
def projected(point: Array, r: Array, centre: Array) -> tuple[float, float, float]:
    """Ideal image coordinates and depth of a point in a camera of rotation r."""
    a, b, c = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    z = r[0, 2] * a + r[1, 2] * b + r[2, 2] * c
    x = (r[0, 0] * a + r[1, 0] * b + r[2, 0] * c) / z
    y = (r[0, 1] * a + r[1, 1] * b + r[2, 1] * c) / z
    return x, y, z
