"""The ground as flat facets between stations and offsets."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Floats, Singles
from recordings.drives.camera import CameraModel
from recordings.drives.geometry import clip_near
from recordings.drives.poses import TimedPose

SKY = -1
_NEAR_M = 0.6
_FARTHEST_M = 60000
_FALL_BELOW_ROAD_M = 1.2


@dataclass(frozen=True, slots=True)
class Facets:
    """Which facet every canvas pixel shows, and the table of equations of the facets.

    With a pixel's ray (x, y, 1), row `p` of the table gives the inverse depth p[0:3] @ ray. At a depth d, the offset is
    d * p[7:10] @ ray + p[10]. The distance from the station p[11] along the facet is d * p[3:6] @ ray + p[6]. It is
    divided by 1 - p[12] * offset, where p[12] is the curvature of the road.
    """

    ids: NDArray[np.int32]  # (canvas rows, canvas columns), SKY where there is none
    table: Singles  # (facets + 1, 13), the last one a plain below everything


@dataclass(frozen=True, slots=True)
class _Patch:
    """Facets before projection: stations from near to far, offsets from low to high, each (n,)."""

    near: Floats
    far: Floats
    low: Floats
    high: Floats
    curvature: Floats


def _patches(road: RoadAlignment, station: float) -> _Patch:
    """Facets around a station, the farthest first; they reach sideways as far as the road's curve allows."""
    last = float(road.station[-1]) - 5
    steps = ((-2, 40, 2), (40, 160, 4), (160, 480, 10), (480, 1300, 40))
    stations = station + np.concatenate([np.arange(*step) for step in steps])
    stations = stations[stations < last]
    near, far = stations[:-1], stations[1:]
    reach = np.clip((far - station) * 2.2 + 45, 45, 400)
    curvature = road.at(road.curvature, (near + far) / 2)
    tightest = 0.8 / np.maximum(np.abs(curvature), 1e-4)
    right_reach = np.where(curvature > 1e-4, np.minimum(reach, tightest), reach)
    left_reach = np.where(curvature < -1e-4, np.minimum(reach, tightest), reach)
    lows, highs = road.section_t[:-1], road.section_t[1:]
    strip = np.repeat(len(near) - 1 - np.arange(len(near)), len(lows))
    low = np.maximum(np.tile(lows, len(near)), -left_reach[strip])
    high = np.minimum(np.tile(highs, len(near)), right_reach[strip])
    keep = high - low > 0.05
    strip = strip[keep]
    return _Patch(near[strip], far[strip], low[keep], high[keep], curvature[strip])


def _equations(patch: _Patch, local: Floats) -> Floats:
    """Rows of the table for facets with camera-frame corners (n, 4, 3)."""
    middle = local.mean(axis=1)
    along = (local[:, 2] + local[:, 3] - local[:, 0] - local[:, 1]) / 2
    across = (local[:, 1] + local[:, 2] - local[:, 0] - local[:, 3]) / 2
    length, breadth = np.linalg.norm(along, axis=1), np.linalg.norm(across, axis=1)
    normal = np.cross(along, across)
    t_middle = (patch.low + patch.high) / 2
    stretch = (1 - patch.curvature * t_middle)[:, None]
    along_unit = along / (length**2)[:, None] * (patch.far - patch.near)[:, None] * stretch
    across_unit = across / (breadth**2)[:, None] * (patch.high - patch.low)[:, None]
    table = np.empty((len(local), 13))
    table[:, 0:3] = normal / (normal * middle).sum(axis=1)[:, None]
    table[:, 3:6], table[:, 6] = along_unit, -(along_unit * middle).sum(axis=1)
    table[:, 7:10], table[:, 10] = across_unit, t_middle - (across_unit * middle).sum(axis=1)
    table[:, 11], table[:, 12] = (patch.near + patch.far) / 2, patch.curvature
    return table


def _plain(road: RoadAlignment, pose: TimedPose) -> Floats:
    """Row of the table for a plain below everything that the facets do not reach."""
    forward, right, _ = road.axes(pose.station_m)
    level = min(0.0, float(road.at(road.z, pose.station_m))) - _FALL_BELOW_ROAD_M
    row = np.zeros(13)
    row[0:3] = pose.rotation[2] / (level - pose.position[2])
    row[3:6], row[7:10], row[11] = forward @ pose.rotation, right @ pose.rotation, pose.station_m
    return row


def make_facets(road: RoadAlignment, pose: TimedPose, camera: CameraModel) -> Facets:
    """The ground as one camera sees it, near facets over far ones."""
    patch = _patches(road, pose.station_m)
    edges = (
        (patch.near, patch.low),
        (patch.near, patch.high),
        (patch.far, patch.high),
        (patch.far, patch.low),
    )
    local = pose.to_camera(np.stack([road.surface(s, t) for s, t in edges], axis=1))
    table = np.vstack([_equations(patch, local), _plain(road, pose)])
    ids = np.full((camera.canvas_height, camera.canvas_width), SKY, np.int32)
    up = pose.rotation[2]
    x, y = camera.canvas_columns().astype(np.float32), camera.canvas_rows().astype(np.float32)
    rise = y[:, None] * up[1] + up[2] + x[None, :] * up[0]
    ids[rise < -0.004] = len(local)
    for number, quad in enumerate(local):
        if quad[:, 2].max() < _NEAR_M:
            continue
        outline = quad if quad[:, 2].min() >= _NEAR_M else clip_near(quad, _NEAR_M)
        pixels = np.clip(camera.on_canvas(outline), -_FARTHEST_M, _FARTHEST_M)
        sixteenths = np.round(pixels * 16).astype(np.int32)
        cv2.fillConvexPoly(ids, sixteenths, (number,), cv2.LINE_8, 4)
    return Facets(ids, table.astype(np.float32))
