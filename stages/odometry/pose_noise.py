"""How far the poses of a log scatter, learnt from the steps that images measure."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from wayside.schemas.frame import Frame
from wayside.stages.geometry import vector_from_rotation
from wayside.stages.kernels import Array
from wayside.stages.odometry.motion_prior import MotionPrior
from wayside.stages.odometry.pair_adjustment import PairAdjustment

PRIOR_STEPS, MEMORY = 3, 60
"""Steps that what the log states counts for, and steps that are remembered: a receiver loses and finds its signal."""
MEDIANS = np.array([1.386, 2.366])
"""Of chi squared with two and with three degrees of freedom: direction across the travel, rotation."""


@dataclass(slots=True)
class PoseNoise:
    """Variance of poses over that which their log states: factors (2,) of positions and of rotations.

    A pose is compared with the adjusted step, which rests on it in part. The mean square of its error is the square of
    the difference plus the variance of the adjusted step: the expectation step of Dempster, Laird and Rubin (1977).
    Medians over the last steps keep single wrong poses and steps from counting. Only directions show the error of
    positions, so it includes what the rotation of the earlier pose adds to them.
    """

    squares: deque[Array] = field(
        default_factory=lambda: deque([np.ones(2)] * PRIOR_STEPS, maxlen=MEMORY)
    )
    factors: Array = field(default_factory=lambda: np.ones(2))

    def of(self, frame: Frame) -> Frame:
        """The frame with the noise learnt so far in its pose, where it has one."""
        if frame.pose is None:
            return frame
        sigma_m, sigma_rad = np.array(frame.pose.sigmas()) * np.sqrt(self.factors)
        pose = replace(frame.pose, sigma_m=float(sigma_m), sigma_rad=float(sigma_rad))
        return replace(frame, pose=pose)

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
        prior = expected.prior
        stated = np.array([prior.sigma_m / prior.length_m, prior.sigma_rotation]) ** 2
        self.squares.append(square / stated * self.factors)
        self.factors = np.median(np.array(self.squares), axis=0)
