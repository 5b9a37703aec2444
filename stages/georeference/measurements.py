"""What a smoothed trajectory is made of: steps between neighbouring frames, and places known from outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array

ACCELERATION, STAMP_S, LIKE_LENGTH = 1.0, 2e-3, 0.1
"""How a vehicle changes its speed, m/s^2; scatter of the times of capture; of a length against the one before where
times do not tell."""
RATIO_SIGMA, RATIO_SHARE, LARGEST_RATIO = 0.0015, 0.2, 3.0
"""Least scatter of the length of a step against the one before (measured), what its stated scatter adds, the largest
there can be. An error of one step's points enters two ratios, the other way round: over many steps it adds little."""
ALONG_M, SMALLEST_M, SMALLEST_RAD = 2e-3, 1e-3, 1e-5
"""Scatter of a step along itself where its length is an unknown; the least there is of any step."""

Ratios = tuple[NDArray[np.int64], Array, Array]
"""Frames, logarithm of the stretch of the step to each over that of the step before, and its scatter."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Frames in order, each with the step from the one before; row 0 of the steps is not used.

    time_s (n,): times of capture. rotation (n, 3, 3), step (n, 3): of the camera in the axes of the one before, metres.
    covariance (n, 6, 6): of rotation vector (rad) and step (m). free (n,): the length is only known against that of the
    step before; ratio (n, 2): to it, by the pictures alone, and its scatter, nan where unknown.
    """

    time_s: Array
    rotation: Array
    step: Array
    covariance: Array
    free: NDArray[np.bool_]
    ratio: Array

    @property
    def length(self) -> Array:
        """Lengths of the steps (n,) as they came."""
        return np.asarray(np.maximum(np.linalg.norm(self.step, axis=1), 1e-6))

    @property
    def gap_s(self) -> Array:
        """Time since the frame before (n,), nought at the first."""
        return np.diff(self.time_s, prepend=self.time_s[:1])

    def spread(self) -> Array:
        """Covariance (n, 6, 6) of the steps; without the length where that is an unknown of its own."""
        result = self.covariance.copy()
        free = self.free
        ahead = self.step[free] / self.length[free, None]
        away = np.eye(3) - ahead[:, :, None] * ahead[:, None]
        result[free, 3:] = away @ result[free, 3:]
        result[free, :, 3:] = result[free, :, 3:] @ away
        result[free, 3:, 3:] += ALONG_M**2 * ahead[:, :, None] * ahead[:, None]
        return result + np.diag([SMALLEST_RAD**2] * 3 + [SMALLEST_M**2] * 3)

    def compared(self) -> Ratios:
        """Lengths against those before by the pictures, where these tell."""
        rows = self._neighbours()
        ratio, scatter = self.ratio[rows].T
        with np.errstate(invalid="ignore"):
            known = (ratio > 1 / LARGEST_RATIO) & (ratio < LARGEST_RATIO) & np.isfinite(scatter)
        rows, ratio, scatter = rows[known], ratio[known], scatter[known]
        sigma = np.hypot(RATIO_SHARE * scatter / ratio, RATIO_SIGMA)
        return rows, np.log(ratio) - self._given(rows), sigma

    def steady(self) -> Ratios:
        """Lengths against those before at a steady speed; where times do not tell, just alike."""
        rows = self._neighbours()
        now, before = self.gap_s[rows], self.gap_s[rows - 1]
        timed = (now > STAMP_S) & (before > STAMP_S)
        now, before = np.where(timed, now, 1.0), np.where(timed, before, 1.0)
        faster = ACCELERATION * 0.5 * (now + before) * now / self.length[rows]
        stamps = STAMP_S * np.sqrt(now**-2 + before**-2 + 1 / (now * before))
        wanted = np.where(timed, np.log(now / before) - self._given(rows), 0.0)
        return rows, wanted, np.where(timed, np.hypot(faster, stamps), LIKE_LENGTH)

    def _neighbours(self) -> NDArray[np.int64]:
        """Frames whose step and that before are both of unknown length."""
        return 2 + np.flatnonzero(self.free[2:] & self.free[1:-1])

    def _given(self, rows: NDArray[np.int64]) -> Array:
        return np.asarray(np.log(self.length[rows] / self.length[rows - 1]))


@dataclass(frozen=True, slots=True)
class Seen:
    """What is known from outside: places of the frames `row` (m,), or of an arm's end on their cameras.

    place (m, 3), sigma (m, 3): metres, errors that are new each time; slow (n, 3): standard deviation at each frame of
    the error that fades over memory_s. turn (m, 3, 3), sigma_rad (m,): rotations, where they are known too. arm (3,):
    in the camera's axes. first_rad (3,): how sure the start is of the rotation of the first frame about each axis;
    level_rad: how level cameras are, frame by frame.
    """

    row: NDArray[np.int64]
    place: Array
    sigma: Array
    slow: Array
    memory_s: float
    arm: Array
    turn: Array | None
    sigma_rad: Array | None
    first_rad: Array
    level_rad: float
