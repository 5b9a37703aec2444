"""Measurements that a smoothed path is made of: relative motion between neighbouring frames, absolute positions."""

from dataclasses import dataclass, field
from math import inf, pi

import numpy as np

from wayside.stages.kernels import Array, Flags, Numbers

ACCELERATION_MPS2 = 1.0
"""Standard deviation of the acceleration in ordinary driving, by which lengths of steps are compared."""
STAMP_S = 2e-3
"""Scatter of capture times in recorded logs."""
EQUAL_LENGTH_SIGMA = 0.1
"""Relative scatter of a step's length against the one before, where times do not tell (estimate)."""
RATIO_SIGMA = 0.0015
"""Smallest relative scatter of the length ratio of two steps by common points (measured, rendered drives)."""
RATIO_FRACTION = 0.2
"""Part of a ratio's stated scatter that counts: errors of points enter two ratios with opposite signs and cancel."""
RATIO_LIMIT = 3.0
"""Length ratios above this or below its inverse are ignored (estimate)."""
ALONG_SIGMA_M = 2e-3
"""Scatter of a step along itself where its length is an unknown: small against every other error."""
STEP_FLOOR_M = 1e-3
"""Smallest scatter of a step (estimate)."""
CORRELATION_S = 60.0
"""Correlation time of the error of fixes (atmosphere, orbits, reflections), usual for single receivers."""
STEP_FLOOR_RAD = 1e-5
"""Smallest scatter of a step's rotation (estimate)."""

LengthRatios = tuple[Numbers, Array, Array]
"""Rows (k,) of frames, log (k,) of the scale of the step to each over that of the step before, its scatter (k,)."""


@dataclass(frozen=True, slots=True)
class RelativeMotionChain:
    """Frames in order, each with the step from the one before; row 0 of the steps is not used.

    `time_s` (n,): capture times. `rotation` (n, 3, 3), `translation` (n, 3): of the camera in the axes of the one
    before, metres. `covariance` (n, 6, 6): of rotation vector (rad) and translation (m). `free_length` (n,): the length
    is known against that of the step before only. `length_ratio` (n, 2): to it, by common points alone, and its
    scatter, nan where unknown.
    """

    time_s: Array
    rotation: Array
    translation: Array
    covariance: Array
    free_length: Flags
    length_ratio: Array

    @property
    def length(self) -> Array:
        """Lengths (n,) of the steps as given, metres."""
        return np.asarray(np.maximum(np.linalg.norm(self.translation, axis=1), 1e-6))

    @property
    def relative_length_sigma(self) -> Array:
        """Standard deviation (n,) of the lengths as given, over these."""
        ahead = self.translation / self.length[:, None]
        variance = np.einsum("ni,nij,nj->n", ahead, self.covariance[:, 3:, 3:], ahead)
        return np.asarray(np.sqrt(variance) / self.length)

    @property
    def interval_s(self) -> Array:
        """Time (n,) since the frame before, 0 at the first."""
        return np.diff(self.time_s, prepend=self.time_s[:1])

    def step_covariance(self) -> Array:
        """Covariance (n, 6, 6) of the steps; without the length where that is an unknown of its own."""
        result, free = self.covariance.copy(), self.free_length
        ahead = self.translation[free] / self.length[free, None]
        sideways = np.eye(3) - ahead[:, :, None] * ahead[:, None]
        result[free, 3:] = sideways @ result[free, 3:]
        result[free, :, 3:] = result[free, :, 3:] @ sideways
        result[free, 3:, 3:] += ALONG_SIGMA_M**2 * ahead[:, :, None] * ahead[:, None]
        return result + np.diag([STEP_FLOOR_RAD**2] * 3 + [STEP_FLOOR_M**2] * 3)

    def ratios_by_points(self) -> LengthRatios:
        """Lengths against those before by points common to both steps, where there are enough."""
        rows = self._neighbours()
        ratio, scatter = self.length_ratio[rows].T
        with np.errstate(invalid="ignore"):
            known = (ratio > 1 / RATIO_LIMIT) & (ratio < RATIO_LIMIT) & np.isfinite(scatter)
        rows, ratio, scatter = rows[known], ratio[known], scatter[known]
        sigma = np.hypot(RATIO_FRACTION * scatter / ratio, RATIO_SIGMA)
        return rows, np.log(ratio) - self._given(rows), sigma

    def ratios_by_time(self) -> LengthRatios:
        """Lengths against those before at a steady speed; equal lengths where times do not tell."""
        rows = self._neighbours()
        now, before = self.interval_s[rows], self.interval_s[rows - 1]
        timed = (now > STAMP_S) & (before > STAMP_S)
        now, before = np.where(timed, now, 1.0), np.where(timed, before, 1.0)
        by_speed = ACCELERATION_MPS2 * 0.5 * (now + before) * now / self.length[rows]
        # of the logarithm of the ratio of two intervals that share a stamp
        by_stamps = STAMP_S * np.sqrt(2 * (now**-2 + before**-2 + 1 / (now * before)))
        wanted = np.where(timed, np.log(now / before) - self._given(rows), 0.0)
        return rows, wanted, np.where(timed, np.hypot(by_speed, by_stamps), EQUAL_LENGTH_SIGMA)

    def _neighbours(self) -> Numbers:
        """Frames whose step and that before are both of unknown length."""
        return 2 + np.flatnonzero(self.free_length[2:] & self.free_length[1:-1])

    def _given(self, rows: Numbers) -> Array:
        return np.asarray(np.log(self.length[rows] / self.length[rows - 1]))


@dataclass(frozen=True, slots=True)
class AbsoluteMeasurements:
    """Positions of the frames `row` (m,), or of an antenna on their cameras, and rotations where they are known too.

    `position` (m, 3), `sigma_m` (m, 3): metres, errors independent of each other. `correlated_sigma_m` (n, 3): standard
    deviation at each frame of the error that is correlated over correlation_s. `rotation` (m, 3, 3), `sigma_rad` (m,),
    or None. `lever_arm_m` (3,): the antenna in the camera's axes. `first_sigma_rad` (3,): prior of the rotation of the
    first frame about each axis. `roll_sigma_rad`: prior of every camera's roll (inf: none).
    """

    row: Numbers
    position: Array
    sigma_m: Array
    correlated_sigma_m: Array
    correlation_s: float = CORRELATION_S
    lever_arm_m: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array | None = None
    sigma_rad: Array | None = None
    first_sigma_rad: Array = field(default_factory=lambda: np.full(3, pi))
    roll_sigma_rad: float = inf
