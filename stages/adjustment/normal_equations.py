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
from wayside.stages.geometry import invert_symmetric
from wayside.stages.kernels import Array, compiled

FLOOR = 1e-9
"""Added to every diagonal: a point or frame without measurements stays where it is."""


class NormalEquations(NamedTuple):
    """Normal equations in blocks: poses (6 n, 6 n), lower half, mixed (p, n, 6, 3), own (p, 3, 3), and right sides.

    `by_pose` (m, 2, 12), `by_point` (m, 2, 3): derivatives of the blocks. `span` (p, 2): frames that measure a point.
    `reduced`, `step`: equations of the poses alone, and their solution.
    """

    poses: Array
    poses_right: Array
    mixed: Array
    own: Array
    own_right: Array
    inverse: Array
    by_pose: Array
    by_point: Array
    span: NDArray[np.int64]
    reduced: Array
    step: Array

    @staticmethod
    def empty(frames: int, points: int, blocks: int) -> NormalEquations:
        """Room for so many."""
        size = 6 * frames
        return NormalEquations(
            poses=np.empty((size, size)),
            poses_right=np.empty(size),
            mixed=np.empty((points, frames, 6, 3)),
            own=np.empty((points, 3, 3)),
            own_right=np.empty((points, 3)),
            inverse=np.empty((points, 3, 3)),
            by_pose=np.empty((blocks, 2, 12)),
            by_point=np.empty((blocks, 2, 3)),
            span=np.empty((points, 2), np.int64),
            reduced=np.empty((size, size)),
            step=np.empty(size),
        )


class WindowProblem(NamedTuple):
    """What is measured and known of a window, which frame is held, and its normal equations."""

    held: int
    anchors: PointAnchors
    blocks: ResidualBlocks
    constraints: StepConstraints
    history: Array
    normal: NormalEquations


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
    work = np.empty((2, 2, 9))
    for i in range(blocks.point.shape[0]):
        n = blocks.point[i]
        square = residuals[i, 0] ** 2 + residuals[i, 1] ** 2
        weight = 1.0 / (1.0 + square / blocks.scale[i] ** 2)
        jacobian, point_jacobian = normal.by_pose[i], normal.by_point[i]
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
def reduce_points(normal: NormalEquations, damping: float) -> None:
    """Schur complement of the points in `reduced`, lower half; its right side in `step`; inverses of the points."""
    reduced, right = normal.reduced, normal.step
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


def uncertainty(
    problem: WindowProblem, estimate: WindowEstimate, pose: int | None
) -> tuple[Array, Array]:
    """Covariance (k, k) of a pose (k = 6) or of the first point (k = 3), and its gain (m, 2, k).

    From the inverse of the normal equations at the estimate; the gain is the derivative by the targets of the blocks.
    Both are nan where there is no inverse.
    """
    normal, count = problem.normal, 3 if pose is None else 6
    gain = np.full((len(problem.blocks.point), 2, count), np.nan)
    reduce_points(normal, 0.0)
    size = len(normal.step)
    if pose is None:
        own = normal.inverse[0]
        reach = (
            normal.mixed[0].reshape(size, 3) @ own
        )  # change of the right side by the point, negative
    else:
        own, reach = np.zeros((6, 3)), -np.eye(size)[:, 6 * pose : 6 * pose + 6]
    try:
        half = np.linalg.inv(np.linalg.cholesky(normal.reduced))
    except np.linalg.LinAlgError:
        return np.full((count, count), np.nan), gain
    spread = np.ascontiguousarray(
        half.T @ (half @ reach)
    )  # covariance of the poses with what is wanted
    back = np.zeros((len(normal.own), count, 3))
    if pose is None:
        back[0] = own
    _add_through_poses(normal, spread, back)
    _gains(problem, estimate.residuals, spread, back, gain)
    return reach.T @ spread + (own if pose is None else 0.0), gain


@compiled
def _add_through_poses(normal: NormalEquations, spread: Array, back: Array) -> None:
    # To the change (p, k, 3) of what is wanted by each point's right side: that through the poses.
    product = np.empty(3)
    for n in range(back.shape[0]):
        for k in range(back.shape[1]):
            product[:] = 0.0
            for f in range(normal.span[n, 0], normal.span[n, 1] + 1):
                for j in range(6):
                    for i in range(3):
                        product[i] += spread[6 * f + j, k] * normal.mixed[n, f, j, i]
            for i in range(3):
                for j in range(3):
                    back[n, k, j] += product[i] * normal.inverse[n, i, j]


@compiled
def _gains(
    problem: WindowProblem, residuals: Array, spread: Array, back: Array, gain: Array
) -> None:
    normal, blocks = problem.normal, problem.blocks
    for i in range(blocks.point.shape[0]):
        n, square = blocks.point[i], residuals[i, 0] ** 2 + residuals[i, 1] ** 2
        weight = 1.0 / ((1.0 + square / blocks.scale[i] ** 2) * blocks.sigma[i])
        for r in range(2):
            by_pose, by_point = normal.by_pose[i, r], normal.by_point[i, r]
            for k in range(spread.shape[1]):
                total = 0.0
                for j in range(3):
                    total += back[n, k, j] * by_point[j]
                for j in range(12):
                    total -= spread[6 * blocks.frames[i, j // 6] + j % 6, k] * by_pose[j]
                gain[i, r, k] = weight * total
