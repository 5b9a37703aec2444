"""Motion and points of two images adjusted together, with the length of the baseline held (report chapter 8).

Each point is measured in these two images only, so the adjustment eliminates it. To first order, the Sampson distance
is what remains of the errors of a tie. Motion alone is unknown; the points follow from it. Only the prior measures the
length of the step; inverse depths are in units of it.
"""

from typing import NamedTuple

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment import (
    TIE_ERRORS,
    WINDOW_ITERATIONS,
    TieErrors,
    correlated_covariance,
    correlated_sigma_px,
    tie_scatter,
)
from wayside.stages.geometry import Schedule, cross_matrices, tangent_basis
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import fit_epipolar

FIT = Schedule(WINDOW_ITERATIONS, gain=1e-4)
"""Of every fit to ties: it ends .01 sigmas off the minimum."""
FINE_LAST_SCALE_PX = 2.385 * TIE_ERRORS.sigma_px
"""Cauchy scale of the last fine fit, and of the adjustment: of normal errors it uses 95 % of what they tell (Holland
and Welsch 1977)."""
LEAST_SLOPE = 1e-12
"""Least square of a length that is divided by: at the focus of expansion it is zero."""
UNMEASURED = 1e-9
"""Added to the diagonal of the normal equations: what nothing measures has a very large variance."""


class PairAdjustment(NamedTuple):
    """Result of `adjust_pair`.

    `rotation` (3, 3), `direction` (3,): pose of the second camera in the first one's frame, up to its length. `points`
    (n, 3): ray (x/z, y/z) in the first image, and baseline over depth. `displacement_px` (n,): of each tie in the image
    by travel alone. `covariance` (6, 6) of rotation vector (rad) and direction in the first camera's axes, errors that
    neighbouring ties share included. `scatter`: errors of the ties over those stated (`tie_scatter`), by which it is
    enlarged. `history_px` (k + 1,): RMS of eq. 7.5 per coordinate at the start and after each of k iterations.
    """

    rotation: Array
    direction: Array
    points: Array
    displacement_px: Array
    covariance: Array
    scatter: float
    history_px: Array

    def step_covariance(self, baseline_m: float, sigma_m: float) -> Array:
        """Covariance (6, 6) of rotation vector and translation (m), by the length of the step and its sigma."""
        along = np.outer(self.direction, self.direction)
        spread = np.eye(6)
        spread[3:, 3:] = baseline_m * (np.eye(3) - along)
        covariance = spread @ self.covariance @ spread.T
        covariance[3:, 3:] += sigma_m**2 * along
        return np.asarray(covariance)


def adjust_pair(
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: StepPrior,
    *,
    focal_px: float,
    errors: TieErrors = TIE_ERRORS,
    scale_px: float = FINE_LAST_SCALE_PX,
    schedule: Schedule = FIT,
) -> PairAdjustment:
    """Adjust motion and points together to the rays of two images.

    `previous`, `current`: rays (n, 2) as (x/z, y/z), of the same points. `start`: rotation (3, 3), unit direction (3,).
    `focal_px`: pixels of one unit of the rays. `scale_px`: of the robust cost.

    Raises ValueError where an array has another shape or type.
    """
    rotation, direction, distance_px, jacobian, history = fit_epipolar(
        previous,
        current,
        start,
        prior,
        focal_px=focal_px,
        sigma_px=errors.sigma_px,
        scales_px=(scale_px,),
        schedule=schedule,
    )
    n, essential = len(previous), cross_matrices(direction) @ rotation
    first, second = (np.column_stack([rays, np.ones(n)]) for rays in (previous, current))
    slope = np.hstack([second @ essential[:2].T, first @ essential[:, :2]])
    slope /= np.sqrt(np.maximum((slope**2).sum(axis=1), LEAST_SLOPE))[:, None]
    # The point of a tie lies where the rays meet that are nearest to those measured.
    moves = (distance_px / focal_px)[:, None] * slope
    first[:, :2] -= moves[:, :2]
    nearest = current - moves[:, 2:]
    far, toward = first @ rotation, direction @ rotation
    across, moved = toward[:2] - nearest * toward[2], far[:, :2] - nearest * far[:, 2:]
    inverse_depth = (across * moved).sum(axis=1) / np.maximum((across**2).sum(axis=1), LEAST_SLOPE)
    offset = first[:, :2] - direction[:2] / direction[2]
    displacement = focal_px * np.maximum(inverse_depth, 0) * np.linalg.norm(offset, axis=1)
    # rotation vector and direction by the unknowns, and by each tie's distance
    unknowns = np.zeros((6, 5))
    unknowns[:3, :3], unknowns[3:, 3:] = np.eye(3), tangent_basis(direction).T
    weight = 1 / ((1 + (distance_px / scale_px) ** 2) * errors.sigma_px**2)
    weighted = jacobian * np.append(weight, np.ones(6))
    spread = unknowns @ np.linalg.inv(weighted @ jacobian.T + UNMEASURED * np.eye(5))
    by_tie = (spread @ weighted[:, :n]).T
    scatter = tie_scatter(distance_px, errors.sigma_px)
    # Weights use the stated errors: larger ones change the stated covariance, not the motion.
    alone = np.sqrt(scatter**2 - 1) * errors.sigma_px * by_tie
    shared_px = scatter * correlated_sigma_px(displacement, errors)
    effect = (shared_px[:, None] * slope[:, 2:])[:, :, None] * by_tie[:, None]
    shared = correlated_covariance(
        current * focal_px, np.zeros(n, np.int64), effect, errors.reach_px
    )
    return PairAdjustment(
        rotation,
        direction,
        np.column_stack([first[:, :2], inverse_depth]),
        displacement,
        spread @ unknowns.T + alone.T @ alone + shared,
        scatter,
        np.sqrt(history / (4 * max(n, 1))),
    )
