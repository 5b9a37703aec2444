"""How the camera is mounted on its vehicle, learnt from the steps: direction of travel and height above the road."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import isfinite, nan

import numpy as np

from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import halfway_direction
from wayside.stages.kernels import Array
from wayside.stages.odometry.motion_prior import TravelDirection
from wayside.stages.odometry.tie_points import GroundPlane


@dataclass(slots=True)
class Mount:
    """Running medians over the last steps.

    slopes (2,) of the direction of travel, heights (n,) of points, metres; by these, travel: direction as learnt so
    far, straight ahead before the mount is known, and height_m of the camera above the road, nan while unknown.
    """

    settings: MotionSettings
    slopes: deque[Array] = field(init=False)
    heights: deque[Array] = field(init=False)
    travel: TravelDirection = field(init=False)
    height_m: float = field(init=False, default=nan)

    def __post_init__(self) -> None:
        s = self.settings
        self.slopes = deque(maxlen=s.mount_memory)
        self.heights = deque(maxlen=s.height_memory)
        self.travel = TravelDirection(
            np.array([0.0, 0.0, 1.0]), np.radians([s.mount_sigma_deg] * 2)
        )

    def learn(self, rotation: Array, direction: Array, points: Array) -> None:
        """Take in an adjusted step and the points (n, 3) that were matched in it, in the camera's frame."""
        self.slopes.append(travel_slopes(rotation, direction))
        s = self.settings
        if len(self.slopes) >= s.mount_steps:
            middle = np.median(np.array(self.slopes), axis=0)
            direction = np.array([middle[0], middle[1], 1.0])
            sigma = np.radians([s.travel_right_sigma_deg, s.travel_up_sigma_deg])
            self.travel = TravelDirection(direction / np.linalg.norm(direction), sigma)
        self.heights.append(lane_heights(points, self.travel.direction, s))
        self.height_m = common_height(np.concatenate(self.heights), self.settings)

    def ground(self, baseline_m: float) -> GroundPlane | None:
        """The road under the camera for a step of that length, None while its height is unknown."""
        if not isfinite(self.height_m):
            return None
        return GroundPlane(road_down(self.travel.direction), self.height_m, baseline_m)


def travel_slopes(rotation: Array, direction: Array) -> Array:
    """Direction of travel in the axes half way through the rotation, as slopes x/z and y/z (2,)."""
    half = halfway_direction(np.ascontiguousarray(rotation.T), direction)
    return np.asarray(half[:2] / half[2])


def road_down(direction: Array) -> Array:
    """Normal (3,), unit, downwards, of a road that runs along `direction` (3,), in the camera's axes.

    The camera's roll against the road is taken as zero.
    """
    down = np.array([0.0, 1.0, 0.0]) - direction * direction[1]
    return np.asarray(down / np.linalg.norm(down))


def lane_heights(points: Array, direction: Array, settings: MotionSettings) -> Array:
    """Depth (m,) below the camera, metres, of those points (n, 3) that can lie on the vehicle's lane.

    The lane runs along the direction of travel (3,), in the same axes. Points that are nan are left out.
    """
    down = road_down(direction)
    right = np.cross(down, direction)
    ahead, heights = points @ direction, points @ down
    with np.errstate(invalid="ignore"):
        near = (np.abs(points @ right) < settings.lane_half_width_m) & (ahead > 0)
        near &= ahead < settings.lane_reach_m
        near &= (heights > settings.lowest_camera_m) & (heights < settings.highest_camera_m)
    return np.asarray(heights[near])


def common_height(heights: Array, settings: MotionSettings) -> float:
    """Height of the camera above the road: the median of the densest band of the heights (n,) of points on the lane.

    Points of the road lie in one plane, objects on it are scattered above. nan where no band has enough points.
    """
    ordered = np.sort(heights)
    if len(ordered) < settings.fewest_heights:
        return float("nan")
    end = np.searchsorted(ordered, ordered * (1 + settings.height_band), side="right")
    count = end - np.arange(len(ordered))
    first = int(count.argmax())
    if count[first] < settings.fewest_heights:
        return float("nan")
    return float(np.median(ordered[first : end[first]]))
