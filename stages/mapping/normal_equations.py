"""Normal equations of a window of frames: in blocks, reduced to the poses, and what they say of one point.

Points have to do with few frames each and with no other point, so their blocks are inverted by themselves and taken out
of the equations of the poses (Schur complement; Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import cholesky_solve
from wayside.stages.kernels import Array, compiled
from wayside.stages.mapping.residuals import (
    PointAnchors,
    ResidualBlocks,
    StepConstraints,
    block_jacobian,
    constraint_jacobian,
)

LEAST = 1e-9
"""Added to every diagonal: a point or frame that nothing holds stays where it is."""


class NormalEquations(NamedTuple):
    """Normal equations in blocks: poses (6 n, 6 n), lower half, mixed (p, n, 6, 3), own (p, 3, 3), and right sides."""

    poses: Array
    poses_right: Array
    mixed: Array
    own: Array
    own_right: Array
    inverse: Array
    span: NDArray[np.int64]


@compiled
def point_spans(rows: ResidualBlocks, span: NDArray[np.int64]) -> None:
    """First and last frame that each point has to do with, (p, 2); of a point without rows the last is -1."""
    span[:, 0], span[:, 1] = 1 << 30, -1
    for i in range(rows.point.shape[0]):
        n = rows.point[i]
        span[n, 0] = min(span[n, 0], min(rows.frames[i, 0], rows.frames[i, 1]))
        span[n, 1] = max(span[n, 1], max(rows.frames[i, 0], rows.frames[i, 1]))


@compiled
def _add_pair(
    normal: NormalEquations, frames: Array, held: int, slopes: Array, gaps: Array, weight: float
) -> None:
    # Adds the pose part of some residuals (r, 12) of two frames.
    for x in range(1 if frames[0] == frames[1] else 0, 2):  # a sight has one frame
        if frames[x] == held:
            continue
        for k in range(6):
            row = 6 * frames[x] + k
            for r in range(slopes.shape[0]):
                normal.poses_right[row] -= weight * slopes[r, 6 * x + k] * gaps[r]
            for y in range(2):
                if frames[y] == held or frames[y] > frames[x] or (y < x and frames[y] == frames[x]):
                    continue
                for j in range(6):
                    total = 0.0
                    for r in range(slopes.shape[0]):
                        total += slopes[r, 6 * x + k] * slopes[r, 6 * y + j]
                    normal.poses[row, 6 * frames[y] + j] += weight * total


@compiled
def linearise(
    rotations: Array,
    centres: Array,
    held: int,
    charts: PointAnchors,
    points: Array,
    rows: ResidualBlocks,
    links: StepConstraints,
    gaps: Array,
    known: Array,
    normal: NormalEquations,
) -> None:
    """Fill the normal equations by the residuals `gaps` (m, 2) and `known` (l, 6); `held` is the frame that stays."""
    normal.poses[:] = 0.0
    normal.poses_right[:] = 0.0
    normal.mixed[:] = 0.0
    normal.own[:] = 0.0
    normal.own_right[:] = 0.0
    slopes, by_point, linked = np.empty((2, 12)), np.empty((2, 3)), np.empty((6, 12))
    work = np.empty((2, 2, 9))
    for i in range(rows.point.shape[0]):
        n = rows.point[i]
        square = gaps[i, 0] ** 2 + gaps[i, 1] ** 2
        weight = 1.0 / (1.0 + square / rows.scale[i] ** 2)
        block_jacobian(rotations, centres, charts, points, rows, i, work, slopes, by_point)
        _add_pair(normal, rows.frames[i], held, slopes, gaps[i], weight)
        for k in range(3):
            a, b = weight * by_point[0, k], weight * by_point[1, k]
            normal.own_right[n, k] -= a * gaps[i, 0] + b * gaps[i, 1]
            for j in range(3):
                normal.own[n, k, j] += a * by_point[0, j] + b * by_point[1, j]
            for x in range(2):
                frame = rows.frames[i, x]
                if frame != held:
                    for j in range(6):
                        normal.mixed[n, frame, j, k] += (
                            a * slopes[0, 6 * x + j] + b * slopes[1, 6 * x + j]
                        )
    for i in range(links.frames.shape[0]):
        constraint_jacobian(rotations, centres, links, i, linked)
        _add_pair(normal, links.frames[i], held, linked, known[i], 1.0)
    for k in range(6):  # the held frame has an equation of its own: it stays
        normal.poses[6 * held + k, 6 * held + k] = 1.0


@compiled
def _invert(own: Array, damping: float, result: Array) -> None:
    a, b, c = own[0, 0] * (1 + damping) + LEAST, own[0, 1], own[0, 2]
    d, e = own[1, 1] * (1 + damping) + LEAST, own[1, 2]
    f = own[2, 2] * (1 + damping) + LEAST
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    q = 1.0 / (a * m0 + b * m1 + c * m2)
    result[0, 0], result[0, 1], result[0, 2] = m0 * q, m1 * q, m2 * q
    result[1, 0], result[1, 1], result[1, 2] = m1 * q, (a * f - c * c) * q, (b * c - a * e) * q
    result[2, 0], result[2, 1], result[2, 2] = m2 * q, (b * c - a * e) * q, (a * d - b * b) * q


@compiled
def reduce_points(normal: NormalEquations, damping: float, reduced: Array, right: Array) -> None:
    """Schur complement of the points: (6 n, 6 n), lower half, and its right side; leaves the points' inverses."""
    size = right.shape[0]
    for k in range(size):
        right[k] = normal.poses_right[k]
        for j in range(k + 1):
            reduced[k, j] = normal.poses[k, j]
        reduced[k, k] += damping * normal.poses[k, k] + LEAST
    y = np.empty(3)
    for n in range(normal.own.shape[0]):
        first, last = normal.span[n, 0], normal.span[n, 1]
        if last < 0:
            continue
        inverse = normal.inverse[n]
        _invert(normal.own[n], damping, inverse)
        for f in range(first, last + 1):
            for k in range(6):
                mixed = normal.mixed[n, f, k]
                for j in range(3):
                    y[j] = (
                        mixed[0] * inverse[0, j]
                        + mixed[1] * inverse[1, j]
                        + mixed[2] * inverse[2, j]
                    )
                row = 6 * f + k
                own = normal.own_right[n]
                right[row] -= y[0] * own[0] + y[1] * own[1] + y[2] * own[2]
                for g in range(first, f + 1):
                    for j in range(6):
                        other = normal.mixed[n, g, j]
                        reduced[row, 6 * g + j] -= (
                            y[0] * other[0] + y[1] * other[1] + y[2] * other[2]
                        )


