"""How the camera is mounted on its vehicle, learnt from the steps: direction of travel and height above the road."""

from collections import deque
from dataclasses import dataclass, field
from math import isfinite, nan

import numpy as np

from wayside.stages.geometry import halfway_direction
from wayside.stages.kernels import Array, compiled
from wayside.stages.odometry.motion_prior import TravelDirection
from wayside.stages.odometry.tie_points import GroundPlane

MOUNT_SIGMA_DEG = 1.5
"""Scatter of the direction of travel while the mount is unknown."""
TRAVEL_SIGMA_DEG = 0.35, 0.25
"""Scatter of the direction of travel sideways and up (measured; the drives are not on record)."""
MOUNT_STEPS, MOUNT_MEMORY = 3, 61
"""Steps until the mount counts as known, and those that it is the median of at most."""
HEIGHT_MEMORY = 300
"""Steps that the height above the road is found from."""
LANE_HALF_WIDTH_M, LANE_REACH_M = 3.0, 18.0
"""Points further to the side or ahead give no height."""
LOWEST_CAMERA_M, HIGHEST_CAMERA_M = 0.8, 3.2
"""Heights of cameras above the road: a vehicle ahead can resemble a road further down."""
HEIGHT_BAND, FEWEST_HEIGHTS = 0.06, 8
"""Relative width of the band of heights that counts as road, and the points in it at least."""


@dataclass(slots=True)
class Mount:
    """Running medians over the last steps.

    `slopes` (k, 2): x/z and y/z of the direction of travel half way through a step. `heights` (n,): of points, metres,
    so many of each step. `travel`: the direction as learnt so far, straight ahead before the mount is known.
    `height_m`: of the camera above the road, nan while unknown.
    """

    slopes: Array = field(default_factory=lambda: np.zeros((0, 2)))
    heights: Array = field(default_factory=lambda: np.zeros(0))
    counts: deque[int] = field(default_factory=lambda: deque([0] * HEIGHT_MEMORY, HEIGHT_MEMORY))
    travel: TravelDirection = field(
        default_factory=lambda: TravelDirection(
            np.array([0.0, 0.0, 1.0]), np.radians([MOUNT_SIGMA_DEG] * 2)
        )
    )
    height_m: float = nan

    def learn(self, rotation: Array, direction: Array, points: Array) -> None:
        """Take in an adjusted step and the points (n, 3) that were matched in it, in the camera's frame."""
        half = halfway_direction(np.ascontiguousarray(rotation.T), direction)
        self.slopes = np.vstack([self.slopes, half[:2] / half[2]])[-MOUNT_MEMORY:]
        if len(self.slopes) >= MOUNT_STEPS:
            middle = np.median(self.slopes, axis=0)
            direction = np.array([middle[0], middle[1], 1.0])
            sigma = np.radians(TRAVEL_SIGMA_DEG)
            self.travel = TravelDirection(direction / np.linalg.norm(direction), sigma)
        fresh = lane_heights(points, self.travel.direction)
        self.heights = np.concatenate([self.heights[self.counts[0] :], fresh])
        self.counts.append(len(fresh))
        self.height_m = common_height(self.heights)

    def ground(self, baseline_m: float) -> GroundPlane | None:
        """The road under the camera for a step of that length, None while its height is unknown."""
        if not isfinite(self.height_m):
            return None
        return GroundPlane(road_down(self.travel.direction), self.height_m, baseline_m)


def road_down(direction: Array) -> Array:
    """Normal (3,), unit, downwards, of a road that runs along `direction` (3,), in the camera's axes.

    The camera's roll against the road is taken as zero.
    """
    down = np.array([0.0, 1.0, 0.0]) - direction * direction[1]
    return np.asarray(down / np.linalg.norm(down))


def lane_heights(points: Array, direction: Array) -> Array:
    """Depth (m,) below the camera, metres, of those points (n, 3) that can lie on the vehicle's lane.

    The lane runs along the direction of travel (3,), in the same axes. Points that are nan are left out.
    """
    down = road_down(direction)
    right = np.cross(down, direction)
    ahead, heights = points @ direction, points @ down
    with np.errstate(invalid="ignore"):
        near = (np.abs(points @ right) < LANE_HALF_WIDTH_M) & (ahead > 0)
        near &= ahead < LANE_REACH_M
        near &= (heights > LOWEST_CAMERA_M) & (heights < HIGHEST_CAMERA_M)
    return np.asarray(heights[near])


def common_height(heights: Array) -> float:
    """Height of the camera above the road: the median of the densest band of the heights (n,) of points on the lane.

    Points of the road lie in one plane, objects on it are scattered above. nan where no band has enough points.
    """
    ordered = np.sort(heights)
    first, end = _densest(ordered)
    if end - first < FEWEST_HEIGHTS:
        return nan
    return float(ordered[(first + end - 1) // 2] + ordered[(first + end) // 2]) / 2


@compiled
def _densest(ordered: Array) -> tuple[int, int]:
    # Where the first of the bands begins and ends that has the most of some numbers in order.
    most, begin, end = 0, 0, 0
    for first in range(len(ordered)):
        while end < len(ordered) and ordered[end] <= ordered[first] * (1 + HEIGHT_BAND):
            end += 1
        if end - first > most:
            most, begin = end - first, first
    return begin, begin + most
