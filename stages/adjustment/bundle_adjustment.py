"""Bundle adjustment of a window of frames (report chapter 8, for more than two images).

Unknown are the poses of all frames but one, which is held fixed (the gauge), and the points. Measured are the residual
blocks of the points; constraints state what is known of each step beforehand, above all its length, which gives the
scale. The cost is the sum of squares in sigmas, with a Cauchy cost for the blocks. Points are eliminated by the Schur
complement: each is a block of its own. An iteration is linear in the number of blocks, with one Cholesky solution for
the poses.

With a quadratic cost seven iterations do. Weights of a robust cost change with the residuals, so convergence is linear:
each iteration leaves about six tenths of what the cost is above its minimum.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.adjustment.normal_equations import (
    NormalEquations,
    add_blocks,
    reduce_points,
    uncertainty,
)
from wayside.stages.adjustment.residuals import (
    PointAnchors,
    ResidualBlocks,
    StepConstraints,
    WindowEstimate,
    constraint_jacobian,
    constraint_residuals,
    linearise_blocks,
    move_poses,
    require_rows,
)
from wayside.stages.geometry import Schedule, cholesky_solve, minimiser
from wayside.stages.kernels import Array, require_array

WINDOW_ITERATIONS = 15
"""Most iterations of a window: leaves a position .003 sigmas off the minimum (median; .16 in 95 %)."""


class WindowAdjustment(NamedTuple):
    """Result of `adjust_window`.

    `rotations` (n, 3, 3), `centres` (n, 3): poses, that of the held frame as given. `points` (p, 3): coordinates in
    their anchors. `squares` (m,): of each block, in sigmas. `cost`. `history` (iterations + 1,): sum
    of the squares at the start and after each iteration. `position` (3,): of the first point, in the axes of the poses.
    `covariance` (3, 3) of it is taken from the inverse of the normal equations. `gain` (m, 2, 3) has its derivatives by
    the targets of the blocks, in units of their rays.
    """

    rotations: Array
    centres: Array
    points: Array
    squares: Array
    cost: float
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

    def checked(self) -> "Window":
        """The same; ValueError where compiled code would read outside of an array."""
        n, p = len(self.rotations), len(self.points)
        require_array(self.rotations, "rotations", np.float64, (n, 3, 3))
        require_array(self.centres, "centres", np.float64, (n, 3))
        require_array(self.points, "points", np.float64, (p, 3))
        require_array(self.anchors, "anchors", np.int64, (p,))
        numbers = np.append(self.anchors, self.held)
        if numbers.min() < 0 or numbers.max() >= n or p == 0:
            raise ValueError(
                f"held {self.held} and anchors {self.anchors.min(initial=0)} to {self.anchors.max(initial=0)} must be "
                f"below {n} frames, and there must be a point ({p})"
            )
        return self


def adjust_window(
    window: Window,
    blocks: ResidualBlocks,
    constraints: StepConstraints,
    *,
    iterations: int,
    gain: float,
) -> WindowAdjustment:
    """Adjust poses and points together.

    Covariance and gain are nan where the normal equations cannot be solved, and very large where nothing measures the
    point. `iterations`: at most. `gain`: an iteration that lowers the cost by a smaller fraction is the last.

    Raises ValueError where an array has another shape or type, or a number refers to no frame or point.
    """
    rotations, centres, held, points, anchors = window.checked()
    n, p, m = len(rotations), len(points), len(blocks.point)
    require_rows(blocks, frames=n, point=p)
    require_rows(constraints, frames=n)
    origins = PointAnchors(rotations[anchors], centres[anchors])
    start, trial = (
        WindowEstimate(
            *(rotations.copy(), centres.copy(), points.copy(), np.empty((m, 2))),
            *(np.empty((len(constraints.frames), 6)), np.zeros((m, 2, 12)), np.empty((m, 2, 3))),
        )
        for _ in range(2)
    )
    history, normal = np.empty(iterations + 1), NormalEquations.empty(n, p)
    # Once: the steps to the minimum are too short to change it (by .0003 sigmas of a position at most).
    jacobian = np.empty((6 * len(constraints.frames), 6 * n))
    constraint_jacobian((rotations, centres), constraints, jacobian)
    jacobian[:, 6 * held : 6 * held + 6] = 0.0
    known = jacobian.T @ jacobian
    for k in range(6 * held, 6 * held + 6):
        known[k, k] = 1.0  # equations of its own, by which the held frame stays
    problem = _Problem(held, origins, blocks, constraints, history, jacobian, known, normal)
    schedule = Schedule(iterations, gain, damping=1e-4, least_damping=1e-10)
    best, cost, done = _minimise(problem, start, trial, schedule)
    _linearise(problem, best, done)
    covariance, slopes = uncertainty(normal, best, blocks)
    a, b, rho = best.points[0]
    ray = origins.rotation[0] @ np.array([a, b, 1.0])
    by_point = np.column_stack([origins.rotation[0][:, :2], -ray / rho]) / rho
    return WindowAdjustment(
        *best[:3],
        (best.residuals**2).sum(axis=1),
        float(cost),
        history[: done + 1],
        origins.centre[0] + ray / rho,
        by_point @ covariance @ by_point.T,
        (slopes.reshape(-1, 3) @ by_point.T).reshape(m, 2, 3),
    )


class _Problem(NamedTuple):
    """What is measured and known of a window, which frame is held, and its normal equations.

    `jacobian` (6 l, 6 n), `known` (6 n, 6 n): of the constraints, and their normal equations.
    """

    held: int
    anchors: PointAnchors
    blocks: ResidualBlocks
    constraints: StepConstraints
    history: Array
    jacobian: Array
    known: Array
    normal: NormalEquations


def _evaluate(problem: _Problem, estimate: WindowEstimate) -> float:
    cost = linearise_blocks(estimate, problem.anchors, problem.blocks)
    known = estimate.step_residuals
    constraint_residuals(estimate.rotations, estimate.centres, problem.constraints, known)
    return cost + float(np.vdot(known, known))


def _linearise(problem: _Problem, estimate: WindowEstimate, iteration: int) -> None:
    """Fill the normal equations at an estimate, and the sum of its squares in the history."""
    normal, known = problem.normal, estimate.step_residuals
    problem.history[iteration] = np.vdot(estimate.residuals, estimate.residuals)
    normal.poses[:] = problem.known
    np.matmul(-known.ravel(), problem.jacobian, out=normal.poses_right)
    for part in (normal.mixed, normal.own, normal.own_right):
        part.fill(0.0)
    add_blocks(normal, estimate, problem.blocks, problem.held)


def _solve(
    problem: _Problem, estimate: WindowEstimate, damping: float, trial: WindowEstimate
) -> bool:
    normal, step = problem.normal, problem.normal.step
    reduce_points(normal, damping)
    if not cholesky_solve(normal.reduced, step):
        return False
    move_poses(step, estimate[:2], trial[:2])
    rest = normal.own_right - normal.mixed @ step
    np.add(estimate.points, np.einsum("pij,pj->pi", normal.inverse, rest), out=trial.points)
    return True


_minimise = minimiser(_evaluate, _linearise, _solve, plain=True)
