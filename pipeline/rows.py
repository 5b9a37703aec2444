"""Rows of the tables `signs` and `frames`: what is known of a place or a picture, in the words of the tables."""

from __future__ import annotations

import math
import struct
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.pipeline.world import Length, World, beside_in_world
from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.motion import Motion
from wayside.stages.kernels import Array

FRAME_COLUMNS = (
    *("frame", "log_time_ns", "header_time_ns", "status", "station_m", "motion_source"),
    *("baseline_m", "ties", "residual_straight_px", "residual_px", "adjusted", "iterations"),
    *("regions", "left_out", "candidates"),
)
_STATION, _BASELINE = FRAME_COLUMNS.index("station_m"), FRAME_COLUMNS.index("baseline_m")
_ON_EARTH = ("lon_deg", "lat_deg", "alt_m", "sigma_east_m", "sigma_north_m", "sigma_alt_m")
SCALE_STEPS = 3
"""The distance of a place hangs on its nearest views: on so many steps before the best one."""
_OWN_SHARE = 0.9
"""At most so much of what a place's covariance has along its own ray can be the path's."""


def frame_row(settled: TrackedFrame) -> tuple[Any, ...]:
    """`FRAME_COLUMNS` of a picture."""
    frame, motion = settled.frame, settled.motion
    head = (frame.index, frame.log_time_ns, frame.header_time_ns, frame.status)
    if motion is None:
        return (*head, *(None,) * (len(FRAME_COLUMNS) - len(head)))
    return (
        *head,
        motion.station_m,
        motion.source,
        *_step(motion),
        settled.region_count,
        settled.left_out,
        len(settled.candidates),
    )


def stretched_frames(frames: Sequence[tuple[Any, ...]], world: World) -> list[tuple[Any, ...]]:
    """Rows of pictures with lengths and stations as the whole drive has them."""
    if not world.lengths:
        return list(frames)
    result, gained = [], 0.0
    for row in frames:
        if row[_STATION] is None:
            result.append(row)
            continue
        cells, length = list(row), world.lengths.get(row[0])
        if length is not None and row[_BASELINE] is not None:
            cells[_BASELINE] *= length.stretch
            gained += cells[_BASELINE] - row[_BASELINE]
        cells[_STATION] += gained
        result.append(tuple(cells))
    return result


def pose_numbers(pose: Pose) -> tuple[float, ...]:
    """Centre, and quaternion x, y, z, w."""
    quaternion = Rotation.from_matrix(pose.rotation).as_quat(canonical=True)
    return (*pose.centre.tolist(), *quaternion.tolist())


@dataclass(frozen=True, slots=True)
class Scale:
    """What the whole drive makes of the lengths round a place: factor, its relative scatter and that of the old one."""

    factor: float = 1.0
    sigma: float = 0.0
    sigma_before: float = 0.0

    def covariance(self, place: Landmark) -> Array:
        """Covariance (3, 3) of the place's scaled position: lengths as sure as they are by now."""
        ray = place.position
        if not self.sigma:
            return place.covariance
        # no more can be taken away than leaves a covariance
        most = 1 / float(ray @ np.linalg.solve(place.covariance, ray))
        before = min(self.sigma_before**2, _OWN_SHARE * most)
        across = np.outer(ray, ray)
        return np.asarray(self.factor**2 * (place.covariance + (self.sigma**2 - before) * across))


