"""Which world the results stand in: the log's poses, the fixes' east-north-up, or the drive's own start.

World axes: x, y level, z up, metres. The chain of camera motions is exact between neighbours but drifts; a world pose
places one camera, and everything near it is placed relative to that camera.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from wayside.schemas.frame import Fix, Pose
from wayside.stages.numerics.path import Beside, beside_path

BEFORE, AFTER = 3, 20
"""Used frames around the best view of a sign among which the camera passes it."""


@dataclass(frozen=True, slots=True)
class PathPoint:
    """What one used frame knows of its place: chained pose, the log's own pose and fix where given."""

    frame: int
    chained: Pose
    given: Pose | None
    fix: Fix | None


@dataclass(frozen=True, slots=True)
class World:
    """World poses of the used frames by index; `earth` maps world metres to WGS 84 where fixes exist."""

    name: str  # "log", "enu" or "drive_start"
    poses: dict[int, Pose]
    earth: Earth | None


@dataclass(frozen=True, slots=True)
class Earth:
    """East-north-up frame at an origin on WGS 84, turned and shifted from the world frame."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    rotation: NDArray[np.float64]  # (3, 3) east-north-up from world
    shift: NDArray[np.float64]  # (3,) metres

    def geodetic(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Longitude, latitude (deg) and ellipsoidal height (m) of world points (n, 3)."""
        local = points @ self.rotation.T + self.shift
        pipeline = _topocentric(self.latitude_deg, self.longitude_deg, self.altitude_m)
        lon, lat, height = pipeline.transform(
            local[:, 0], local[:, 1], local[:, 2], direction="INVERSE"
        )
        return np.stack([np.asarray(lon), np.asarray(lat), np.asarray(height)], axis=1)


def beside_in_world(
    world: World, frames: Sequence[int], frame: int, point: NDArray[np.float64]
) -> Beside | None:
    """Offset of a point (3,) from the path near a frame, by the world's own up; None where only cameras know up.

    A camera rolled by half a degree puts a panel 8 m aside 7 cm too high or low; given poses know better.

    Parameters
    ----------
    frames
        All frames that have a pose in the world, ascending.
    """
    if world.name != "log":
        return None
    at = bisect_left(frames, frame)
    near = [world.poses[f] for f in frames[max(0, at - BEFORE) : at + AFTER]]
    centres = np.array([pose.centre for pose in near])
    ups = np.tile([0.0, 0.0, 1.0], (len(near), 1))
    return beside_path(point, centres, ups, np.zeros(len(near)), near[0].rotation[:, 2])


def place_in_world(path: Sequence[PathPoint]) -> World:
    """Choose the world frame of a drive and give every used camera its pose in it.

    With poses in the log, theirs; frames that lack one follow the chain from the last that has one. With fixes only,
    east-north-up at the first fix, the chain laid over all fixes as a rigid body. Else `drive_start`: origin at the
    first used camera, x along the first step, y left, z the camera's own up.
    """
    if not path:
        return World("drive_start", {}, None)
    fixed = [p for p in path if p.fix is not None]
    if any(p.given is not None for p in path):
        poses = _follow_given(path)
        return World("log", poses, _fit_earth(fixed, [poses[p.frame].centre for p in fixed]))
    start = _drive_start(path)
    poses = {p.frame: start.compose(p.chained) for p in path}
    if len(fixed) < 2:
        return World("drive_start", poses, None)
    earth = _fit_earth(fixed, [poses[p.frame].centre for p in fixed])
    if earth is None:
        return World("drive_start", poses, None)
    turn = Pose(earth.rotation, earth.shift)
    level = Earth(earth.latitude_deg, earth.longitude_deg, earth.altitude_m, np.eye(3), np.zeros(3))
    return World("enu", {frame: turn.compose(pose) for frame, pose in poses.items()}, level)


def _follow_given(path: Sequence[PathPoint]) -> dict[int, Pose]:
    """Given poses; before the first and between them the chain, hung on the nearest given one before (or the first)."""
    first = next(p for p in path if p.given is not None)
    anchor, result = first, {}
    for point in path:
        if point.given is not None:
            anchor = point
        if anchor.given is None:  # narrows the type: every anchor has a pose
            continue
        result[point.frame] = anchor.given.compose(point.chained.relative_to(anchor.chained))
    return result


def _drive_start(path: Sequence[PathPoint]) -> Pose:
    """The first camera in the frame `drive_start`; without a step, travel is along the optical axis."""
    first = path[0].chained
    ahead = next(
        (step for p in path[1:] if np.linalg.norm(step := first.to_camera(p.chained.centre)) > 1.0),
        np.array([0.0, 0.0, 1.0]),
    )
    forward = ahead / np.linalg.norm(ahead)
    camera_up = np.array([0.0, -1.0, 0.0])
    up = camera_up - (camera_up @ forward) * forward
    up /= np.linalg.norm(up)
    axes = np.stack(
        [forward, np.cross(up, forward), up]
    )  # rows: world axes in the first camera's frame
    turn = axes @ first.rotation.T
    return Pose(turn, -turn @ first.centre)


def _fit_earth(fixed: Sequence[PathPoint], centres: Sequence[NDArray[np.float64]]) -> Earth | None:
    """Yaw and shift that lay world positions over the fixes in the least-squares sense; None without fixes."""
    fixes = [p.fix for p in fixed if p.fix is not None]
    if not fixes:
        return None
    origin = fixes[0]
    pipeline = _topocentric(origin.latitude_deg, origin.longitude_deg, origin.altitude_m)
    east, north, up = pipeline.transform(
        [f.longitude_deg for f in fixes],
        [f.latitude_deg for f in fixes],
        [f.altitude_m for f in fixes],
    )
    targets = np.stack([np.asarray(east), np.asarray(north), np.asarray(up)], axis=1)
    sources = np.asarray(centres)
    a, b = sources - sources.mean(axis=0), targets - targets.mean(axis=0)
    cosine = float((a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]).sum())
    sine = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    size = float(np.hypot(cosine, sine))
    c, s = (cosine / size, sine / size) if size > 0 else (1.0, 0.0)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    shift = targets.mean(axis=0) - rotation @ sources.mean(axis=0)
    return Earth(origin.latitude_deg, origin.longitude_deg, origin.altitude_m, rotation, shift)


def _topocentric(latitude_deg: float, longitude_deg: float, altitude_m: float) -> Transformer:
    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={longitude_deg!r} +lat_0={latitude_deg!r} +h_0={altitude_m!r}"
    )
