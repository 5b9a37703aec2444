"""One row a panel: legend, face and frame are segments of one plane (report chapters 8 and 11)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark, TrackedFrame

# Set on learning drives.
DEPTH_SIGMAS, DEPTH_M = 2.5, 0.6
"""Depths of one plane differ by less: standard deviations of both, and at least metres."""


def merge_segments(tracked: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Of accepted landmarks that are one panel keep the one of most evidence; the others become a `duplicate`.

    Frames come out in order, when the camera has passed their landmarks: then all other landmarks there are known.
    """
    waiting: deque[TrackedFrame] = deque()
    known: list[Landmark] = []
    station = 0.0
    for frame in tracked:
        waiting.append(frame)
        known += accepted(frame)
        if frame.motion is not None:
            station = frame.motion.station_m
        while waiting and all(one.station_m < station for one in accepted(waiting[0])):
            first = waiting.popleft()
            yield _merged(first, known)
            if first.motion is not None:
                passed = first.motion.station_m
                known = [one for one in known if one.station_m > passed]
    yield from (_merged(frame, known) for frame in waiting)


def accepted(frame: TrackedFrame) -> list[Landmark]:
    """Landmarks of a frame that are signs so far."""
    return [one for one in frame.landmarks if one.verdict == "sign"]


def _merged(frame: TrackedFrame, known: list[Landmark]) -> TrackedFrame:
    landmarks = (
        replace(one, verdict="duplicate")
        if one.verdict == "sign"
        and any(_rank(other) > _rank(one) and same_plane(one, other) for other in known)
        else one
        for one in frame.landmarks
    )
    return replace(frame, landmarks=tuple(landmarks))


def _rank(one: Landmark) -> tuple[float, int]:
    return sum(ratio for _, ratio in one.evidence), -one.track_id


def same_plane(one: Landmark, other: Landmark) -> bool:
    """Whether two landmarks overlap, as the camera that sees one of them nearest sees both, at one depth."""
    variance = one.covariance[2, 2] + other.covariance[2, 2]
    if abs(one.station_m - other.station_m) > max(DEPTH_M, DEPTH_SIGMAS * float(np.sqrt(variance))):
        return False
    camera = min(one, other, key=lambda each: float(each.position[2])).best_pose
    first, second = _box_seen(camera, one), _box_seen(camera, other)
    shared = np.minimum(first[1], second[1]) - np.maximum(first[0], second[0])
    return bool((shared > 0).all())


def _box_seen(camera: Pose, one: Landmark) -> NDArray[np.float64]:
    """Least and largest x/z and y/z (2, 2) of a landmark."""
    centre = camera.to_camera(one.best_pose.to_world(one.position))
    half = np.array([one.width_m, one.height_m]) / 2
    return np.asarray(np.stack([centre[:2] - half, centre[:2] + half]) / centre[2])