class SignRows:
    """Turns places into rows of `signs`.

    Parameters
    ----------
    world
        Where everything stands.
    frames
        Rows of the pictures as `frame_row` gave them.
    camera_height_m
        Above the road; None: unknown.
    """

    def __init__(
        self, world: World, frames: Sequence[tuple[Any, ...]], camera_height_m: float | None
    ) -> None:
        self._world, self._height = world, camera_height_m
        self._frames = sorted(world.poses)
        self._stations = _station_pairs(frames, world)

    def row(self, place: Landmark) -> dict[str, Any]:
        """All columns of a sign that need no number."""
        scale = self._scale(place)
        position, covariance = scale.factor * place.position, scale.covariance(place)
        pose = self._world.poses[place.best_frame]
        centre = pose.to_world(position)
        beside = beside_in_world(self._world, self._frames, place.best_frame, centre)
        right, above = (
            (scale.factor * place.right_m, scale.factor * place.above_m)
            if beside is None
            else (beside.right, beside.above)
        )
        spread = pose.rotation @ covariance @ pose.rotation.T
        sigma = np.sqrt(np.diag(covariance))
        up = None if self._height is None else float(above) + self._height
        width, height = scale.factor * place.width_m, scale.factor * place.height_m
        return {
            "status": "back" if place.back else "sign",
            "confidence": 1 / (1 + math.exp(-min(max(place.score, -50.0), 50.0))),
            "color": place.color,
            "color_distance": finite(place.color_distance),
            "shape": place.shape,
            "shape_distance": finite(place.shape_distance),
            **dict(zip(("x", "y", "z"), centre.tolist(), strict=True)),
            "covariance": [
                spread[i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
            ],
            "sigma_along_m": float(sigma[2]),
            "sigma_lateral_m": float(sigma[0]),
            "sigma_up_m": float(sigma[1]),
            "station_m": self._station(place.station_m),
            "lateral_m": float(right),
            "up_m": up,
            "bottom_m": None if up is None else up - height / 2,
            "panel_width_m": finite(width),
            "panel_height_m": finite(height),
            "sigma_width_m": _with_scale(place.sigma_width_m, width, scale),
            "sigma_height_m": _with_scale(place.sigma_height_m, height, scale),
            "facing_deg": finite(place.facing_deg),
            "sigma_facing_deg": finite(place.sigma_facing_deg),
            "best_frame": place.best_frame,
            "best_time_ns": place.best_time_ns,
            "best_box": list(place.best_box),
            **dict(zip(("right_m", "down_m", "ahead_m"), position.tolist(), strict=True)),
            "first_frame": min(view.frame for view in place.views),
            "last_frame": max(view.frame for view in place.views),
            "views": len(place.views),
            "residual_px": finite(place.residual_px),
            **self._on_earth(place.best_frame, position, covariance),
        }

    def _on_earth(self, frame: int, position: Array, covariance: Array) -> dict[str, Any]:
        """Columns on WGS 84, and how sure they are."""
        earth = self._world.earth
        if earth is None:
            return dict.fromkeys((*_ON_EARTH, "geometry"))
        point = earth.pose(frame).to_world(position)
        lon, lat, height = earth.origin.geodetic(point[None])[0].tolist()
        sigma = np.sqrt(np.diag(earth.spread(frame, position, covariance))).tolist()
        values = dict(zip(_ON_EARTH, (lon, lat, height, *sigma), strict=True))
        return values | {"geometry": struct.pack("<BIddd", 1, 1001, lon, lat, height)}

    def _scale(self, place: Landmark) -> Scale:
        """Stretch of the path where the place was seen from nearest: it is measured against these steps."""
        at = bisect_right(self._frames, place.best_frame)
        near = self._frames[max(0, at - SCALE_STEPS) : at]
        return scale_of([self._world.lengths[f] for f in near if f in self._world.lengths])

    def _station(self, station_m: float) -> float:
        before, after = self._stations
        if not len(before):
            return station_m
        # past its ends the path goes on as it was
        inside = float(np.clip(station_m, before[0], before[-1]))
        return float(np.interp(inside, before, after)) + station_m - inside


def scale_of(lengths: Sequence[Length]) -> Scale:
    """The common scale of neighbouring steps: they were taken for equal in scatter, and independent."""
    if not lengths:
        return Scale()
    count = len(lengths)
    return Scale(
        sum(one.stretch for one in lengths) / count,
        math.sqrt(sum(one.sigma**2 for one in lengths) / count),
        math.sqrt(sum(one.sigma_before**2 for one in lengths)) / count,
    )


def finite(value: float) -> float | None:
    """The value, None where it is not known."""
    return float(value) if math.isfinite(value) else None


def _with_scale(sigma: float, size: float, scale: Scale) -> float | None:
    return finite(math.hypot(scale.factor * sigma, scale.sigma * size))


def _station_pairs(frames: Sequence[tuple[Any, ...]], world: World) -> tuple[Array, Array]:
    """Stations of the pictures as first taken and as the whole drive has them; empty where they are the same."""
    if not world.lengths:
        return np.zeros(0), np.zeros(0)
    pairs = [
        (row[_STATION], new[_STATION])
        for row, new in zip(frames, stretched_frames(frames, world), strict=True)
        if row[_STATION] is not None
    ]
    before, after = np.array(pairs).T
    return before, after


def _step(motion: Motion) -> tuple[Any, ...]:
    """Columns of the step to a frame; unknown at the first used one."""
    if motion.step is None:
        return (None,) * 6
    ties = 0 if motion.ties is None else len(motion.ties.inlier)
    residuals = (finite(motion.residual_straight_px), finite(motion.residual_px))
    return (motion.baseline_m, ties, *residuals, motion.adjusted, motion.iterations)
