"""Motion and points of two images adjusted together, with the length of the baseline held (report chapter 8).

This is the adjustment of a window of two frames. The first one is held, a tie is two observations of one point, and the
length of the step is known. Only the prior measures that length, so inverse depths are in units of the baseline: its
length drops out and only scales the result.
"""

from typing import NamedTuple

import numpy as np

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment import (
    QUADRATIC,
    TIE_ERRORS,
    WINDOW_ITERATIONS,
    ResidualBlocks,
    StepConstraints,
    TieErrors,
    Window,
    adjust_window,
    correlated_covariance,
    correlated_sigma_px,
)
from wayside.stages.geometry import pair_midpoint
from wayside.stages.kernels import Array, require_array

PAIR_GAIN = 1e-4
"""The adjustment ends where an iteration lowers the cost by less: .01 sigmas off the minimum."""
FINE_LAST_SCALE_PX = 0.24
"""Cauchy scale of the last fine fit, and of the adjustment."""
LENGTH_SIGMA = 1e-3
"""Of the baseline, in its own units (numerical): nothing else measures it, and its own scatter is added at the end."""


class PairAdjustment(NamedTuple):
    """Result of `adjust_pair`.

    `rotation` (3, 3), `direction` (3,): pose of the second camera in the first one's frame, up to its length. `points`
    (n, 3): ray (x/z, y/z) in the first image, and baseline over depth. `displacement_px` (n,): of each tie in the image
    by travel alone. `covariance` (6, 6) of rotation vector (rad) and direction in the first camera's axes, errors that
    neighbouring ties share included. `iterations`. `history_px` (iterations + 1,): RMS of eq. 7.5 per coordinate over
    the points at the start and after each iteration.
    """

    rotation: Array
    direction: Array
    points: Array
    displacement_px: Array
    covariance: Array
    iterations: int
    history_px: Array

    def step_covariance(self, baseline_m: float, sigma_m: float) -> Array:
        """Covariance (6, 6) of rotation vector and translation (m), by the length of the step and its sigma."""
        along = np.outer(self.direction, self.direction)
        spread = np.eye(6)
        spread[3:, 3:] = baseline_m * (np.eye(3) - along)
        covariance = spread @ self.covariance @ spread.T
        covariance[3:, 3:] += sigma_m**2 * along
        return np.asarray(covariance)


def adjust_pair(  # noqa: PLR0913 - half of them are constants that tests vary
    previous: Array,
    current: Array,
    start: tuple[Array, Array],
    prior: StepPrior,
    *,
    focal_px: float,
    errors: TieErrors = TIE_ERRORS,
    scale_px: float = FINE_LAST_SCALE_PX,
    iterations: int = WINDOW_ITERATIONS,
    gain: float = PAIR_GAIN,
    scatter: float = 1.0,
) -> PairAdjustment:
    """Adjust motion and points together to the rays of two images.

    `previous`, `current`: rays (n, 2) as (x/z, y/z), of the same points. `start`: rotation (3, 3), unit direction (3,).
    `focal_px`: pixels of one unit of the rays. `scale_px`: of the robust cost. `scatter`: errors of these ties over the
    stated ones, 1 or more (`tie_scatter`), which enlarges the covariance.

    The covariance is nan where the normal equations are singular (no points and no prior).

    Raises ValueError where an array has another shape or type.
    """
    n = len(previous)
    require_array(previous, "previous", np.float64, (n, 2))
    require_array(current, "current", np.float64, (n, 2))
    numbers, sigma = np.arange(n, dtype=np.int64), np.full(n, errors.sigma_px / focal_px)
    # An error is divided between both images: half of its square is in the second one.
    scale = scale_px / errors.sigma_px / np.sqrt(2)
    blocks = ResidualBlocks.joined(
        [
            ResidualBlocks.observations(np.zeros(n, np.int64), numbers, previous, sigma, QUADRATIC),
            ResidualBlocks.observations(np.ones(n, np.int64), numbers, current, sigma, scale),
        ]
    )
    # Points start where the rays meet, at infinity where they do not meet ahead of both cameras.
    met = pair_midpoint(previous, current, *start)
    depth = np.where(met.ahead & (met.point[:, 2] > 1), met.point[:, 2], np.inf)
    found = adjust_window(
        Window(
            np.stack([np.eye(3), start[0]]),
            np.stack([np.zeros(3), start[1]]),
            0,
            np.column_stack([previous, 1 / depth]),
            np.zeros(n, np.int64),
        ),
        blocks,
        StepConstraints.of([prior._replace(length_m=1.0, sigma_m=LENGTH_SIGMA)]),
        pose=1,
        iterations=iterations,
        gain=gain,
    )
    direction = found.centres[1] / np.linalg.norm(found.centres[1])
    offset = found.points[:, :2] - direction[:2] / direction[2]
    displacement = focal_px * np.maximum(found.points[:, 2], 0) * np.linalg.norm(offset, axis=1)
    # Weights use the stated errors: larger ones change the stated covariance, not the motion.
    alone = np.sqrt(scatter**2 - 1) * errors.sigma_px / focal_px * found.gain.reshape(-1, 6)
    shared_px = scatter * correlated_sigma_px(displacement, errors)
    effect = shared_px[:, None, None] * found.gain[n:] / focal_px
    shared = correlated_covariance(
        current * focal_px, np.zeros(n, np.int64), effect, errors.reach_px
    )
    return PairAdjustment(
        found.rotations[1],
        direction,
        found.points,
        displacement,
        found.covariance + alone.T @ alone + shared,
        found.iterations,
        errors.sigma_px * np.sqrt(found.history / (4 * max(n, 1))),
    )
