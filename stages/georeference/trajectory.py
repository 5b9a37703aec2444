"""The path of a camera over a whole drive: steps exact between neighbours, positions from outside bound their drift.

One least-squares problem over all frames, solved by Gauss-Newton with robust weights. Each frame has eleven unknowns:
centre, rotation, logarithm of the length of the step to it, the slow part of the outside error (three) and the lag of
the outside clock. Every measurement touches one frame or two neighbours, so the cost is in proportion to the drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.stages.geometry import cross_matrices
from wayside.stages.georeference.banded import BandedNormal, scatter_of_blocks
from wayside.stages.georeference.measurements import SMALLEST_RAD, Chain, Seen
from wayside.stages.kernels import Array

CENTRE, TURN, LENGTH, SLOW, LAG = slice(0, 3), slice(3, 6), 6, slice(7, 10), 10
SIZE, PLACED = 11, 7
"""Unknowns of a frame, and how many of them tell where it is."""
ROUNDS, SETTLED_M = 50, 1e-4
SURE_LENGTH, FREE_LENGTH = 1e-4, 0.3
"""Relative scatter of a length that is measured, and of one that is not."""
LAG_SIGMA_S, LAG_STEP_S = 0.5, 1e-5
LAG_SIGMAS, LEAST_LAG_S = 4.0, 0.02
"""A lag counts where it is so many of its standard deviations and so long."""
STEP_REACH, SEEN_REACH, RATIO_REACH = 6.0, 3.0, 6.0
"""Standard deviations at which a measurement weighs half (Cauchy)."""
OUTLIER_WEIGHT, JUMP_WEIGHT, NO_WEIGHT = 0.05, 0.3, 1e-6


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Where the camera was: rotation (n, 3, 3), centre (n, 3); stretch (n,): length of each step over that given.

    covariance (n, 7, 7): of centre (m), rotation vector about the world's axes (rad), logarithm of the stretch.
    weight (m,): of what was seen, near 0 where it does not fit. lag_s: how long after a picture's moment its place is
    reported, 0 where none is found.
    """

    rotation: Array
    centre: Array
    stretch: Array
    covariance: Array
    weight: Array
    lag_s: float
    lag_sigma_s: float

    @property
    def outliers(self) -> int:
        """How many of the places seen do not fit."""
        return int((self.weight < OUTLIER_WEIGHT).sum())


def smooth(chain: Chain, seen: Seen, rotation: Array, centre: Array) -> Trajectory:
    """The trajectory that fits steps and places best.

    A constant lag of the outside clock is found and undone where the drive tells it for sure.

    Parameters
    ----------
    rotation, centre
        (n, 3, 3) and (n, 3): where to start; tens of metres and some degrees away at most.
    """
    lagging = _Fit(chain, seen, rotation, centre, LAG_SIGMA_S).run()
    sure = abs(lagging.lag_s) > max(LAG_SIGMAS * lagging.lag_sigma_s, LEAST_LAG_S)
    if sure:
        return lagging
    prompt = _Fit(chain, seen, lagging.rotation, lagging.centre, LAG_STEP_S).run()
    return replace(prompt, lag_s=0.0, lag_sigma_s=lagging.lag_sigma_s)


