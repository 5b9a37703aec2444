"""How the camera is mounted on its vehicle, learnt from the steps: direction of travel and height above the road."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import halfway_direction
from wayside.stages.kernels import Array
from wayside.stages.odometry.motion_prior import TravelDirection
from wayside.stages.odometry.tie_points import GroundPlane


@dataclass(slots=True)
class Mount:
    """Running medians over the last steps: slopes (2,) of the direction of travel, heights (n,) of points, metres."""

    settings: MotionSettings
    slopes: deque[Array] = field(init=False)
    heights: deque[Array] = field(init=False)

    def __post_init__(self) -> None:
        self.slopes = deque(maxlen=self.settings.mount_memory)
        self.heights = deque(maxlen=self.settings.height_memory)

    def learn(self, rotation: Array, direction: Array, points: Array) -> tuple[Array, Array]:
        """Take in an adjusted step and the points (n, 3) that were matched in it, in the camera's frame.

        Returns what was learned, for `take`: slopes (2,) and heights (n,).
        """
        self.slopes.append(travel_slopes(rotation, direction))
        self.heights.append(lane_heights(points, self.travel.direction, self.settings))
        return self.slopes[-1], self.heights[-1]

    def copy(self) -> Mount:
        """The same, apart from this one."""
        twin = Mount(self.settings)
        twin.slopes.extend(self.slopes)
        twin.heights.extend(self.heights)
        return twin

    def take(self, slopes: Array, heights: Array) -> None:
        """Take in what `learn` returned."""
        self.slopes.append(slopes)
        self.heights.append(heights)

    @property
    def known(self) -> bool:
        """Whether enough steps have been learnt."""
        return len(self.slopes) >= self.settings.mount_steps

    @property
    def travel(self) -> TravelDirection:
        """Direction of travel as learnt so far; straight ahead before the mount is known."""
        s = self.settings
        if not self.known:
            sigma = np.radians([s.mount_sigma_deg, s.mount_sigma_deg])
            return TravelDirection(np.array([0.0, 0.0, 1.0]), sigma)
        slopes = np.median(np.array(self.slopes), axis=0)
        direction = np.array([slopes[0], slopes[1], 1.0])
        sigma = np.radians([s.travel_right_sigma_deg, s.travel_up_sigma_deg])
        return TravelDirection(direction / np.linalg.norm(direction), sigma)

    @property
    def height_m(self) -> float:
        """Height of the camera above the road, nan while unknown."""
        return common_height(np.concatenate([*self.heights, np.zeros(0)]), self.settings)

    def ground(self, baseline_m: float) -> GroundPlane | None:
        """The road under the camera for a step of that length, None while its height is unknown."""
        height = self.height_m
        if not np.isfinite(height):
            return None
        return GroundPlane(road_down(self.travel.direction), height, baseline_m)


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
