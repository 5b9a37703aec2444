"""The exact truth of a drive as JSON."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from recordings.drives import SCHEMA_VERSION
from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Floats
from recordings.drives.parts import PlacedSign
from recordings.drives.poses import TimedPose
from recordings.drives.scene import Scene
from recordings.drives.sensor import Exposure
from recordings.drives.spec import CameraSpec, DriveSpec
from recordings.drives.views import FrameViews, rounded

ELIGIBLE_FROM_PX = 10.0
ELIGIBLE_VISIBLE = 0.5
FACES_TRAVEL_WITHIN_DEG = 60

CONVENTIONS = (
    "camera x right, y down, z forward; pixel centres at integers; "
    "world x east, y north, z up, metres; quaternion x y z w, world from camera; "
    "station_m along the travelled path from the first frame; lateral_m right of it; "
    "facing_deg 0 faces the camera, clockwise from above positive; roll_deg clockwise as seen"
)


@dataclass(frozen=True, slots=True)
class ReferencePath:
    """Dense path of the vehicle: points (n, 2), distance from the first frame and road height (n,), m."""

    points: Floats
    distance: Floats
    height: Floats


@dataclass(frozen=True, slots=True)
class OnPath:
    """A world point seen from the path: distance along, offset to the right, road height, direction (2,)."""

    station_m: float
    lateral_m: float
    road_z: float
    direction: Floats


def travelled_path(road: RoadAlignment, poses: list[TimedPose]) -> ReferencePath:
    """Path of the vehicle from 20 m before the first frame to 150 m beyond the last."""
    stations = np.arange(poses[0].station_m - 20, poses[-1].station_m + 150, 0.25)
    offsets = np.interp(stations, [p.station_m for p in poses], [p.offset_m for p in poses])
    surface = road.surface(stations, offsets)
    steps = np.linalg.norm(np.diff(surface[:, :2], axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    distance -= np.interp(poses[0].station_m, stations, distance)
    return ReferencePath(surface[:, :2], distance, surface[:, 2])


def on_path(point: Floats, path: ReferencePath) -> OnPath:
    """Place of a world point (3,) along the path."""
    gaps = ((path.points - point[:2]) ** 2).sum(axis=1)
    i = int(np.clip(np.argmin(gaps), 1, len(gaps) - 2))
    along = path.points[i + 1] - path.points[i - 1]
    along /= np.linalg.norm(along)
    offset = point[:2] - path.points[i]
    station = float(path.distance[i] + offset @ along)
    lateral = float(offset @ (along[1], -along[0]))
    return OnPath(station, lateral, float(path.height[i]), along)


def drive_truth(
    spec: DriveSpec,
    scene: Scene,
    poses: list[TimedPose],
    exposures: list[Exposure],
    views: list[FrameViews],
) -> dict[str, Any]:
    """The whole truth of a drive; poses, exposures and views hold one entry per frame."""
    path = travelled_path(scene.road, poses)
    latency_ns = int(spec.log.latency_ms * 1e6)
    return {
        "schema_version": SCHEMA_VERSION,
        "name": spec.name,
        "seed": spec.seed,
        "conventions": CONVENTIONS,
        "origin_wgs84": list(spec.log.origin),
        "spacing_m": spec.path.spacing_m,
        "camera": _camera(spec.camera),
        "frames": [
            _frame(pose, exposure, latency_ns)
            for pose, exposure in zip(poses, exposures, strict=True)
        ],
        "road": _road(spec, scene.road, poses),
        "signs": [_sign(sign, path, views) for sign in scene.signs],
        "distractors": _distractors(scene, views),
    }


def _camera(camera: CameraSpec) -> dict[str, Any]:
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion_model": "plumb_bob",
        "distortion": list(camera.distortion),
        "mount": {
            "height_m": camera.mount_height_m,
            "yaw_deg": camera.mount_yaw_deg,
            "pitch_deg": camera.mount_pitch_deg,
            "roll_deg": camera.mount_roll_deg,
        },
    }


def _frame(pose: TimedPose, exposure: Exposure, latency_ns: int) -> dict[str, Any]:
    return {
        "index": pose.index,
        "trigger": pose.trigger,
        "time_ns": pose.time_ns,
        "log_time_ns": pose.time_ns + latency_ns,
        "after_dropped_trigger": pose.after_dropped,
        "position": rounded(pose.position, 5),
        "quaternion": rounded(pose.quaternion(), 8),
        "road_station_m": round(pose.station_m, 4),
        "travelled_m": round(pose.travelled_m, 4),
        "exposure_gain": round(exposure.gain, 5),
        "white_balance": rounded(exposure.white_balance, 5),
    }


def _road(spec: DriveSpec, road: RoadAlignment, poses: list[TimedPose]) -> dict[str, Any]:
    stations = np.arange(poses[0].station_m - 20, poses[-1].station_m + 200, 5.0)
    centre_line = road.surface(stations, 0.0)
    section = zip(road.section_t, road.section_dz, strict=True)
    return {
        "kind": spec.road.kind,
        "travel_offset_m": road.travel_offset_m,
        "profile": [
            [round(float(s), 1), *rounded(point, 3)]
            for s, point in zip(stations, centre_line, strict=True)
        ],
        "profile_columns": ["road_station_m", "x", "y", "z"],
        "cross_section": [rounded(pair, 3) for pair in section],
        "cross_section_columns": [
            "offset_right_of_centre_line_m",
            "height_above_centre_line_m",
        ],
    }


def _roll_deg(sign: PlacedSign) -> float:
    """Turn of a panel in its own plane, clockwise as seen."""
    across, normal = sign.quad.u / np.linalg.norm(sign.quad.u), sign.quad.normal()
    level = np.cross(-normal, [0, 0, 1.0])
    level /= np.linalg.norm(level)
    rise = float(across @ np.cross(level, -normal)) * -1
    return float(np.degrees(np.arctan2(rise, float(across @ level))))


def _facing_deg(normal: Floats, direction: Floats) -> float:
    """Angle of a normal (3,) against the reverse of a direction (2,), clockwise from above."""
    back = -direction
    across = back[1] * normal[0] - back[0] * normal[1]
    return float(np.degrees(np.arctan2(across, back @ normal[:2])))


def _is_eligible(view: dict[str, Any]) -> bool:
    """Whether the front of a sign is large and free enough in a frame to be counted on."""
    tall = view["box"][3] - view["box"][1] >= ELIGIBLE_FROM_PX
    return bool(view["side"] == "front" and tall and view["visible_fraction"] >= ELIGIBLE_VISIBLE)


def _sign(sign: PlacedSign, path: ReferencePath, views: list[FrameViews]) -> dict[str, Any]:
    face, centre, normal = sign.face, sign.centre(), sign.quad.normal()
    place = on_path(centre, path)
    facing = _facing_deg(normal, place.direction)
    lowest = float(np.concatenate(sign.outline())[:, 2].min())
    frames = [
        {"frame": i, **view.signs[sign.sign_id]}
        for i, view in enumerate(views)
        if sign.sign_id in view.signs
    ]
    return {
        "id": sign.sign_id,
        "assembly_id": sign.assembly_id,
        "kind": face.kind,
        "color": face.color,
        "secondary_colors": list(face.secondary),
        "shape": face.shape.replace("triangle_up", "triangle"),
        "point_up": face.shape == "triangle_up",
        "legend": face.legend,
        "centre": rounded(centre, 4),
        "normal": rounded(normal, 6),
        "facing_deg": round(facing, 3),
        "roll_deg": round(_roll_deg(sign), 3),
        "width_m": round(face.width, 4),
        "height_m": round(face.height, 4),
        "bottom_m": round(lowest - place.road_z, 3),
        "up_m": round(float(centre[2]) - place.road_z, 3),
        "lateral_m": round(place.lateral_m, 3),
        "station_m": round(place.station_m, 3),
        "post": sign.post,
        **(
            {"posts": sign.posts, "post_width_m": round(sign.post_width, 4)}
            if sign.post_width
            else {}
        ),
        "faces_travel": abs(facing) < FACES_TRAVEL_WITHIN_DEG,
        "placed_for_travel": sign.forward,
        "hidden_by_foliage": sign.hidden,
        "faded": sign.faded,
        "eligible_frames": sum(_is_eligible(view) for view in frames),
        "frames": frames,
    }


def _distractors(scene: Scene, views: list[FrameViews]) -> list[dict[str, Any]]:
    """Every distractor that some frame shows, by name."""
    movers = {mover.name: mover for mover in scene.movers}
    standing = {group.distractor: group for group in scene.groups if group.distractor}
    result = []
    for name in sorted({name for view in views for name in view.boxes}):
        entry: dict[str, Any] = {
            "id": name,
            "kind": name.rsplit("-", 1)[0],
            "moving": name in movers,
        }
        frames: list[dict[str, Any]] = [
            {"frame": i, "box": view.boxes[name]}
            for i, view in enumerate(views)
            if name in view.boxes
        ]
        if name in movers:
            style = movers[name].style
            entry["size_m"] = [style.length, style.width, style.height]
            for frame in frames:
                frame["position"] = views[frame["frame"]].places[name]
        else:
            points = standing[name].corners()
            entry["position"] = rounded(standing[name].anchor, 2)
            entry["size_m"] = rounded(points.max(axis=0) - points.min(axis=0), 2)
        result.append({**entry, "frames": frames})
    return result
