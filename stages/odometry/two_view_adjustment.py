"""Two-view bundle adjustment with the baseline held (report chapter 8).

The report's unknowns are the second camera's centre on the sphere of the known baseline, its rotation, and the points.
The cost is the sum of the residuals of eq. 7.5, here robust and with what is known of the motion beforehand;
Levenberg-Marquardt, the points eliminated by the Schur complement. Points are two coordinates of their ray in the first
picture and an inverse depth, so that far ones do no harm. With an inverse depth in units of the baseline the length of
the baseline drops out; it only scales the result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.stages.geometry import cholesky_solve, tangent_basis
from wayside.stages.kernels import Array, compiled, require_array
from wayside.stages.odometry.epipolar import (
    DIFFERENCE_STEP,
    RelativePosePrior,
    prior_residuals,
    updated_pose,
)


class TwoViewAdjustment(NamedTuple):
    """Result of `adjust_two_views`.

    rotation (3, 3), direction (3,): pose of the second camera in the first one's frame, but for the length;
    point (n, 3): ray (x/z, y/z) in the first picture, and baseline over depth; squares (n,): eq. 7.5 of each point, px
    squared; covariance (5, 5) of the rotation vector (rad, first camera's axes) and of the direction along
    `numerics.rotation.across` (rad), points eliminated; cost and iterations;
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
    """Adjust motion and points together to the rays of two pictures.

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
        Standard deviation of a good coordinate.
    scale_px
        Root of eq. 7.5 where the Cauchy cost of a point starts to flatten.
    iterations
        At most this many.

    Returns
    -------
    Adjusted
        covariance is nan where the normal equations are singular (no points and no prior).
    """
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    rotation = np.array(start[0], np.float64).reshape(3, 3)
    direction = np.array(start[1], np.float64).reshape(3)
    point, squares, covariance = np.empty((n, 3)), np.empty(n), np.empty((5, 5))
    history = np.empty(iterations + 1)
    cost, steps = _adjust(
        previous,
        current,
        rotation,
        direction,
        prior.checked(),
        np.array(focal_px, np.float64),
        sigma_px,
        scale_px,
        iterations,
        point,
        squares,
        covariance,
        history,
    )
    made = (float(cost), int(steps), history[: steps + 1])
    return TwoViewAdjustment(rotation, direction, point, squares, covariance, *made)


@compiled
def _first_points(
    previous: Array, current: Array, rotation: Array, direction: Array, point: Array
) -> None:
    # Inverse depth that brings the ray of the first picture nearest to that of the second one.
    t = np.dot(rotation.T, direction)
    v = np.empty(3)
    for i in range(previous.shape[0]):
        for k in range(3):
            v[k] = (
                rotation[0, k] * previous[i, 0] + rotation[1, k] * previous[i, 1] + rotation[2, k]
            )
        # (v - rho t) parallel to q: cross both with q and solve the least squares for rho
        x, y = current[i, 0], current[i, 1]
        a0, a1 = v[1] - v[2] * y, v[2] * x - v[0]
        b0, b1 = t[1] - t[2] * y, t[2] * x - t[0]
        square = b0 * b0 + b1 * b1
        point[i, 0], point[i, 1] = previous[i, 0], previous[i, 1]
        rho = (a0 * b0 + a1 * b1) / square if square > 1e-12 else 0.0
        # in front of the second camera, not far behind infinity
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
def _total(squares: Array, known: Array, sigma_px: float, scale_px: float) -> float:
    total = 0.0
    for i in range(squares.shape[0]):
        total += np.log1p(squares[i] / scale_px**2)
    total *= (scale_px / sigma_px) ** 2
    for i in range(5):
        total += known[i] ** 2
    return total


@compiled
def _linearise(
    previous: Array,
    current: Array,
    rotation: Array,
    direction: Array,
    basis: Array,
    point: Array,
    squares: Array,
    focal_px: Array,
    sigma_px: float,
    scale_px: float,
    motion: Array,
    motion_right: Array,
    mixed: Array,
    own: Array,
    own_right: Array,
) -> None:
    # Normal equations in blocks: motion (5, 5), mixed (n, 5, 3), own of each point (n, 3, 3), and right sides.
    r, t = rotation, direction
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


@compiled
def _inverse(own: Array, damping: float, result: Array) -> None:
    a, b, c = own[0, 0] * (1 + damping) + 1e-9, own[0, 1], own[0, 2]
    d, e, f = own[1, 1] * (1 + damping) + 1e-9, own[1, 2], own[2, 2] * (1 + damping) + 1e-9
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    q = 1.0 / (a * m0 + b * m1 + c * m2)
    result[0, 0], result[0, 1], result[0, 2] = m0 * q, m1 * q, m2 * q
    result[1, 0], result[1, 1], result[1, 2] = m1 * q, (a * f - c * c) * q, (b * c - a * e) * q
    result[2, 0], result[2, 1], result[2, 2] = m2 * q, (b * c - a * e) * q, (a * d - b * b) * q


@compiled
def _reduce(
    motion: Array,
    motion_right: Array,
    mixed: Array,
    own: Array,
    own_right: Array,
    damping: float,
    inverses: Array,
    reduced: Array,
    right: Array,
) -> None:
    # Schur complement of the points: (5, 5), lower half.
    for k in range(5):
        right[k] = motion_right[k]
        for j in range(k + 1):
            reduced[k, j] = motion[k, j]
        reduced[k, k] += damping * motion[k, k] + 1e-9
    y = np.empty(3)
    for i in range(mixed.shape[0]):
        _inverse(own[i], damping, inverses[i])
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
def _add_prior(known: Array, slopes: Array, motion: Array, right: Array) -> None:
    for k in range(5):
        for i in range(5):
            right[k] -= slopes[k, i] * known[i]
            for j in range(k + 1):
                motion[k, j] += slopes[k, i] * slopes[j, i]


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
    iterations: int,
    point: Array,
    squares: Array,
    covariance: Array,
    history: Array,
) -> tuple[float, int]:
    n = previous.shape[0]
    motion, motion_right = np.empty((5, 5)), np.empty(5)
    mixed, own, own_right = np.empty((n, 5, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    inverses, reduced, step = np.empty((n, 3, 3)), np.empty((5, 5)), np.empty(5)
    known, slopes, single = np.empty(5), np.empty((5, 5)), np.empty(5)
    trial_r, trial_t = np.empty((3, 3)), np.empty(3)
    trial_p, trial_squares, trial_known = np.empty((n, 3)), np.empty(n), np.empty(5)

    _first_points(previous, current, rotation, direction, point)
    _squares(previous, current, rotation, direction, point, focal_px, squares)
    prior_residuals(rotation, direction, prior, known)
    cost = _total(squares, known, sigma_px, scale_px)
    history[0] = squares.sum() / max(n, 1)
    damping, done, settled = 1e-3, 0, False
    while True:
        basis = tangent_basis(direction)
        for k in range(5):
            single[:] = 0.0
            single[k] = DIFFERENCE_STEP
            updated_pose(rotation, direction, basis, single, trial_r, trial_t)
            prior_residuals(trial_r, trial_t, prior, slopes[k])
            for i in range(5):
                slopes[k, i] = (slopes[k, i] - known[i]) / DIFFERENCE_STEP
        _linearise(
            previous,
            current,
            rotation,
            direction,
            basis,
            point,
            squares,
            focal_px,
            sigma_px,
            scale_px,
            motion,
            motion_right,
            mixed,
            own,
            own_right,
        )
        _add_prior(known, slopes, motion, motion_right)
        if settled or done >= iterations:
            break
        done += 1
        settled, gain = True, 0.0
        for _ in range(8):
            _reduce(motion, motion_right, mixed, own, own_right, damping, inverses, reduced, step)
            if cholesky_solve(reduced, step, 5):
                updated_pose(rotation, direction, basis, step, trial_r, trial_t)
                for i in range(n):
                    for k in range(3):
                        single[k] = own_right[i, k]
                        for j in range(5):
                            single[k] -= mixed[i, j, k] * step[j]
                    for k in range(3):
                        trial_p[i, k] = point[i, k] + (
                            inverses[i, k, 0] * single[0]
                            + inverses[i, k, 1] * single[1]
                            + inverses[i, k, 2] * single[2]
                        )
                _squares(previous, current, trial_r, trial_t, trial_p, focal_px, trial_squares)
                prior_residuals(trial_r, trial_t, prior, trial_known)
                trial_cost = _total(trial_squares, trial_known, sigma_px, scale_px)
                if trial_cost < cost:
                    settled, gain = False, cost - trial_cost
                    break
            damping *= 10.0
        if settled:
            history[done] = history[done - 1]
            continue
        rotation[:] = trial_r
        direction[:] = trial_t
        point[:] = trial_p
        squares[:] = trial_squares
        known[:] = trial_known
        cost = trial_cost
        history[done] = squares.sum() / max(n, 1)
        damping = max(1e-9, damping * 0.1)
        settled = gain < 1e-7 * cost
    # Covariance: inverse of the reduced equations of the last linearisation, without damping.
    for k in range(5):
        _reduce(motion, motion_right, mixed, own, own_right, 0.0, inverses, reduced, step)
        step[:] = 0.0
        step[k] = 1.0
        if cholesky_solve(reduced, step, 5):
            covariance[k] = step
        else:
            covariance[k] = np.nan
    return cost, done