@compiled
def point_uncertainty(
    rotations: Array,
    centres: Array,
    held: int,
    charts: PointAnchors,
    points: Array,
    rows: ResidualBlocks,
    wanted: int,
    gaps: Array,
    normal: NormalEquations,
    reduced: Array,
    step: Array,
    covariance: Array,
    gain: Array,
) -> None:
    """Block (3, 3) of one point in the inverse of the normal equations, and how rows move it, (m, 2, 3)."""
    size = step.shape[0]
    spread = np.zeros((size, 3))  # of the poses against the point: S^-1 E V^-1
    reach = np.zeros((size, 3))
    reduce_points(normal, 0.0, reduced, step)
    own = normal.inverse[wanted]
    for row in range(size):
        for k in range(3):
            for j in range(3):
                reach[row, k] += normal.mixed[wanted, row // 6, row % 6, j] * own[j, k]
    for k in range(3):
        if k > 0:
            reduce_points(normal, 0.0, reduced, step)
        step[:] = reach[:, k]
        if not cholesky_solve(reduced, step, size):
            return
        spread[:, k] = step
    for k in range(3):
        for j in range(3):
            covariance[k, j] = own[k, j]
            for row in range(size):
                covariance[k, j] += reach[row, k] * spread[row, j]
    slopes, by_point, felt = np.empty((2, 12)), np.empty((2, 3)), np.empty((3, 3))
    work = np.empty((2, 2, 9))
    back = np.zeros((points.shape[0], 3, 3))
    for n in range(points.shape[0]):
        if normal.span[n, 1] < 0:
            continue
        felt[:] = 0.0
        for f in range(normal.span[n, 0], normal.span[n, 1] + 1):
            for j in range(6):
                for k in range(3):
                    for i in range(3):
                        felt[k, i] += spread[6 * f + j, k] * normal.mixed[n, f, j, i]
        for k in range(3):
            for j in range(3):
                for i in range(3):
                    back[n, k, j] += felt[k, i] * normal.inverse[n, i, j]
    for i in range(rows.point.shape[0]):
        n = rows.point[i]
        weight = gaps[i, 0] ** 2 + gaps[i, 1] ** 2
        weight = 1.0 / (1.0 + weight / rows.scale[i] ** 2) / rows.sigma[i]
        block_jacobian(rotations, centres, charts, points, rows, i, work, slopes, by_point)
        for r in range(2):
            for k in range(3):
                total = 0.0
                for x in range(2):
                    if rows.frames[i, x] != held:
                        for j in range(6):
                            total -= spread[6 * rows.frames[i, x] + j, k] * slopes[r, 6 * x + j]
                for j in range(3):
                    total += back[n, k, j] * by_point[r, j]
                    if n == wanted:
                        total += own[k, j] * by_point[r, j]
                gain[i, r, k] = weight * total
