"""What single frames show: outlines of signs, boxes of distractors."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from recordings.drives.arrays import Floats
from recordings.drives.camera import CameraModel
from recordings.drives.parts import Group, PlacedSign
from recordings.drives.poses import TimedPose
from recordings.drives.scene import Scene

VISIBLE_REACH_M = 220.0
DISTRACTOR_REACH_M = 160.0
SMALLEST_SIGN_PX = 3.0
SMALLEST_DISTRACTOR_PX = 6.0
_LONGEST_EDGE_M = 0.35


@dataclass(frozen=True, slots=True)
class FrameViews:
    """Views of signs by id; boxes and positions of distractors by name."""

    signs: dict[int, dict[str, Any]]
    boxes: dict[str, list[int]]
    places: dict[str, list[float]]


def rounded(values: Any, digits: int) -> list[float]:
    """Numbers of any nesting as a flat list for JSON."""
    return [round(float(v), digits) for v in np.asarray(values).ravel()]


def _dense(outline: Floats, longest: float) -> Floats:
    """Closed outline with extra points so that no edge is longer than `longest`."""
    result = []
    for point, after in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        pieces = max(1, int(np.ceil(np.linalg.norm(after - point) / longest)))
        result += [point + (after - point) * k / pieces for k in range(pieces)]
    return np.array(result)


def sign_view(
    sign: PlacedSign, pose: TimedPose, camera: CameraModel, visible: dict[int, float]
) -> dict[str, Any] | None:
    """Projected outline of a sign in one frame, None where it is out of view or tiny."""
    local = [pose.to_camera(_dense(outline, _LONGEST_EDGE_M)) for outline in sign.outline()]
    together = np.concatenate(local)
    depth = together[:, 2]
    if depth.min() < 0.3 or depth.mean() > VISIBLE_REACH_M or not camera.in_field(together).all():
        return None
    pixels = [camera.project(points) for points in local]
    everything = np.concatenate(pixels)
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = np.array([camera.spec.width, camera.spec.height])
    inside = bool((high > 0).all() and (low < size - 1).all())
    if not inside or high[1] - low[1] < SMALLEST_SIGN_PX:
        return None
    front = float((pose.position - sign.centre()) @ sign.quad.normal()) > 0
    return {
        "box": rounded([*low, *high], 2),
        "polygons": [[rounded(point, 2) for point in outline] for outline in pixels],
        "side": "front" if front else "back",
        "range_m": round(float(depth.mean()), 2),
        "visible_fraction": round(visible.get(sign.sign_id, 0.0), 3) if front else None,
    }


def group_box(group: Group, pose: TimedPose, camera: CameraModel) -> list[int] | None:
    """Box of a group, clipped to the image; None where it is out of view or tiny."""
    local = pose.to_camera(group.corners())
    local = local[local[:, 2] > 0.5]
    if len(local) < 2 or local[:, 2].min() > DISTRACTOR_REACH_M:
        return None
    limit = 1.3 * max(camera.canvas_width, camera.canvas_height) / camera.canvas_focal
    local[:, :2] = np.clip(local[:, :2], -limit * local[:, 2:], limit * local[:, 2:])
    if not camera.in_field(local).any():
        return None
    for axis, reach in enumerate((camera.canvas_columns(), camera.canvas_rows())):
        depth = local[:, 2]
        local[:, axis] = np.clip(local[:, axis], reach[0] * depth, reach[-1] * depth)
    pixels = camera.project(local)
    last = (camera.spec.width - 1, camera.spec.height - 1)
    low = np.clip(pixels.min(axis=0), 0, last)
    high = np.clip(pixels.max(axis=0), 0, last)
    if (high - low).min() < 1 or (high - low).max() < SMALLEST_DISTRACTOR_PX:
        return None
    return [int(v) for v in (*np.floor(low), *np.ceil(high))]


def frame_views(
    scene: Scene, pose: TimedPose, seconds: float, camera: CameraModel, visible: dict[int, float]
) -> FrameViews:
    """What one frame shows; `visible` is the visible fraction of the fronts of signs by id."""
    views = FrameViews({}, {}, {})
    for sign in scene.signs:
        view = sign_view(sign, pose, camera, visible)
        if view is not None:
            views.signs[sign.sign_id] = view
    for group in scene.groups_at(seconds):
        box = group_box(group, pose, camera) if group.distractor else None
        if box is not None:
            views.boxes[group.distractor] = box
            views.places[group.distractor] = rounded(group.anchor, 2)
    return views
