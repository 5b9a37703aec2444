"""Normal equations of a window of frames, in blocks, reduced to the poses; covariance and gain of one point.

Each point is measured in few frames and with no other point. Its block is inverted separately and eliminated from the
equations of the poses (Schur complement; Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.adjustment.residuals import (
    PointAnchors,
    ResidualBlocks,
    StepConstraints,
    block_jacobian,
    constraint_jacobian,
)
from wayside.stages.geometry import cholesky_solve, invert_symmetric
from wayside.stages.kernels import Array, compiled

FLOOR = 1e-9
"""Added to every diagonal: a point or frame without measurements stays where it is."""


class NormalEquations(NamedTuple):
    """Normal equations in blocks: poses (6 n, 6 n), lower half, mixed (p, n, 6, 3), own (p, 3, 3), and right sides."""

    poses: Array
    poses_right: Array
    mixed: Array
    own: Array
    own_right: Array
    inverse: Array
    span: NDArray[np.int64]


class WindowProblem(NamedTuple):
    """What is measured and known of a window, which frame is held, and its normal equations with work arrays."""

    held: int
    anchors: PointAnchors
    blocks: ResidualBlocks
    constraints: StepConstraints
    history: Array
    normal: NormalEquations
    reduced: Array
    step: Array


class WindowEstimate(NamedTuple):
    """Poses, points, residuals of the blocks (m, 2) and of the constraints (l, 6)."""

    rotations: Array
    centres: Array
    points: Array
    residuals: Array
    step_residuals: Array


@compiled
def point_spans(blocks: ResidualBlocks, held: int, span: NDArray[np.int64]) -> None:
    """First and last frame that measures each point, (p, 2), the held one aside; without any the last is -1."""
    span[:, 0], span[:, 1] = 1 << 30, -1
    for i in range(blocks.point.shape[0]):
        n = blocks.point[i]
        for x in range(2):
            frame = blocks.frames[i, x]
            if frame != held:
                span[n, 0] = min(span[n, 0], frame)
                span[n, 1] = max(span[n, 1], frame)


@compiled
def _add_pair(
    normal: NormalEquations,
    frames: Array,
    held: int,
    jacobian: Array,
    residuals: Array,
    weight: float,
) -> None:
    # Adds the pose part of some residuals (r, 12) of two frames.
    for x in range(1 if frames[0] == frames[1] else 0, 2):  # an observation has one frame
        if frames[x] == held:
            continue
        for k in range(6):
            row = 6 * frames[x] + k
            for r in range(jacobian.shape[0]):
                normal.poses_right[row] -= weight * jacobian[r, 6 * x + k] * residuals[r]
            for y in range(2):
                if frames[y] == held or frames[y] > frames[x] or (y < x and frames[y] == frames[x]):
                    continue
                for j in range(6):
                    total = 0.0
                    for r in range(jacobian.shape[0]):
                        total += jacobian[r, 6 * x + k] * jacobian[r, 6 * y + j]
                    normal.poses[row, 6 * frames[y] + j] += weight * total


@compiled
def linearise(problem: WindowProblem, estimate: WindowEstimate, iteration: int) -> None:
    """Fill the normal equations at an estimate, and the sum of its squares in the history."""
    rotations, centres, points = estimate.rotations, estimate.centres, estimate.points
    residuals, known, held = estimate.residuals, estimate.step_residuals, problem.held
    blocks, constraints, normal = problem.blocks, problem.constraints, problem.normal
    problem.history[iteration] = (residuals**2).sum()
    normal.poses[:] = 0.0
    normal.poses_right[:] = 0.0
    normal.mixed[:] = 0.0
    normal.own[:] = 0.0
    normal.own_right[:] = 0.0
    jacobian, point_jacobian, work = np.empty((2, 12)), np.empty((2, 3)), np.empty((2, 2, 9))
    for i in range(blocks.point.shape[0]):
        n = blocks.point[i]
        square = residuals[i, 0] ** 2 + residuals[i, 1] ** 2
        weight = 1.0 / (1.0 + square / blocks.scale[i] ** 2)
        block_jacobian(
            rotations, centres, problem.anchors, points, blocks, i, work, jacobian, point_jacobian
        )
        _add_pair(normal, blocks.frames[i], held, jacobian, residuals[i], weight)
        for k in range(3):
            a, b = weight * point_jacobian[0, k], weight * point_jacobian[1, k]
            normal.own_right[n, k] -= a * residuals[i, 0] + b * residuals[i, 1]
            for j in range(3):
                normal.own[n, k, j] += a * point_jacobian[0, j] + b * point_jacobian[1, j]
            for x in range(2):
                frame = blocks.frames[i, x]
                if frame != held:
                    for j in range(6):
                        normal.mixed[n, frame, j, k] += (
                            a * jacobian[0, 6 * x + j] + b * jacobian[1, 6 * x + j]
                        )
    step_jacobian = np.empty((6, 12))
    for i in range(constraints.frames.shape[0]):
        constraint_jacobian(rotations, centres, constraints, i, step_jacobian)
        _add_pair(normal, constraints.frames[i], held, step_jacobian, known[i], 1.0)
    for k in range(6):  # the held frame has equations of its own, by which it stays
        normal.poses[6 * held + k, 6 * held + k] = 1.0


@compiled
def reduce_points(normal: NormalEquations, damping: float, reduced: Array, right: Array) -> None:
    """Schur complement of the points: (6 n, 6 n), lower half, and its right side; fills the inverses of the points."""
    size = right.shape[0]
    for k in range(size):
        right[k] = normal.poses_right[k]
        for j in range(k + 1):
            reduced[k, j] = normal.poses[k, j]
        reduced[k, k] += damping * normal.poses[k, k] + FLOOR
    y = np.empty(3)
    for n in range(normal.own.shape[0]):
        first, last = normal.span[n, 0], normal.span[n, 1]
        inverse = normal.inverse[n]
        invert_symmetric(normal.own[n], damping, FLOOR, inverse)
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
def uncertainty(
    problem: WindowProblem,
    estimate: WindowEstimate,
    wanted: int,
    of_pose: bool,
    covariance: Array,
    gain: Array,
) -> None:
    """Block (k, k) of a point (k = 3) or of a pose (k = 6) in the inverse of the normal equations; gain (m, 2, k).

    The gain is the derivative by the targets of the blocks. Both stay as they are where there is no inverse.
    """
    normal, blocks, residuals = problem.normal, problem.blocks, estimate.residuals
    reduced, step = problem.reduced, problem.step
    size, count = step.shape[0], covariance.shape[0]
    reach = np.zeros((size, count))  # change of the reduced right side by what is wanted, negative
    spread = np.zeros((size, count))  # covariance of the poses with it
    own = np.zeros((count, 3))
    reduce_points(normal, 0.0, reduced, step)
    if of_pose:
        for k in range(6):
            reach[6 * wanted + k, k] = -1.0
    else:
        own[:] = normal.inverse[wanted]
        for row in range(size):
            for k in range(3):
                for j in range(3):
                    reach[row, k] += normal.mixed[wanted, row // 6, row % 6, j] * own[j, k]
    factor = np.empty((size, size))
    for k in range(count):
        factor[:] = reduced
        step[:] = reach[:, k]
        if not cholesky_solve(factor, step):
            return
        spread[:, k] = step
    for k in range(count):
        for j in range(count):
            covariance[k, j] = 0.0 if of_pose else own[k, j]
            for row in range(size):
                covariance[k, j] += reach[row, k] * spread[row, j]
    jacobian, point_jacobian = np.empty((2, 12)), np.empty((2, 3))
    product, work = np.empty((count, 3)), np.empty((2, 2, 9))
    back = np.zeros((normal.own.shape[0], count, 3))
    for n in range(normal.own.shape[0]):
        product[:] = 0.0
        for f in range(normal.span[n, 0], normal.span[n, 1] + 1):
            for j in range(6):
                for k in range(count):
                    for i in range(3):
                        product[k, i] += spread[6 * f + j, k] * normal.mixed[n, f, j, i]
        for k in range(count):
            for j in range(3):
                for i in range(3):
                    back[n, k, j] += product[k, i] * normal.inverse[n, i, j]
    for i in range(blocks.point.shape[0]):
        n = blocks.point[i]
        weight = residuals[i, 0] ** 2 + residuals[i, 1] ** 2
        weight = 1.0 / (1.0 + weight / blocks.scale[i] ** 2) / blocks.sigma[i]
        block_jacobian(
            estimate.rotations, estimate.centres, problem.anchors, estimate.points, blocks, i, work,
            jacobian, point_jacobian,
        )  # fmt: skip
        for r in range(2):
            for k in range(count):
                total = 0.0
                for x in range(2):
                    if blocks.frames[i, x] != problem.held:
                        for j in range(6):
                            total -= spread[6 * blocks.frames[i, x] + j, k] * jacobian[r, 6 * x + j]
                for j in range(3):
                    total += back[n, k, j] * point_jacobian[r, j]
                    if n == wanted and not of_pose:
                        total += own[k, j] * point_jacobian[r, j]
                gain[i, r, k] = weight * total