class _Fit:
    """One adjustment; each part adds its measurements to the normal equations."""

    def __init__(
        self, chain: Chain, seen: Seen, rotation: Array, centre: Array, lag_sigma_s: float
    ) -> None:
        self.chain, self.seen, self.lag_sigma_s = chain, seen, lag_sigma_s
        self.first, self.rotation, self.centre = rotation[:1].copy(), rotation.copy(), centre.copy()
        n = len(centre)
        self.stretch, self.slow, self.lag = np.zeros(n), np.zeros((n, 3)), np.zeros(n)
        self.root = _inverse_root(chain.spread())
        self.weight = np.ones(len(seen.row))
        self.follow = not seen.slow.any()

    def run(self) -> Trajectory:
        """Gauss-Newton until nothing moves.

        At first the slow error counts as new each time: else it would follow a jump of the fixes, which then fits.
        What does not fit by then is out when the slow error begins to follow the others.
        """
        fitting = None
        if self.seen.slow.any():
            self._settle(None)
            self.follow, fitting = True, np.where(self.weight < JUMP_WEIGHT, NO_WEIGHT, 1.0)
        factor = self._settle(fitting)
        own = scatter_of_blocks(factor, SIZE)
        return Trajectory(
            self.rotation,
            self.centre,
            np.exp(self.stretch),
            own[:, :PLACED, :PLACED],
            self.weight,
            float(self.lag[0]),
            float(np.sqrt(own[0, LAG, LAG])),
        )

    def _settle(self, weight: Array | None) -> Array:
        """Adjust until nothing moves, in the first round with these weights; the factor of the last equations."""
        factor = np.zeros((2 * SIZE, 0))
        for _ in range(ROUNDS):
            normal = BandedNormal(len(self.centre), SIZE)
            self._add_beliefs(normal)
            self._add_steps(normal)
            self._add_ratios(normal)
            self._add_seen(normal, weight)
            weight = None
            change, factor = normal.solve()
            self._move(change)
            if np.abs(change[:, CENTRE]).max() < SETTLED_M:
                break
        return factor

    def _move(self, change: Array) -> None:
        self.centre += change[:, CENTRE]
        self.rotation = _turned(self.rotation, change[:, TURN])
        self.stretch += change[:, LENGTH]
        self.slow += change[:, SLOW]
        self.lag += change[:, LAG]

    def _add_beliefs(self, normal: BandedNormal) -> None:
        """What is believed of each unknown beforehand; the slow error fades (first-order Gauss-Markov)."""
        n = len(self.centre)
        every, later = np.arange(n), np.arange(1, n)
        sigma = np.where(self.chain.free, FREE_LENGTH, SURE_LENGTH)
        _add(normal, every, (LENGTH,), np.ones((n, 1, 1)), -self.stretch[:, None], sigma[:, None])
        keeps = np.exp(-np.maximum(self.chain.gap_s[1:], 0.0) / self.seen.memory_s)
        fresh = np.sqrt(np.maximum(1 - keeps**2, 1e-8))
        for axis in range(SLOW.start, SLOW.stop):
            u = self.slow[:, axis - SLOW.start]
            _add(normal, every[:1], (axis,), np.ones((1, 1, 1)), -u[:1, None], np.ones((1, 1)))
            slopes = np.stack([np.ones(n - 1), -keeps], axis=1)[:, None]
            gap = (keeps * u[:-1] - u[1:])[:, None]
            _add(normal, later, (axis, axis - SIZE), slopes, gap, fresh[:, None])
        sigma = np.full((1, 1), self.lag_sigma_s)
        _add(normal, every[:1], (LAG,), np.ones((1, 1, 1)), -self.lag[:1, None], sigma)
        slopes = np.tile([1.0, -1.0], (n - 1, 1, 1))
        gap = -np.diff(self.lag)[:, None]
        _add(normal, later, (LAG, LAG - SIZE), slopes, gap, np.full((n - 1, 1), LAG_STEP_S))

    def _add_steps(self, normal: BandedNormal) -> None:
        """The steps: rotation and translation in the axes of the camera before."""
        chain = self.chain
        n = len(self.centre)
        if n < 2:
            return
        back = self.rotation[:-1].transpose(0, 2, 1)
        way = np.diff(self.centre, axis=0)
        wanted = np.exp(self.stretch[1:, None]) * chain.step[1:]
        turn = back @ self.rotation[1:] @ chain.rotation[1:].transpose(0, 2, 1)
        residual = np.concatenate([_vector(turn), _times(back, way) - wanted], axis=1)
        slopes = np.zeros((n - 1, 6, 13))
        slopes[:, :3, 3:6], slopes[:, :3, 9:12] = -back, back
        slopes[:, 3:, :3], slopes[:, 3:, 6:9] = -back, back
        slopes[:, 3:, 3:6] = back @ cross_matrices(way)
        slopes[:, 3:, 12] = -wanted
        root = self.root[1:]
        white, slopes = -_times(root, residual), root @ slopes
        weight = _cauchy((white**2).sum(axis=1), 6, STEP_REACH)
        columns = (*range(-SIZE, 6 - SIZE), *range(7))
        _add_weighted(normal, np.arange(1, n), columns, slopes, white, weight)

    def _add_ratios(self, normal: BandedNormal) -> None:
        """Lengths of neighbouring steps against each other."""
        for rows, wanted, sigma in (self.chain.compared(), self.chain.steady()):
            white = (wanted - self.stretch[rows] + self.stretch[rows - 1]) / sigma
            weight = _cauchy(white**2, 1, RATIO_REACH)
            slopes = np.stack([1 / sigma, -1 / sigma], axis=1)[:, None]
            columns = (LENGTH, LENGTH - SIZE)
            _add_weighted(normal, rows, columns, slopes, white[:, None], weight)

    def _add_seen(self, normal: BandedNormal, weight: Array | None) -> None:
        """Places and rotations from outside, of a moment `lag` before the picture's; how level cameras are."""
        seen, rows = self.seen, self.seen.row
        m = len(rows)
        arm, speed = self.rotation[rows] @ seen.arm, self._speed()[rows]
        slow = seen.slow[rows] * self.follow
        place = self.centre[rows] + arm + slow * self.slow[rows] - speed * self.lag[rows, None]
        slopes = np.zeros((m, 6, SIZE))
        slopes[:, :3, CENTRE] = np.eye(3)
        slopes[:, :3, TURN] = -cross_matrices(arm)
        slopes[:, [0, 1, 2], [7, 8, 9]] = slow
        slopes[:, :3, LAG] = -speed
        residual = np.zeros((m, 6))
        residual[:, :3] = seen.place - place
        sigma = np.ones((m, 6))
        sigma[:, :3] = seen.sigma if self.follow else np.hypot(seen.sigma, seen.slow[rows])
        if seen.turn is not None and seen.sigma_rad is not None:
            spin = self._spin()[rows]
            apart = _vector(seen.turn @ self.rotation[rows].transpose(0, 2, 1))
            residual[:, 3:] = apart + spin * self.lag[rows, None]
            slopes[:, 3:, TURN] = np.eye(3)
            slopes[:, 3:, LAG] = -spin
            sigma[:, 3:] = seen.sigma_rad[:, None]
        white, slopes = residual / sigma, slopes / sigma[:, :, None]
        freedom = 3 if seen.turn is None else 6
        fitting = _cauchy((white**2).sum(axis=1), freedom, SEEN_REACH)
        self.weight = fitting if weight is None else weight
        _add_weighted(normal, rows, range(SIZE), slopes, white, self.weight)
        self._add_level(normal)

    def _add_level(self, normal: BandedNormal) -> None:
        """The camera's x axis lies level, more or less; the first frame is turned as the start has it."""
        seen, n = self.seen, len(self.centre)
        if np.isfinite(seen.level_rad):
            right = self.rotation[:, :, 0]
            slopes = np.stack([right[:, 1], -right[:, 0]], axis=1)[:, None]
            sigma = np.full((n, 1), seen.level_rad)
            _add(normal, np.arange(n), (3, 4), slopes, -right[:, 2:], sigma)
        apart = _vector(self.first @ self.rotation[:1].transpose(0, 2, 1))
        _add(normal, np.zeros(1, int), range(3, 6), np.eye(3)[None], apart, seen.first_rad[None])

    def _speed(self) -> Array:
        """Velocity of each frame (n, 3), m/s, nought where times do not tell."""
        return _rate(self.centre[2:] - self.centre[:-2], self.chain.time_s, len(self.centre))

    def _spin(self) -> Array:
        """Rotation rate (n, 3), rad/s, about the world's axes."""
        turn = _vector(self.rotation[2:] @ self.rotation[:-2].transpose(0, 2, 1))
        return _rate(turn, self.chain.time_s, len(self.centre))


