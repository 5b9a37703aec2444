"""The road below the camera, from points triangulated on it."""

from __future__ import annotations

import numpy as np

from wayside.stages.numerics.compiled import Array

LANE_M, REACH_M = 3.0, 35.0
LOWEST_M, HIGHEST_M = 0.5, 5.0
"""Heights a camera on a road vehicle can have."""
BAND, FEWEST = 0.06, 5


def camera_height(points: Array, direction: Array) -> float:
    """Height of the camera above the road, metres, from points (n, 3) in its frame.

    The road runs along the direction of travel (3,) and its points lie together at one height below the camera; what
    stands on it is scattered above. Returns the median of the densest band of heights, nan where fewer than five
    points share one.
    """
    up = np.array([0.0, 1.0, 0.0])
    down = up - direction * direction[1]
    down /= np.linalg.norm(down)
    right = np.cross(down, direction)
    ahead = points @ direction
    heights = points @ down
    with np.errstate(invalid="ignore"):
        near = (np.abs(points @ right) < LANE_M) & (ahead > 0) & (ahead < REACH_M)
        near &= (heights > LOWEST_M) & (heights < HIGHEST_M)
    sorted_heights = np.sort(heights[near])
    if len(sorted_heights) < FEWEST:
        return float("nan")
    end = np.searchsorted(sorted_heights, sorted_heights * (1 + BAND), side="right")
    count = end - np.arange(len(sorted_heights))
    first = int(count.argmax())
    if count[first] < FEWEST:
        return float("nan")
    return float(np.median(sorted_heights[first : end[first]]))
