"""What a drive teaches about the camera on its vehicle: which way it is mounted, and how high."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import halfway_direction
from wayside.stages.odometry.motion_prior import TravelDirection
from wayside.stages.odometry.road import common_height, lane_heights, road_down
from wayside.stages.odometry.tie_points import GroundPlane

MOUNT_SIGMA, LAW_SIGMA = np.radians([1.5, 1.5]), np.radians([0.35, 0.25])
"""Scatter of the direction of travel sideways and up: before the mount is known, and about it."""
LAW_LIMIT = np.radians([1.2, 0.9])
"""A step that strays further from the law has followed something else than the road."""
FEWEST_STEPS, MOUNT_MEMORY, HEIGHT_MEMORY = 3, 61, 300
"""Steps until the mount counts as known, and over which mount and height are remembered."""


@dataclass(slots=True)
class Mount:
    """Running medians over the last steps; always the same for the same steps."""

    mounts: deque[Array] = field(default_factory=lambda: deque(maxlen=MOUNT_MEMORY))
    heights: deque[Array] = field(default_factory=lambda: deque(maxlen=HEIGHT_MEMORY))

    def learn(self, rotation: Array, direction: Array, points: Array) -> None:
        """Take in an adjusted step and the points (n, 3) that were matched in it, in the camera's frame."""
        self.mounts.append(travel_slopes(rotation, direction))
        self.heights.append(lane_heights(points, self.law.direction))

    @property
    def law(self) -> TravelDirection:
        """Direction of travel as learnt so far, straight ahead at first."""
        if len(self.mounts) < FEWEST_STEPS:
            return TravelDirection(np.array([0.0, 0.0, 1.0]), MOUNT_SIGMA)
        slopes = np.median(np.array(self.mounts), axis=0)
        direction = np.array([slopes[0], slopes[1], 1.0])
        return TravelDirection(direction / np.linalg.norm(direction), LAW_SIGMA)

    @property
    def height_m(self) -> float:
        """Height of the camera above the road, nan while unknown."""
        return common_height(np.concatenate([*self.heights, np.zeros(0)]))

    def strays(self, rotation: Array, direction: Array) -> bool:
        """Whether a step goes where this vehicle cannot."""
        known = len(self.mounts) >= FEWEST_STEPS
        limit = LAW_LIMIT if known else LAW_LIMIT + 2 * MOUNT_SIGMA
        law = self.law.direction
        away = np.abs(travel_slopes(rotation, direction) - law[:2] / law[2])
        return bool((away > limit).any())

    def ground(self, baseline_m: float) -> GroundPlane | None:
        """The road under the camera for a step of that length, None while its height is unknown."""
        height = self.height_m
        if not np.isfinite(height):
            return None
        return GroundPlane(road_down(self.law.direction), height, baseline_m)


def travel_slopes(rotation: Array, direction: Array) -> Array:
    """Direction of travel in the axes half way through the turn, as slopes x/z and y/z (2,)."""
    half = halfway_direction(np.ascontiguousarray(rotation.T), direction)
    return np.asarray(half[:2] / half[2])
