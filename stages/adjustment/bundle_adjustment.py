"""Bundle adjustment of a window of frames (report chapter 8, for more than two images).

Unknown are the poses of all frames but one, which is held fixed (the gauge), and the points. Measured are the residual
blocks of the points; constraints state what is known of each step beforehand, above all its length, which gives the
scale. The cost is the sum of squares in sigmas, with a Cauchy cost for the blocks. Points are eliminated by the Schur
complement: each is a block of its own. An iteration is linear in the number of blocks, with one Cholesky solution for
the poses.

With a quadratic cost seven iterations do. Weights of a robust cost change with the residuals, so convergence is linear:
each iteration leaves about six tenths of what the cost is above its minimum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.adjustment.normal_equations import (
    NormalEquations,
    WindowEstimate,
    WindowProblem,
    linearise,
    point_spans,
    reduce_points,
    uncertainty,
)
from wayside.stages.adjustment.residuals import (
    PointAnchors,
    ResidualBlocks,
    StepConstraints,
    block_residuals,
    constraint_residuals,
)
from wayside.stages.geometry import Schedule, cholesky_solve, minimiser, rotation_from_vector
from wayside.stages.kernels import Array, compiled, require_array

WINDOW_ITERATIONS = 15
"""Of a window at most: leaves a position .003 sigmas off the minimum (median; .16 in 95 %)."""


class WindowAdjustment(NamedTuple):
    """Result of `adjust_window`.

    `rotations` (n, 3, 3), `centres` (n, 3): poses, that of the held frame as given. `points` (p, 3): coordinates in
    their anchors. `squares` (m,): of each block, in sigmas. `cost` and `iterations`. `history` (iterations + 1,): sum
    of the squares at the start and after each iteration. `covariance` (k, k) is taken from the inverse of the normal
    equations. `gain` (m, 2, k) has its derivatives by the targets of the blocks, in units of their rays. For a point k
    = 3: its position (3,) in the axes of the poses. For a pose k = 6: rotation vector (rad) and centre, in the axes of
    the poses. `position` is the centre.
    """

    rotations: Array
    centres: Array
    points: Array
    squares: Array
    cost: float
    iterations: int
    history: Array
    position: Array
    covariance: Array
    gain: Array


class Window(NamedTuple):
    """Frames and points to start from.

    `rotations` (n, 3, 3), `centres` (n, 3), m: world from camera. `held`: the frame whose pose is fixed. `points`
    (p, 3): ray (x/z, y/z) and one over the depth in the anchor's frame. `anchors` (p,): that frame, at its pose here.
    """

    rotations: Array
    centres: Array
    held: int
    points: Array
    anchors: NDArray[np.int64]

    def checked(self, pose: int | None) -> Window:
        """The same; ValueError where compiled code would read outside of an array."""
        n, p = len(self.rotations), len(self.points)
        require_array(self.rotations, "rotations", np.float64, (n, 3, 3))
        require_array(self.centres, "centres", np.float64, (n, 3))
        require_array(self.points, "points", np.float64, (p, 3))
        require_array(self.anchors, "anchors", np.int64, (p,))
        numbers = np.array([self.held, *([] if pose is None else [pose]), *self.anchors])
        if numbers.min() < 0 or numbers.max() >= n or (pose is None and p == 0):
            raise ValueError(
                f"held {self.held}, pose {pose} and anchors {self.anchors.min(initial=0)} to "
                f"{self.anchors.max(initial=0)} must be below {n} frames, and there must be a point ({p}) or a pose"
            )
        return self


def adjust_window(
    window: Window,
    blocks: ResidualBlocks,
    constraints: StepConstraints,
    *,
    pose: int | None = None,
    iterations: int,
    gain: float,
) -> WindowAdjustment:
    """Adjust poses and points together.

    Parameters
    ----------
    window
        Poses and points to start from.
    blocks
        Residuals of the points in the images.
    constraints
        What is known of the steps.
    pose
        The frame whose pose the covariance and gain are asked of; None: the first point's.
    iterations, gain
        At most so many; ended where one lowers the cost by a smaller fraction.

    Covariance and gain are nan where the normal equations cannot be solved, very large where nothing measures what
    is asked for.

    Raises
    ------
    ValueError
        Where an array has another shape or type, or a number refers to no frame or point.
    """
    rotations, centres, held, points, anchors = window.checked(pose)
    n, p = len(rotations), len(points)
    blocks, constraints = blocks.checked(n, p), constraints.checked(n)
    origins = PointAnchors(rotations[anchors].copy(), centres[anchors].copy())
    m, steps = len(blocks.point), len(constraints.frames)
    start, trial = (
        WindowEstimate(
            rotations.copy(), centres.copy(), points.copy(), np.empty((m, 2)), np.empty((steps, 6))
        )
        for _ in range(2)
    )
    history, normal = np.empty(iterations + 1), NormalEquations.empty(n, p, m)
    problem = WindowProblem(held, origins, blocks, constraints, history, normal)
    schedule = Schedule(iterations, gain, damping=1e-4, least_damping=1e-10)
    best, cost, done = _adjust(problem, start, trial, schedule)
    covariance, slopes = uncertainty(problem, best, pose)
    if pose is not None:
        position = best.centres[pose]
    else:
        a, b, rho = best.points[0]
        ray = origins.rotation[0] @ np.array([a, b, 1.0])
        position = origins.centre[0] + ray / rho
        by_point = np.column_stack([origins.rotation[0][:, :2], -ray / rho]) / rho
        covariance, slopes = by_point @ covariance @ by_point.T, slopes @ by_point.T
    return WindowAdjustment(
        best.rotations,
        best.centres,
        best.points,
        (best.residuals**2).sum(axis=1),
        float(cost),
        int(done),
        history[: done + 1],
        position,
        covariance,
        slopes,
    )


@compiled
def _evaluate(problem: WindowProblem, estimate: WindowEstimate) -> float:
    rotations, centres, scale = estimate.rotations, estimate.centres, problem.blocks.scale
    residuals, known = estimate.residuals, estimate.step_residuals
    block_residuals(rotations, centres, problem.anchors, estimate.points, problem.blocks, residuals)
    constraint_residuals(rotations, centres, problem.constraints, known)
    total = 0.0
    for i in range(residuals.shape[0]):
        square = residuals[i, 0] ** 2 + residuals[i, 1] ** 2
        total += scale[i] ** 2 * np.log1p(square / scale[i] ** 2)
    for i in range(known.shape[0]):
        for k in range(6):
            total += known[i, k] ** 2
    return total


@compiled
def _solve(
    problem: WindowProblem, estimate: WindowEstimate, damping: float, trial: WindowEstimate
) -> bool:
    normal, step = problem.normal, problem.normal.step
    reduce_points(normal, damping)
    if not cholesky_solve(normal.reduced, step):
        return False
    for f in range(estimate.rotations.shape[0]):
        move = step[6 * f : 6 * f + 6]
        trial.rotations[f] = np.dot(rotation_from_vector(move[:3]), estimate.rotations[f])
        trial.centres[f] = estimate.centres[f] + move[3:]
    rest = np.empty(3)
    for n in range(estimate.points.shape[0]):
        rest[:] = normal.own_right[n]
        for f in range(normal.span[n, 0], normal.span[n, 1] + 1):
            for j in range(6):
                for k in range(3):
                    rest[k] -= normal.mixed[n, f, j, k] * step[6 * f + j]
        for k in range(3):
            own = normal.inverse[n, k]
            gained = own[0] * rest[0] + own[1] * rest[1] + own[2] * rest[2]
            trial.points[n, k] = estimate.points[n, k] + gained
    return True


_minimise = minimiser(_evaluate, linearise, _solve)


@compiled
def _adjust(
    problem: WindowProblem, start: WindowEstimate, trial: WindowEstimate, schedule: Schedule
) -> tuple[WindowEstimate, float, int]:
    point_spans(problem.blocks, problem.held, problem.normal.span)
    best, cost, done = _minimise(problem, start, trial, schedule)
    linearise(problem, best, done)
    return best, cost, done
