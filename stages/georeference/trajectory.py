"""The path of a camera over a whole drive: steps exact between neighbours, absolute positions that bound their drift.

One least-squares problem over all frames, solved by Gauss-Newton with Cauchy weights. Each frame has eleven unknowns:
centre, rotation, logarithm of the scale of the step to it, correlated error of the absolute positions (three) and their
time offset. Every measurement touches one frame or two neighbours: the cost is proportional to the number of frames.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.stages.geometry import cross_matrices
from wayside.stages.georeference.banded import BandedNormal, block_covariances, combination_variance
from wayside.stages.georeference.measurements import (
    STEP_FLOOR_RAD,
    AbsoluteMeasurements,
    RelativeMotionChain,
)
from wayside.stages.kernels import Array

KNOWN_LENGTH_SIGMA = 1e-4
"""Relative scatter of the scale of a step whose length is measured: holds it at 1."""
UNKNOWN_LENGTH_SIGMA = 0.3
"""The same where the length was taken from fixes, points or the last speed (estimate)."""
ITERATIONS, CONVERGED_M = 50, 1e-4
"""Gauss-Newton ends after so many iterations, or when no camera centre moves further."""
OFFSET_SIGMA_S = 0.5
"""Prior scatter of the time offset between poses or fixes and frames (estimate)."""
OFFSET_DRIFT_S = 1e-5
"""Scatter of the change of this offset from frame to frame: holds it constant."""
OFFSET_SIGMAS = 4.0
"""Standard deviations from which an offset is corrected: rendered drives without an offset show none."""
SMALLEST_OFFSET_S = 0.02
"""Shorter time offsets are ignored (estimate)."""
STEP_REACH, RATIO_REACH, POSITION_REACH = 6.0, 6.0, 3.0
"""Residual of a step, a length ratio, a pose or fix, in standard deviations, at which its Cauchy weight is one half."""
JUMP_WEIGHT = 0.3
"""Poses and fixes of lower weight are excluded before the correlated error is estimated: it would follow a jump."""
EXCLUDED_WEIGHT = 1e-6
"""Weight of an excluded pose or fix: not 0, which would be singular."""
OUTLIER_WEIGHT = 0.05
"""Poses and fixes of lower final weight are reported as outliers."""
LONGEST_OFFSET_S = 1.0
"""No recorder is later; poses or fixes that need more contradict the motion."""

CENTRE, ROTATION, SCALE, CORRELATED, OFFSET = slice(0, 3), slice(3, 6), 6, slice(7, 10), 10
UNKNOWNS = 11
"""Of a frame."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Where the camera was: rotation (n, 3, 3), centre (n, 3); scale (n,): length of each step over that given.

    `covariance` (n, 11, 11): of centre (m), rotation vector about the world's axes (rad), logarithm of the scale and
    unknowns of the absolute positions. `factor` `(22, 11 n)`: of its inverse for all frames, banded (Cholesky).
    `weight` (m,): of the absolute measurements, near 0 for an outlier, which `outliers` counts. `time_offset_s`: how
    long after a frame's capture its position is reported, 0 where none is found. `impossible_offset_s`: one that no
    recorder has and that is therefore not undone, or 0.
    """

    rotation: Array
    centre: Array
    scale: Array
    covariance: Array
    factor: Array
    weight: Array
    outliers: int
    time_offset_s: float
    time_offset_sigma_s: float
    impossible_offset_s: float = 0.0

    def length_variance(self, first: int, last: int, level: bool) -> float:
        """Variance, m^2, of the distance travelled from one row of the path to a later one.

        Each step's length changes with both of its ends along the step: errors that the ends share cancel. `level`: of
        the distance in the plane x, y.
        """
        steps = np.diff(self.centre[first : last + 1], axis=0)
        steps[:, 2] *= not level
        ahead = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-9)
        gradient = np.zeros((len(steps) + 1, UNKNOWNS))
        gradient[1:, CENTRE] += ahead
        gradient[:-1, CENTRE] -= ahead
        columns = self.factor[:, first * UNKNOWNS : (last + 1) * UNKNOWNS]
        return combination_variance(columns, self.covariance[last], gradient.ravel())


def smooth(
    chain: RelativeMotionChain, measured: AbsoluteMeasurements, rotation: Array, centre: Array
) -> Trajectory:
    """The trajectory that fits relative motion and absolute positions best.

    A constant time offset of the absolute measurements is estimated, and corrected where it is significant.

    `rotation` (n, 3, 3), `centre` (n, 3): initial values, tens of metres and some degrees away at most.

    Raises numpy.linalg.LinAlgError where the measurements leave something undetermined.
    """
    free = _Adjustment(chain, measured, rotation, centre, OFFSET_SIGMA_S).run()
    found_s, impossible_s = free.time_offset_s, 0.0
    if abs(found_s) > LONGEST_OFFSET_S:
        impossible_s = found_s
        free = replace(free, rotation=rotation, centre=centre)
    elif abs(found_s) > max(OFFSET_SIGMAS * free.time_offset_sigma_s, SMALLEST_OFFSET_S):
        return free
    held = _Adjustment(chain, measured, free.rotation, free.centre, OFFSET_DRIFT_S).run()
    sigma_s = free.time_offset_sigma_s
    return replace(
        held, time_offset_s=0.0, time_offset_sigma_s=sigma_s, impossible_offset_s=impossible_s
    )


class _Adjustment:
    """One adjustment; each part adds its measurements to the normal equations."""

    def __init__(
        self,
        chain: RelativeMotionChain,
        measured: AbsoluteMeasurements,
        rotation: Array,
        centre: Array,
        offset_sigma_s: float,
    ) -> None:
        self.chain, self.measured, self.offset_sigma_s = chain, measured, offset_sigma_s
        self.first, self.rotation, self.centre = rotation[:1].copy(), rotation.copy(), centre.copy()
        n = len(centre)
        self.scale, self.correlated, self.offset = np.zeros(n), np.zeros((n, 3)), np.zeros(n)
        values, axes = np.linalg.eigh(chain.step_covariance())
        scale = np.sqrt(np.maximum(values, STEP_FLOOR_RAD**2))[:, None]
        self.root = axes / scale @ axes.transpose(0, 2, 1)  # whitens the errors of the steps
        self.weight = np.ones(len(measured.row))
        self.estimates_correlated = not measured.correlated_sigma_m.any()

    def run(self) -> Trajectory:
        """Gauss-Newton until converged, twice where there is a correlated error.

        The first time it counts as independent scatter: estimated, it would follow a jump of the fixes, which then
        fits. Measurements that do not fit by then are excluded in the first iteration that estimates it.
        """
        initial = None
        if self.measured.correlated_sigma_m.any():
            self._iterate(None)
            self.estimates_correlated = True
            initial = np.where(self.weight < JUMP_WEIGHT, EXCLUDED_WEIGHT, 1.0)
        factor = self._iterate(initial)
        own = block_covariances(factor, UNKNOWNS)
        return Trajectory(
            self.rotation,
            self.centre,
            np.exp(self.scale),
            own,
            factor,
            self.weight,
            int((self.weight < OUTLIER_WEIGHT).sum()),
            float(self.offset[0]),
            float(np.sqrt(own[0, OFFSET, OFFSET])),
        )

    def _iterate(self, weight: Array | None) -> Array:
        """Gauss-Newton, its first iteration with these weights; the Cholesky factor of the last normal equations."""
        factor = np.zeros((2 * UNKNOWNS, 0))
        for _ in range(ITERATIONS):
            normal = BandedNormal(len(self.centre), UNKNOWNS)
            self._add_priors(normal)
            self._add_steps(normal)
            self._add_ratios(normal)
            self._add_measured(normal, weight)
            weight = None
            change, factor = normal.solve()
            self._update(change)
            if np.abs(change[:, CENTRE]).max() < CONVERGED_M:
                break
        return factor

    def _update(self, change: Array) -> None:
        self.centre += change[:, CENTRE]
        turned = Rotation.from_rotvec(change[:, ROTATION]) * Rotation.from_matrix(self.rotation)
        self.rotation = np.asarray(turned.as_matrix())  # orthonormal
        self.scale += change[:, SCALE]
        self.correlated += change[:, CORRELATED]
        self.offset += change[:, OFFSET]

    def _add_priors(self, normal: BandedNormal) -> None:
        """Priors of scales and time offset; the correlated error is a first-order Gauss-Markov process."""
        n = len(self.centre)
        every, later, one = np.arange(n), np.arange(1, n), np.ones((1, 1, 1))
        sigma = np.where(self.chain.free_length, UNKNOWN_LENGTH_SIGMA, KNOWN_LENGTH_SIGMA)[:, None]
        normal.add(every, (SCALE,), np.ones((n, 1, 1)), -self.scale[:, None], sigma**-2)
        keeps = np.exp(-np.maximum(self.chain.interval_s[1:], 0.0) / self.measured.correlation_s)
        fresh = np.sqrt(np.maximum(1 - keeps**2, 1e-8))
        for axis in range(CORRELATED.start, CORRELATED.stop):
            u = self.correlated[:, axis - CORRELATED.start]
            normal.add(every[:1], (axis,), one, -u[:1, None])
            jacobian = np.stack([np.ones(n - 1), -keeps], axis=1)[:, None]
            residual = (keeps * u[:-1] - u[1:])[:, None]
            normal.add(later, (axis, axis - UNKNOWNS), jacobian, residual, fresh[:, None] ** -2)
        normal.add(every[:1], (OFFSET,), one, -self.offset[:1, None], self.offset_sigma_s**-2)
        jacobian = np.tile([1.0, -1.0], (n - 1, 1, 1))
        residual = -np.diff(self.offset)[:, None]
        normal.add(later, (OFFSET, OFFSET - UNKNOWNS), jacobian, residual, OFFSET_DRIFT_S**-2)

    def _add_steps(self, normal: BandedNormal) -> None:
        """The steps: rotation and translation in the axes of the camera before."""
        chain, n = self.chain, len(self.centre)
        if n < 2:
            return
        back = self.rotation[:-1].transpose(0, 2, 1)
        displacement = np.diff(self.centre, axis=0)
        wanted = np.exp(self.scale[1:, None]) * chain.translation[1:]
        apart = back @ self.rotation[1:] @ chain.rotation[1:].transpose(0, 2, 1)
        residual = np.concatenate([_vector(apart), _times(back, displacement) - wanted], axis=1)
        jacobian = np.zeros((n - 1, 6, 13))
        jacobian[:, :3, 3:6], jacobian[:, :3, 9:12] = -back, back
        jacobian[:, 3:, :3], jacobian[:, 3:, 6:9] = -back, back
        jacobian[:, 3:, 3:6] = back @ cross_matrices(displacement)
        jacobian[:, 3:, 12] = -wanted
        white, jacobian = -_times(self.root[1:], residual), self.root[1:] @ jacobian
        weight = _cauchy((white**2).sum(axis=1), 6, STEP_REACH)
        columns = (*range(-UNKNOWNS, 6 - UNKNOWNS), *range(7))
        normal.add(np.arange(1, n), columns, jacobian, white, weight[:, None])

    def _add_ratios(self, normal: BandedNormal) -> None:
        """Lengths of neighbouring steps against each other."""
        for rows, wanted, sigma in (self.chain.ratios_by_points(), self.chain.ratios_by_time()):
            white = (wanted - self.scale[rows] + self.scale[rows - 1]) / sigma
            weight = _cauchy(white**2, 1, RATIO_REACH)
            jacobian = np.stack([1 / sigma, -1 / sigma], axis=1)[:, None]
            normal.add(rows, (SCALE, SCALE - UNKNOWNS), jacobian, white[:, None], weight[:, None])

    def _add_measured(self, normal: BandedNormal, weight: Array | None) -> None:
        """Absolute positions and rotations at the time offset before the frame's capture; roll and first rotation."""
        measured, rows = self.measured, self.measured.row
        m = len(rows)
        lever = self.rotation[rows] @ measured.lever_arm_m
        velocity = _rate(self.centre[2:] - self.centre[:-2], self.chain.time_s)[rows]
        correlated = measured.correlated_sigma_m[rows] * self.estimates_correlated
        position = self.centre[rows] + lever + correlated * self.correlated[rows]
        position -= velocity * self.offset[rows, None]
        jacobian = np.zeros((m, 6, UNKNOWNS))
        jacobian[:, :3, CENTRE] = np.eye(3)
        jacobian[:, :3, ROTATION] = -cross_matrices(lever)
        jacobian[:, [0, 1, 2], [7, 8, 9]] = correlated
        jacobian[:, :3, OFFSET] = -velocity
        residual = np.zeros((m, 6))
        residual[:, :3] = measured.position - position
        sigma = np.ones((m, 6))
        sigma[:, :3] = measured.sigma_m
        if not self.estimates_correlated:
            sigma[:, :3] = np.hypot(measured.sigma_m, measured.correlated_sigma_m[rows])
        if measured.rotation is not None and measured.sigma_rad is not None:
            turned = _vector(self.rotation[2:] @ self.rotation[:-2].transpose(0, 2, 1))
            rate = _rate(turned, self.chain.time_s)[rows]
            apart = _vector(measured.rotation @ self.rotation[rows].transpose(0, 2, 1))
            residual[:, 3:] = apart + rate * self.offset[rows, None]
            jacobian[:, 3:, ROTATION] = np.eye(3)
            jacobian[:, 3:, OFFSET] = -rate
            sigma[:, 3:] = measured.sigma_rad[:, None]
        white, jacobian = residual / sigma, jacobian / sigma[:, :, None]
        freedom = 3 if measured.rotation is None else 6
        robust = _cauchy((white**2).sum(axis=1), freedom, POSITION_REACH)
        self.weight = robust if weight is None else weight
        normal.add(rows, range(UNKNOWNS), jacobian, white, self.weight[:, None])
        self._add_level(normal)

    def _add_level(self, normal: BandedNormal) -> None:
        """Priors: the camera's x axis lies level; the first frame is rotated as its initial value."""
        measured, n = self.measured, len(self.centre)
        if np.isfinite(measured.roll_sigma_rad):
            right = self.rotation[:, :, 0]
            jacobian = np.stack([right[:, 1], -right[:, 0]], axis=1)[:, None]
            normal.add(np.arange(n), (3, 4), jacobian, -right[:, 2:], measured.roll_sigma_rad**-2)
        apart = _vector(self.first @ self.rotation[:1].transpose(0, 2, 1))
        weight = measured.first_sigma_rad[None] ** -2
        normal.add(np.zeros(1, int), range(3, 6), np.eye(3)[None], apart, weight)


def _rate(change: Array, time_s: Array) -> Array:
    """Central differences (n, 3) of changes (n - 2, 3) over two intervals, 0 where times do not tell."""
    if len(time_s) < 3:
        return np.zeros((len(time_s), 3))
    interval = (time_s[2:] - time_s[:-2])[:, None]
    rate = np.where(interval > 1e-3, change / np.maximum(interval, 1e-3), 0.0)
    return np.pad(rate, ((1, 1), (0, 0)), mode="edge")


def _cauchy(squares: Array, freedom: int, reach: float) -> Array:
    """Cauchy weights of squared whitened residuals, relative to their median where that exceeds 1."""
    each = squares / freedom
    usual = max(1.0, float(np.median(each))) if len(each) else 1.0
    return np.asarray(1 / (1 + each / (reach**2 * usual)))


def _vector(matrices: Array) -> Array:
    return np.asarray(Rotation.from_matrix(matrices).as_rotvec())


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])