def _rate(change: Array, time_s: Array, n: int) -> Array:
    result = np.zeros((n, 3))
    if n < 3:
        return result
    gap = time_s[2:] - time_s[:-2]
    result[1:-1] = np.where(gap[:, None] > 1e-3, change / np.maximum(gap, 1e-3)[:, None], 0.0)
    result[0], result[-1] = result[1], result[-2]
    return result


def _inverse_root(covariance: Array) -> Array:
    """Matrices (n, 6, 6) that make errors of these covariances white; what rounding left below nought is sure."""
    values, axes = np.linalg.eigh(covariance)
    least = SMALLEST_RAD**2
    return np.asarray(axes / np.sqrt(np.maximum(values, least))[:, None] @ axes.transpose(0, 2, 1))


def _cauchy(squares: Array, freedom: int, reach: float) -> Array:
    """Weights of residuals by their squares in standard deviations; while most are far off, far is near."""
    if len(squares) == 0:
        return np.ones(0)
    each = squares / freedom
    usual = max(1.0, float(np.median(each)))
    return np.asarray(1 / (1 + each / (reach**2 * usual)))


def _add(
    normal: BandedNormal,
    block: NDArray[np.int64],
    columns: Sequence[int],
    slopes: Array,
    residual: Array,
    sigma: Array,
) -> None:
    normal.add(block, columns, slopes / sigma[:, :, None], residual / sigma)


def _add_weighted(
    normal: BandedNormal,
    block: NDArray[np.int64],
    columns: Sequence[int],
    slopes: Array,
    white: Array,
    weight: Array,
) -> None:
    root = np.sqrt(weight)[:, None]
    normal.add(block, columns, slopes * root[:, :, None], white * root)


def _turned(rotation: Array, vector: Array) -> Array:
    """Rotations (n, 3, 3) turned further about the world's axes, kept orthonormal."""
    more = Rotation.from_rotvec(vector) * Rotation.from_matrix(rotation)
    return np.asarray(more.as_matrix())


def _vector(matrices: Array) -> Array:
    return np.asarray(Rotation.from_matrix(matrices).as_rotvec())


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])
