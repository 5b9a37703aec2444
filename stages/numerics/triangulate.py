"""Points in space from rays: the report's midpoint (chapter 7) and all views together (chapter 8)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.numerics.compiled import Array, compiled
from wayside.stages.numerics.rotation import cholesky_solve

SMALLEST_SINE = 1e-6
"""Rays that meet at a smaller angle (as sine) count as parallel."""
CAUCHY = 2.385
"""Gaps beyond this many sigmas lose most of their weight (95 % efficiency on clean data)."""


class Midpoints(NamedTuple):
    """Midpoints of ray pairs.

    point (n, 3), nan where the rays are parallel; gap (n,): length of the shortest join, same unit; along (n, 2):
    distance of its ends along the two rays (times the ray's length), not positive where the point lies behind.
    """

    point: Array
    gap: Array
    along: Array

    @property
    def ahead(self) -> NDArray[np.bool_]:
        """Points (n,) that exist and lie ahead of both cameras."""
        return np.asarray((self.along > 0).all(axis=1))


def midpoint(
    c0: NDArray[np.floating[Any]],
    c1: NDArray[np.floating[Any]],
    d0: NDArray[np.floating[Any]],
    d1: NDArray[np.floating[Any]],
) -> Midpoints:
    """Middle of the shortest segment between two rays (report eqs. 7.1 to 7.4).

    Parameters
    ----------
    c0, c1
        Camera centres, (3,).
    d0, d1
        Directions of the rays in the same frame, (n, 3), of any length.

    Returns
    -------
    Midpoints
        nan where the rays are parallel (q1 x q2 = 0: at the focus of expansion, or without a baseline they meet at
        the common centre).

    Raises
    ------
    ValueError
        Where the shapes do not fit.
    """
    first, second = _shaped(d0, (-1, 3)), _shaped(d1, (-1, 3))
    if len(first) != len(second):
        raise ValueError(f"wanted as many rays of both views, found {len(first)} and {len(second)}")
    point, along = np.empty_like(first), np.empty((len(first), 2))
    gap = np.empty(len(first))
    _midpoint(_shaped(c0, (3,)), _shaped(c1, (3,)), first, second, point, gap, along)
    return Midpoints(point, gap, along)


def pair_residual(
    previous: NDArray[np.floating[Any]],
    current: NDArray[np.floating[Any]],
    rotation: NDArray[np.floating[Any]],
    direction: NDArray[np.floating[Any]],
    focal_px: tuple[float, float],
) -> Array:
    """Sum of the four squared pixel differences of each midpoint's projections (report eqs. 7.5, 7.6).

    Parameters
    ----------
    previous, current
        Rays (n, 2) as (x/z, y/z) of both pictures.
    rotation, direction
        Current camera in the previous one's frame: axes (3, 3) and centre (3,), of any length.
    focal_px
        fx, fy. The report's single f takes centred, undistorted pixels for granted.

    Returns
    -------
    Array
        (n,) px squared. Where the rays do not meet ahead of both cameras the point is taken at infinity, the best place
        that is left, with its gap shared by both pictures.
    """
    first, second = np.asarray(previous, np.float64), np.asarray(current, np.float64)
    ones, turn = np.ones((len(first), 1)), np.asarray(rotation, np.float64)
    rays = np.hstack([first, ones]), np.hstack([second, ones]) @ turn.T
    found = midpoint(np.zeros(3), direction, *rays)
    local = (found.point - direction) @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        gaps = np.hstack(
            [
                found.point[:, :2] / found.point[:, 2:] - first,
                local[:, :2] / local[:, 2:] - second,
            ]
        )
        far = rays[0] @ turn
        apart = far[:, :2] / far[:, 2:] - second
    near = found.ahead & (found.point[:, 2] > 0) & (local[:, 2] > 0)
    squares = ((gaps * (*focal_px, *focal_px)) ** 2).sum(axis=1)
    distant = 0.5 * ((apart * focal_px) ** 2).sum(axis=1)
    return np.asarray(np.where(near, squares, distant))


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
    turns, origins = _shaped(rotations, (-1, 3, 3)), _shaped(centres, (-1, 3))
    seen, spread = _shaped(rays, (-1, 2)), _shaped(sigma, (-1,))
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
    turns, origins = _shaped(rotations, (-1, 3, 3)), _shaped(centres, (-1, 3))
    seen, spread = _shaped(rays, (-1, 2)), _shaped(sigma, (-1,))
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


def _shaped(array: NDArray[Any], shape: tuple[int, ...]) -> Array:
    # The kernels do not check bounds: every array passes here first.
    result = np.ascontiguousarray(array, np.float64)
    fits = result.ndim == len(shape) and all(
        want in (-1, have) for want, have in zip(shape, result.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"wanted an array of shape {shape} (-1: any), found {result.shape}")
    return result


def _refuse_idle_sigma(sigma: Array) -> None:
    if not (sigma > 0).all():
        raise ValueError(f"wanted positive sigmas, found {sigma.min()}")


@compiled
def _midpoint(
    c0: Array, c1: Array, d0: Array, d1: Array, point: Array, gap: Array, along: Array
) -> None:
    b = c1 - c0
    for i in range(d0.shape[0]):
        p, q = d0[i], d1[i]
        # (7.1) q3 = q1 x q2, at right angles to both rays
        n0 = p[1] * q[2] - p[2] * q[1]
        n1 = p[2] * q[0] - p[0] * q[2]
        n2 = p[0] * q[1] - p[1] * q[0]
        square = n0 * n0 + n1 * n1 + n2 * n2
        pp = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
        qq = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
        if not square > SMALLEST_SINE * SMALLEST_SINE * pp * qq:
            point[i] = np.nan
            along[i] = np.nan
            gap[i] = np.nan
            continue
        # (7.2), (7.3) C1 + g1 q1 + g3 q3 = C2 + g2 q2, solved by Cramer's rule
        g1 = (
            (b[1] * q[2] - b[2] * q[1]) * n0
            + (b[2] * q[0] - b[0] * q[2]) * n1
            + (b[0] * q[1] - b[1] * q[0]) * n2
        ) / square
        g2 = (
            (b[1] * p[2] - b[2] * p[1]) * n0
            + (b[2] * p[0] - b[0] * p[2]) * n1
            + (b[0] * p[1] - b[1] * p[0]) * n2
        ) / square
        g3 = (b[0] * n0 + b[1] * n1 + b[2] * n2) / square
        # (7.4) f = C1 + g1 q1 + (g3 / 2) q3
        point[i, 0] = c0[0] + g1 * p[0] + 0.5 * g3 * n0
        point[i, 1] = c0[1] + g1 * p[1] + 0.5 * g3 * n1
        point[i, 2] = c0[2] + g1 * p[2] + 0.5 * g3 * n2
        gap[i] = abs(g3) * np.sqrt(square)
        along[i, 0] = g1 * np.sqrt(pp)
        along[i, 1] = g2 * np.sqrt(qq)


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
            _midpoint(
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
