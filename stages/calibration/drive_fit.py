"""Focal length and radial distortion by the point tracks of a drive (self-calibration).

Where the camera only moves straight ahead, a longer focal length and farther points give the same images. The focal
length is known by rotation alone: by curves and pitching. The standard error tells. Besides the errors of single ties
it contains those that neighbouring ties share, and is no smaller than the scatter between segments says.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtr

from wayside.schemas.frame import Camera
from wayside.stages.adjustment import TIE_ERRORS, correlated_covariance
from wayside.stages.calibration.segment import Segment
from wayside.stages.calibration.segment_equations import (
    LENS,
    RADIAL,
    Equations,
    Projection,
    Reduced,
    changed_camera,
    displacement,
    evaluate,
    lens_gain,
    linearise,
    project_segment,
    reduced,
    updated,
)
from wayside.stages.geometry import Schedule, minimiser
from wayside.stages.kernels import Array

PRINCIPAL_POINT_SIGMA = 0.006
"""Scatter of a given principal point as a fraction of the width: boards show 3 px to 20 px of 1280."""
DISTORTION_SIGMA = 0.3
"""Scatter of k1 and k2 beforehand, for lenses of 50 to 90 degrees."""
ITERATIONS = 15
"""Steps of the lens at most."""
START_ITERATIONS, INNER_ITERATIONS = 2, 2
"""Steps of poses and points, at most, at the start and after each step of the lens, whose curved valley they follow."""
START_DAMPING, LENS_DAMPING = 1e-3, 1e-9
"""Of poses and points alone, and with the lens: more would hold principal point and pitch, nearly one direction."""
GAIN = 2.0
"""Chi-square below which a step is the last; that of the errors of five parameters is 5."""
LARGEST_SIGMA = 0.03
"""A focal length with a larger relative standard error is not determined: so large is that of positions."""
WRONG_DISPLACEMENT = 0.03
"""A lens is wrong where a point is displaced by more, by its distance from the principal point."""
WRONG_SIGMAS = 4.0
"""A lens is wrong where a chi-square test of focal length, k1 and k2 rejects it at so many standard deviations."""
_RAYLEIGH_MEDIAN = sqrt(2 * np.log(2))
"""Median length of a residual of two normal coordinates, in their sigmas."""


class LensParameter(NamedTuple):
    """A parameter of the lens by a drive, with its standard error, and as it was given."""

    value: float
    sigma: float
    given: float


@dataclass(frozen=True, slots=True)
class DriveCalibration:
    """Camera by a drive, and what it says of the one that was given.

    `covariance` (5, 5) of the changes `lens` (5,) in `LENS`. `residual`: median residual over that of the errors of
    ties as stated. `cost`: per tie. `segments`, `ties`: numbers of them.
    """

    given: Camera
    lens: Array
    covariance: Array
    residual: float
    cost: float
    segments: int
    ties: int

    @property
    def camera(self) -> Camera:
        """The camera given with the lens by the drive."""
        return changed_camera(self.given, self.lens)

    @property
    def parameters(self) -> dict[str, LensParameter]:
        """fx, fy, cx, cy (px), k1 and k2."""
        old, new = changed_camera(self.given, np.zeros(len(LENS))), self.camera
        sigma = np.sqrt(np.diag(self.covariance))[[0, 0, 1, 2, 3, 4]].tolist()
        of = [[c.fx, c.fy, c.cx, c.cy, *c.distortion[:2]] for c in (new, old)]
        sigma[:2] = (one * focal for one, focal in zip(sigma[:2], of[0][:2], strict=True))
        numbers = map(LensParameter, of[0], sigma, of[1])
        return dict(zip(("fx", "fy", "cx", "cy", "k1", "k2"), numbers, strict=True))

    @property
    def about(self) -> dict[str, Any]:
        """Parameters and verdict as plain values."""
        return {
            "parameters": {name: one._asdict() for name, one in self.parameters.items()},
            "displacement": self.displacement,
            "is_determined": self.is_determined,
            "refutes_given": self.refutes_given,
        }

    @property
    def focal_sigma(self) -> float:
        """Relative standard error of the focal length."""
        return sqrt(float(self.covariance[0, 0]))

    @property
    def is_determined(self) -> bool:
        """Whether the drive determines the focal length."""
        return self.focal_sigma <= LARGEST_SIGMA

    @property
    def displacement(self) -> float:
        """By what part of their distance from the principal point the camera given displaces points at most."""
        return displacement(self.given, self.lens)

    @property
    def refutes_given(self) -> bool:
        """Whether the camera given cannot be right: its points are displaced, and a chi-square test rejects it.

        The test is of focal length, k1 and k2 together, because their errors are correlated.
        """
        change, errors = self.lens[RADIAL], self.covariance[np.ix_(RADIAL, RADIAL)]
        by_chance = float(chdtrc(len(RADIAL), change @ np.linalg.solve(errors, change)))
        rejected = by_chance < 2 * float(ndtr(-WRONG_SIGMAS))
        return rejected and self.displacement > WRONG_DISPLACEMENT


def describe_calibration(found: DriveCalibration, source: str) -> str:
    """A sentence on the given calibration by a drive; `source` of that calibration, empty without one."""
    told = ", ".join(
        f"{name} {one.value:.4g} ± {one.sigma:.2g}"
        + (f" (given {one.given:.4g})" if source else "")
        for name, one in found.parameters.items()
        if name != "fy"
    )
    if source and found.refutes_given:
        return (
            f"the calibration ({source}) cannot be right, so positions are wrong: the motion in the images fits "
            f"{told}, which moves points by up to {100 * found.displacement:.0f} % of their distance from "
            "the principal point"
        )
    if not found.is_determined:
        return (
            f"the drive does not determine the calibration: the focal length has a standard error of "
            f"{100 * found.focal_sigma:.1f} %, which must be at most {100 * LARGEST_SIGMA:g} %"
        )
    if not source:
        return "no calibration was given; centre of the image taken as principal point"
    return (
        f"the calibration ({source}) agrees with the motion in the images, which moves points by at most "
        f"{100 * found.displacement:.1f} % of their distance from the principal point"
    )


@dataclass
class _Problem:
    """The camera of the start, the inverse covariance (5, 5) of the lens beforehand, and the equations.

    `factor`: on the errors of ties as stated. `free`: whether the lens is fitted, or only poses and points.
    """

    camera: Camera
    known: Array
    factor: float = 1.0
    free: bool = False
    equations: list[Equations] = field(default_factory=list)


@dataclass
class _Estimate:
    """Change of the lens (5,), and the segments with their poses and points.

    What their images show, once the cost was evaluated, and there the `lengths` of the residuals of ties.
    """

    lens: Array
    segments: Sequence[Segment]
    seen: Sequence[Projection] = ()
    lengths: Sequence[Array] = ()


def calibrate_drive(
    segments: Sequence[Segment], camera: Camera, principal_sigma_px: float
) -> DriveCalibration:
    """Estimate the lens of a camera from the segments of a drive.

    Steps are of Gauss and Newton and go on until one is no larger than its error. That is the first where the lens
    given is right. Poses and points are solved again after each: the cost depends on the lens alone.

    The ratio of both focal lengths and the coefficients but k1 and k2 are held. `principal_sigma_px`: how far off the
    principal point of the camera may be. Raises LinAlgError where the ties determine nothing.
    """
    scatter = [np.inf, principal_sigma_px, principal_sigma_px, DISTORTION_SIGMA, DISTORTION_SIGMA]
    problem = _Problem(camera, np.diag(1 / np.array(scatter) ** 2))
    estimate = _fitted(problem, _Estimate(np.zeros(len(LENS)), segments), START_ITERATIONS)
    problem.free = True
    for left in reversed(range(ITERATIONS)):
        # Compressed images have larger errors than stated.
        median = float(np.median(np.concatenate(estimate.lengths)))
        problem.factor = max(1.0, problem.factor * median / _RAYLEIGH_MEDIAN)
        solved, step, inverse = _lens_step(problem, estimate)
        # By errors as stated: a wrong lens enlarges those found, which would let its own pass for chance.
        if not left or problem.factor**2 * step @ np.linalg.solve(inverse, step) < GAIN:
            break
        estimate = _fitted(problem, estimate, 1)
    lens, covariance = estimate.lens + step, _covariance(problem, estimate, solved, step, inverse)
    if not (np.isfinite(lens).all() and np.isfinite(covariance).all()):
        raise np.linalg.LinAlgError
    cost, count = _evaluate(problem, estimate), sum(len(one.early) for one in segments)
    return DriveCalibration(
        camera, lens, covariance, problem.factor, cost / count, len(segments), count
    )


def _fitted(problem: _Problem, start: _Estimate, iterations: int) -> _Estimate:
    """The estimate of least cost."""
    count = sum(len(one.early) for one in start.segments)
    schedule = Schedule(iterations, GAIN / count, LENS_DAMPING if problem.free else START_DAMPING)
    return _minimise(problem, start, replace(start), schedule)[0]


def _evaluate(problem: _Problem, estimate: _Estimate) -> float:
    if not estimate.seen:
        here = changed_camera(problem.camera, estimate.lens)
        estimate.seen = [project_segment(one, here) for one in estimate.segments]
    parts = zip(estimate.segments, estimate.seen, strict=True)
    costs, estimate.lengths = zip(*(evaluate(*part, problem.factor) for part in parts), strict=True)
    return float(sum(costs) + estimate.lens @ problem.known @ estimate.lens)


def _linearise(problem: _Problem, estimate: _Estimate, iteration: int) -> None:
    parts = zip(estimate.segments, estimate.seen, strict=True)
    problem.equations = [linearise(*part, problem.factor) for part in parts]


def _solve(problem: _Problem, estimate: _Estimate, damping: float, trial: _Estimate) -> bool:
    solved = [reduced(one, damping) for one in problem.equations]
    step: Array = np.zeros(len(LENS))
    if problem.free:
        matrix = sum((one.matrix for one in solved), problem.known)
        right = sum((one.right for one in solved), -problem.known @ estimate.lens)
        damped = matrix + damping * np.diag(np.diag(matrix))
        step = np.asarray(np.linalg.solve(damped, right), np.float64)
    trial.lens = estimate.lens + step
    parts = zip(estimate.segments, problem.equations, solved, strict=True)
    trial.segments, trial.seen = [updated(*part, step) for part in parts], ()
    if problem.free:
        held = replace(problem, free=False)
        fitted = _fitted(held, replace(trial), INNER_ITERATIONS)
        trial.segments, trial.seen = fitted.segments, fitted.seen
    return True


_minimise = minimiser(_evaluate, _linearise, _solve, plain=True)


def _lens_step(problem: _Problem, estimate: _Estimate) -> tuple[list[Reduced], Array, Array]:
    """Equations of the lens of each segment, its Gauss-Newton step (5,), and the inverse (5, 5) of their sum."""
    _linearise(problem, estimate, 0)
    solved = [reduced(one, 0.0) for one in problem.equations]
    matrix = sum((one.matrix for one in solved), problem.known)
    right = sum((one.right for one in solved), -problem.known @ estimate.lens)
    inverse: Array = np.asarray(np.linalg.inv(matrix), np.float64)
    return solved, inverse @ right, inverse


def _covariance(
    problem: _Problem, estimate: _Estimate, solved: list[Reduced], step: Array, inverse: Array
) -> Array:
    """Covariance (5, 5) of the lens in the order of `LENS`, by its last step.

    It is of independent errors and of those that neighbouring ties share, and raised to what the scatter between
    segments says.
    """
    result = inverse.copy()
    for segment, equations, one in zip(estimate.segments, problem.equations, solved, strict=True):
        shared_px = problem.factor * segment.shared_px
        effect = (lens_gain(segment, equations, one) @ inverse) * shared_px[:, None, None]
        late = segment.frame[segment.early + 1]
        result += correlated_covariance(segment.end, late, effect, TIE_ERRORS.reach_px)
    count = len(solved)
    if count > 1:
        # What each segment alone would still change.
        rights = np.array([one.right - one.matrix @ step for one in solved])
        scatter = inverse @ (rights.T @ rights) @ inverse * count / (count - 1)
        ratio = np.sqrt(np.maximum(1.0, np.diag(scatter) / np.diag(result)))
        result *= np.outer(ratio, ratio)
    return result
