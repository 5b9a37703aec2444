"""Focal length and radial distortion by the point tracks of a drive (self-calibration).

Where the camera only moves straight ahead, a longer focal length and farther points give the same images. The focal
length is known by rotation alone: by curves and pitching. The standard error tells. Besides the errors of single ties
it contains those that neighbouring ties share, and is no smaller than the scatter between segments says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np

from wayside.schemas.frame import Camera
from wayside.stages.adjustment import ANCHOR_SIGMA_PX, TIE_ERRORS, TIE_SCALE, correlated_covariance
from wayside.stages.calibration.lens import LENS, changed_camera
from wayside.stages.calibration.segment import Segment
from wayside.stages.calibration.segment_equations import (
    Linear,
    Weights,
    evaluate,
    linearise,
    updated,
)
from wayside.stages.kernels import Array

PRINCIPAL_POINT_SIGMA = 0.006
"""Scatter of a given principal point as a fraction of the width: boards show 3 px to 20 px of 1280."""
DISTORTION_SIGMA = 0.3
"""Scatter of k1 and k2 beforehand, for lenses of 50 to 90 degrees."""
LENGTH_SIGMA = 0.2
"""Relative scatter of the lengths of steps: they do not depend on the lens and only fix the scale."""
ITERATIONS = 15
"""Steps of the lens in one fit at most."""
START_ITERATIONS = 10
"""Steps of poses and points at the start, before the lens is free, at most."""
INNER_ITERATIONS = 4
"""Steps of poses and points after each step of the lens at most."""
GAIN = 0.5
"""Steps end where twice the log likelihood changes by less: one standard error changes it by 1."""
LONGEST_STEP = 0.1
"""Relative change of the focal length in one step at most."""
REWEIGHTINGS = 3
"""Fits with the errors of ties as large as the residuals of the last one say."""
SAME_ERRORS = 0.95
"""The last fit is one after which these errors are at least so many times those before."""
_RAYLEIGH_MEDIAN = sqrt(2 * np.log(2))
"""Median length of a residual of two normal coordinates, in their sigmas."""

_SMALLEST_DAMPING, _LARGEST_DAMPING = 1e-9, 1e3
"""Numerical guards: damping leads to the same minimum."""


@dataclass(frozen=True, slots=True)
class DriveCalibration:
    """Camera by a drive.

    `covariance` (5, 5) of the changes in `LENS`. `residual`: median residual over that of the errors of ties as stated.
    `cost`: per tie. `segments`, `ties`: numbers of them.
    """

    camera: Camera
    lens: Array
    covariance: Array
    residual: float
    cost: float
    segments: int
    ties: int

    @property
    def focal_sigma(self) -> float:
        """Relative standard error of the focal length."""
        return sqrt(float(self.covariance[0, 0]))


def calibrate_drive(
    segments: Sequence[Segment], camera: Camera, principal_sigma_px: float
) -> DriveCalibration:
    """Estimate the lens of a camera from the segments of a drive.

    Gauss-Newton on the lens. Poses and points are solved again after each step, and the cost depends on the lens alone.

    Parameters
    ----------
    segments
        One or more.
    camera
        Where the estimate starts; the ratio of both focal lengths and the coefficients but k1 and k2 are held.
    principal_sigma_px
        How far off its principal point may be.
    """
    problem, state = _start(segments, camera, principal_sigma_px)
    for _ in range(REWEIGHTINGS):
        state = _minimise(state, problem)
        factor = _error_factor(state, problem)
        if factor > SAME_ERRORS * problem.weights.factor:
            break
        # A wrong lens has larger residuals, which let its errors pass for those of ties.
        problem = problem._replace(weights=problem.weights._replace(factor=factor))
        state = _settled(state.segments, state.lens, problem, INNER_ITERATIONS)
    covariance, _ = _solve(state, problem)
    count = sum(len(one.track) for one in segments)
    return DriveCalibration(
        changed_camera(camera, state.lens),
        state.lens,
        covariance,
        problem.weights.factor,
        state.cost / count,
        len(segments),
        count,
    )


def lens_step(
    segments: Sequence[Segment], camera: Camera, principal_sigma_px: float
) -> tuple[Array, Array]:
    """The change (5,) of the lens to first order, in the order of `LENS`, and its covariance (5, 5).

    The first step of `calibrate_drive`, for half of its time; the arguments are the same. It falls short of large
    errors.
    """
    problem, state = _start(segments, camera, principal_sigma_px)
    covariance, step = _solve(state, problem)
    return step, covariance


class _Problem(NamedTuple):
    """The camera of the start, weights, the inverse covariance (5, 5) of the lens beforehand."""

    camera: Camera
    weights: Weights
    known: Array


class _State(NamedTuple):
    lens: Array
    segments: list[Segment]
    cost: float


def _start(
    segments: Sequence[Segment], camera: Camera, principal_sigma_px: float
) -> tuple[_Problem, _State]:
    """Poses and points for the lens as given, with the errors of ties as large as their residuals say."""
    lens = np.zeros(len(LENS))
    scatter = [np.inf, principal_sigma_px, principal_sigma_px, DISTORTION_SIGMA, DISTORTION_SIGMA]
    weights = Weights(1.0, TIE_SCALE, ANCHOR_SIGMA_PX, LENGTH_SIGMA)
    problem = _Problem(camera, weights, np.diag(1 / np.array(scatter) ** 2))
    state = _settled(segments, lens, problem, START_ITERATIONS)
    # Compressed images have larger errors than stated.
    problem = problem._replace(weights=weights._replace(factor=_error_factor(state, problem)))
    return problem, _settled(state.segments, lens, problem, START_ITERATIONS)


def _error_factor(state: _State, problem: _Problem) -> float:
    """Errors of ties over those stated, by the median residual; 1 at least."""
    here = changed_camera(problem.camera, state.lens)
    lengths = [evaluate(one, here, problem.weights)[1] for one in state.segments]
    median = float(np.median(np.concatenate(lengths)))
    return max(1.0, problem.weights.factor * median / _RAYLEIGH_MEDIAN)


def _minimise(start: _State, problem: _Problem) -> _State:
    best, damping = start, 0.0
    for _ in range(ITERATIONS):
        linear, matrix, right = _equations(best, problem, _SMALLEST_DAMPING)
        damped = matrix + damping * np.diag(np.diag(matrix))
        step: Array = np.asarray(np.linalg.solve(damped, right), np.float64)
        shortened = min(1.0, LONGEST_STEP / max(abs(float(step[0])), 1e-12))
        step *= shortened
        moved = [updated(a, b, step) for a, b in zip(best.segments, linear, strict=True)]
        trial = _settled(moved, best.lens + step, problem, INNER_ITERATIONS)
        if trial.cost < best.cost:
            gain, best = best.cost - trial.cost, trial
            damping = damping / 10 if damping > 1e-6 else 0.0
            if gain < GAIN:
                break
        else:
            damping = max(10 * damping, 1e-3)
            if damping > _LARGEST_DAMPING:
                break
    return best


def _equations(
    state: _State, problem: _Problem, damping: float
) -> tuple[list[Linear], Array, Array]:
    """Linearised segments, and the normal equations of the lens: matrix (5, 5) and right side (5,)."""
    here = changed_camera(problem.camera, state.lens)
    linear = [linearise(one, here, problem.weights, damping) for one in state.segments]
    matrix = sum((one.matrix for one in linear), problem.known)
    return linear, matrix, sum((one.right for one in linear), -problem.known @ state.lens)


def _settled(segments: Sequence[Segment], lens: Array, problem: _Problem, rounds: int) -> _State:
    """Poses and points for a lens, and the cost of it."""
    here = changed_camera(problem.camera, lens)
    gain = GAIN
    settled = [_settle(one, here, problem.weights, rounds, gain) for one in segments]
    cost = sum(cost for _, cost in settled) + float(lens @ problem.known @ lens)
    return _State(lens, [segment for segment, _ in settled], cost)


def _settle(
    segment: Segment, camera: Camera, weights: Weights, rounds: int, least_gain: float
) -> tuple[Segment, float]:
    cost, damping = evaluate(segment, camera, weights)[0], 1e-6
    for _ in range(rounds):
        linear = linearise(segment, camera, weights, damping)
        trial = updated(segment, linear, np.zeros(len(LENS)))
        trial_cost = evaluate(trial, camera, weights)[0]
        if trial_cost < cost:
            gain, segment, cost = cost - trial_cost, trial, trial_cost
            damping = max(damping / 10, _SMALLEST_DAMPING)
            if gain < least_gain:
                break
        else:
            damping = max(30 * damping, 1e-4)
    return segment, cost


def _solve(state: _State, problem: _Problem) -> tuple[Array, Array]:
    """Covariance (5, 5) of the lens and the Gauss-Newton step (5,) from here.

    Of independent errors and of those that neighbouring ties share; raised to what the scatter between segments says.
    """
    linear, matrix, right = _equations(state, problem, 0.0)
    inverse = np.asarray(np.linalg.inv(matrix), np.float64)
    result = inverse.copy()
    for segment, one in zip(state.segments, linear, strict=True):
        shared_px = problem.weights.factor * segment.shared_px
        effect = (one.gain @ inverse) * shared_px[:, None, None]
        result += correlated_covariance(
            segment.end, segment.frames[:, 1], effect, TIE_ERRORS.reach_px
        )
    step = np.asarray(inverse @ right, np.float64)
    count = len(linear)
    if count > 1:
        # What each segment would still change after the step.
        rights = np.array([one.right - one.matrix @ step for one in linear])
        scatter = inverse @ (rights.T @ rights) @ inverse * count / (count - 1)
        ratio = np.sqrt(np.maximum(1.0, np.diag(scatter) / np.diag(result)))
        result *= np.outer(ratio, ratio)
    return result, step
