"""How far the poses of a log scatter, learnt from the steps that images measure."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from wayside.schemas.frame import USUAL_SIGMA_M, USUAL_SIGMA_RAD, Frame
from wayside.stages.geometry import vector_from_rotation
from wayside.stages.kernels import Array
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.pair_adjustment import PairAdjustment

PRIOR_STEPS, MEMORY = 3, 60
"""Steps that the usual noise counts for, and steps that are remembered: a receiver loses and finds its signal."""
MEDIANS = np.array([1.386, 2.366])
"""Of chi squared with two and with three degrees of freedom: direction across the travel, rotation."""


@dataclass(slots=True)
class PoseNoise:
    """Variance (2,) of the positions, m^2, and rotations, rad^2, of poses whose log states none.

    A pose is compared with the adjusted step, which rests on it in part. The mean square of its error is the square of
    the difference plus the variance of the adjusted step: the expectation step of Dempster, Laird and Rubin (1977).
    Medians over the last steps keep single wrong poses and steps from counting. Only directions show the error of
    positions, so it includes what the rotation of the earlier pose adds to them.
    """

    variance: Array = field(default_factory=lambda: np.array([USUAL_SIGMA_M, USUAL_SIGMA_RAD]) ** 2)
    squares: deque[Array] = field(init=False)

    def __post_init__(self) -> None:
        self.squares = deque([self.variance] * PRIOR_STEPS, maxlen=MEMORY)

    def of(self, frame: Frame) -> Frame:
        """The frame with the noise learnt so far in its pose, where it has one."""
        if frame.pose is None:
            return frame
        sigma_m, sigma_rad = frame.pose.sigmas(*np.sqrt(self.variance).tolist())
        return replace(frame, pose=replace(frame.pose, sigma_m=sigma_m, sigma_rad=sigma_rad))

    def learn(self, expected: MotionPrior, adjusted: PairAdjustment) -> None:
        """Take in a step that was expected by poses and adjusted to its images."""
        if expected.source not in ("poses", "odometry"):
            return
        rotation, direction = expected.straight
        turned = vector_from_rotation(adjusted.rotation @ rotation.T)
        aside = np.cross(adjusted.direction, direction)
        square = np.array([aside @ aside, turned @ turned]) / MEDIANS
        variance = np.diag(adjusted.covariance)
        square += variance[3:].sum() / 2, variance[:3].sum() / 3
        square[0] *= expected.prior.length_m**2
        self.squares.append(square / 2)  # two poses of the same noise
        self.variance = np.median(np.array(self.squares), axis=0)
