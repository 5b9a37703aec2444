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
        n, p, size = frames, points, 6 * frames
        shapes: list[tuple[int, ...]] = [(size, size), (size,), (p, n, 6, 3), (p, 3, 3), (p, 3)]
        shapes += [(p, 3, 3), (blocks, 2, 12), (blocks, 2, 3)]
        parts = [np.empty(shape) for shape in shapes]
        span = np.empty((p, 2), np.int64)
        return NormalEquations(*parts, span, np.empty((size, size)), np.empty(size))


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
    normal, blocks = problem.normal, problem.blocks
    reduce_points(normal, 0.0)
    points, size = len(normal.own), len(normal.step)
    mixed = normal.mixed.reshape(points, size, 3)
    if pose is None:
        own = normal.inverse[0]
        reach = mixed[0] @ own  # change of the reduced right side by the point, negative
    else:
        own, reach = np.zeros((6, 3)), -np.eye(size)[:, 6 * pose : 6 * pose + 6]
    count = reach.shape[1]
    try:
        half = np.linalg.inv(np.linalg.cholesky(normal.reduced))
    except np.linalg.LinAlgError:
        return np.full((count, count), np.nan), np.full((len(blocks.point), 2, count), np.nan)
    spread = half.T @ (half @ reach)  # covariance of the poses with what is wanted
    covariance = reach.T @ spread
    back = np.einsum("sk,psi->pki", spread, mixed) @ normal.inverse
    if pose is None:
        covariance += own
        back[0] += own
    by_pose = spread.reshape(-1, 6, count)[blocks.frames].reshape(-1, 12, count)
    gain = normal.by_point @ back[blocks.point].transpose(0, 2, 1) - normal.by_pose @ by_pose
    square = (estimate.residuals**2).sum(axis=1)
    weight = 1.0 / ((1.0 + square / blocks.scale**2) * blocks.sigma)
    return covariance, gain * weight[:, None, None]
