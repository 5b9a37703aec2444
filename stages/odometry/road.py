"""The road below the camera, from points triangulated on it."""

from __future__ import annotations

import numpy as np

from wayside.stages.kernels import Array

LANE_M, REACH_M = 3.0, 18.0
LOWEST_M, HIGHEST_M = 0.8, 3.2
"""Heights a camera on a road vehicle can have; a vehicle that drives ahead can look like a road further down."""
BAND, FEWEST = 0.06, 8


def road_down(direction: Array) -> Array:
    """Unit vector (3,) at right angles to a road that runs along `direction` (3,), in the camera frame.

    Down as the camera sees it: its roll against the road is taken as nought.
    """
    down = np.array([0.0, 1.0, 0.0]) - direction * direction[1]
    return np.asarray(down / np.linalg.norm(down))


def lane_heights(points: Array, direction: Array) -> Array:
    """How far points (n, 3) on the vehicle's lane lie below the camera, metres: (m,), in no order.

    The lane runs along the direction of travel (3,), in the same camera frame. Points that are nan are left out.
    """
    down = road_down(direction)
    right = np.cross(down, direction)
    ahead, heights = points @ direction, points @ down
    with np.errstate(invalid="ignore"):
        near = (np.abs(points @ right) < LANE_M) & (ahead > 0) & (ahead < REACH_M)
        near &= (heights > LOWEST_M) & (heights < HIGHEST_M)
    return np.asarray(heights[near])


def common_height(heights: Array) -> float:
    """Height of the camera above the road: the middle of the densest band of heights (n,) of points on the lane.

    Points of the road lie together, what stands on it is scattered above. nan where fewer than eight share a band.
    """
    ordered = np.sort(heights)
    if len(ordered) < FEWEST:
        return float("nan")
    end = np.searchsorted(ordered, ordered * (1 + BAND), side="right")
    count = end - np.arange(len(ordered))
    first = int(count.argmax())
    if count[first] < FEWEST:
        return float("nan")
    return float(np.median(ordered[first : end[first]]))
