"""A log of the results, to open in Foxglove together with the drive: boxes on its images, panels in its frames.

Schemas: https://docs.foxglove.dev/docs/sdk/schemas. Messages have the log times and capture times of the images that
they belong to.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.evidence.marks import Ink, ink_of
from wayside.pipeline.exporting.table import Row
from wayside.pipeline.reading.contents import PoseContent
from wayside.pipeline.reading.messages import Kind
from wayside.pipeline.reading.plan import Plan, plan_reading
from wayside.pipeline.reading.series import bare
from wayside.pipeline.results.result import (
    find_log,
    log_fingerprint,
    read_rows,
    read_run,
    read_settings,
)
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Pose
from wayside.schemas.tables import FRAMES, OBSERVATIONS

_QUATERNION = ("qx", "qy", "qz", "qw")
_FRAME_COLUMNS = ("frame", "log_time_ns", "header_time_ns", "x", "y", "z", *_QUATERNION)
_BOX_COLUMNS = ("frame", "box", "sign_id", "verdict")
_THICKNESS_M, _TEXT_ABOVE_M = 0.03, 0.3
_BOX_PX, _REJECTED_PX, _TEXT_PX, _SCENE_TEXT_PX = 4.0, 1.5, 24.0, 14.0
_REJECTED_INK, _WHITE = (140, 140, 140), (255, 255, 255)
_UNTOLD = ("score", "overlap")
"""Verdicts on one box in one image, of which there are hundreds: they have no label."""
Message = dict[str, Any]
"""Fields of a message within another, which protobuf makes a message of."""


def write_foxglove_log(
    out: Path, signs: Sequence[Row], log: Path | None, stream: BinaryIO
) -> list[str]:
    """Write the log of a result and return notes on what it lacks.

    Topics, under `/wayside` and the name of the image topic: `signs` has the boxes of the signs on each image, and
    `rejected` all others with their verdicts (`foxglove.ImageAnnotations`). `scene` has the panels as oriented boxes
    with their names, and the path (`foxglove.SceneUpdate`, one message at the start). `camera` is the pose of the
    camera (`foxglove.FrameTransform`), unless the drive's log has transforms for it.

    `signs`: rows with their review. `log`: where the drive's log lies; None: where it lay at the time of the run.
    Raises InputError if the log cannot be read, or is another one.
    """
    signs = [row | {name: row[f"final_{name}"] for name in ("color", "shape")} for row in signs]
    run = read_run(out)
    drive = find_log(run, log)
    if run.get("log_fingerprint") not in (None, log_fingerprint(drive)):
        raise InputError(
            f"{drive}: this is not the log that {out} was made from. Give the right one with --log."
        )
    plan = plan_reading(drive, read_settings(out, run))
    world, child = _frame_names(plan, str(run.get("world") or "drive_start"))
    tree = plan.survey.tree
    mount = tree.mount(tree.chain(plan.camera.camera_frame))
    rows = read_rows(out, FRAMES, _FRAME_COLUMNS)
    boxes, writer, lost = _boxes_by_frame(out, rows), Writer(stream), 0
    prefix = f"/wayside/{plan.camera.name.strip('/')}"
    if rows:
        first = min(row["log_time_ns"] for row in rows)
        writer.write_message(f"{prefix}/scene", _scene(signs, rows, world, first), first, first)
    names = {row["sign_id"]: row for row in signs}
    for row in rows:
        when = row["log_time_ns"]
        if child is not None and row["qw"] is not None:
            moved = _transform(row, mount, world, child)
            lost += moved is None
            if moved is not None:
                writer.write_message(f"{prefix}/camera", moved, when, when)
        for topic, shown in _annotations(row, boxes[row["frame"]], names):
            writer.write_message(f"{prefix}/{topic}", shown, when, when)
    writer.finish()  # type: ignore[no-untyped-call]
    return [f"{lost} images have no transform: the mount of the camera is unknown"] if lost else []


def _frame_names(plan: Plan, world: str) -> tuple[str, str | None]:
    """Frames of the drive's log: that of the positions, and one above the camera that is placed in it.

    There is no second frame if the log itself states its motion.
    """
    tree = plan.survey.tree
    child = tree.root(plan.camera.camera_frame) or "camera"
    if world != "log":
        return f"wayside_{world}", child
    if tree.moving(plan.camera.camera_frame):
        return child, None
    firsts = (topic.first for topic in plan.survey.of_kind(Kind.POSE, Kind.ODOMETRY))
    named = next((bare(first.parent) for first in firsts if isinstance(first, PoseContent)), "")
    return named or "wayside_log", None if child == named else child


def _boxes_by_frame(out: Path, frames: Sequence[Row]) -> dict[int, list[Row]]:
    boxes: dict[int, list[Row]] = defaultdict(list)
    for row in read_rows(out, OBSERVATIONS, _BOX_COLUMNS):
        boxes[row["frame"]].append(row)
    if unknown := boxes.keys() - {row["frame"] for row in frames}:
        raise InputError(
            f"{out}: observations name frame {min(unknown)}, which the table of frames lacks. The tables are of "
            "different runs: run the log again."
        )
    return boxes


def _annotations(
    row: Row, boxes: Sequence[Row], names: dict[str, Row]
) -> Iterator[tuple[str, ImageAnnotations]]:
    """The boxes of an image by topic; a topic without boxes is empty, which clears the last ones."""
    time = _stamp(row["header_time_ns"])
    shown = {topic: ImageAnnotations(timestamp=time) for topic in ("signs", "rejected")}
    for box in boxes:
        topic, ink, ink_of_words, thickness = "rejected", _REJECTED_INK, _REJECTED_INK, _REJECTED_PX
        words = "" if box["verdict"] in _UNTOLD else box["verdict"]
        if box["verdict"] == "sign":
            if (sign := names.get(box["sign_id"])) is None:
                continue
            topic, ink, ink_of_words, thickness = "signs", ink_of(sign["color"]), _WHITE, _BOX_PX
            words = _words(sign)
        x0, y0, x1, y1 = box["box"]
        outline: Message = {
            "timestamp": time,
            "type": "LINE_LOOP",
            "points": [{"x": x, "y": y} for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))],
            "outline_color": _color(ink),
            "thickness": thickness,
        }
        text: Message = {
            "timestamp": time,
            "position": {"x": x0, "y": y0},
            "text": words,
            "font_size": _TEXT_PX,
            "text_color": _color(ink_of_words),
            "background_color": {"a": 0.6},
        }
        shown[topic].points.add(**outline)
        if words:
            shown[topic].texts.add(**text)
    yield from shown.items()


def _scene(signs: Sequence[Row], rows: Sequence[Row], world: str, first_ns: int) -> SceneUpdate:
    """Every panel as a thin box in the colour of its face, missing signs by name, and the path; all stay to the end."""
    placed = {row["frame"]: row for row in rows if row["qw"] is not None}
    line = {
        "type": "LINE_STRIP",
        "pose": _pose(np.zeros(3), Rotation.identity()),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": [{axis: row[axis] for axis in "xyz"} for row in placed.values()],
        "color": _color(_WHITE),
    }
    entities = [{"id": "path", "lines": [line] if len(placed) > 1 else []}]
    for sign in signs:
        if sign["best_frame"] in placed:
            entities.append(_entity(sign, placed[sign["best_frame"]]))
    shared = {"timestamp": _stamp(rows[0]["header_time_ns"] or first_ns), "frame_id": world}
    whole: list[Any] = [entity | shared for entity in entities]
    return SceneUpdate(entities=whole)


def _entity(sign: Row, camera: Row) -> Message:
    """A panel, its axes those of the camera turned by `facing_deg` about y, which points down, and its name.

    A sign that only the review knows is its name alone, at the height of the camera.
    """
    if sign.get("status") is None:
        place = np.array([sign["x"], sign["y"], camera["z"]], np.float64)
        return {"id": sign["sign_id"], "texts": [_name(sign, place, Rotation.identity())]}
    turn = Rotation.from_euler("y", sign["facing_deg"] or 0.0, degrees=True)
    axes = Rotation.from_quat([camera[name] for name in _QUATERNION]) * turn
    centre = np.array([sign[axis] for axis in "xyz"], np.float64)
    width, height = (sign[f"panel_{side}_m"] or _THICKNESS_M for side in ("width", "height"))
    above = centre - (height / 2 + _TEXT_ABOVE_M) * axes.as_matrix()[:, 1]
    cube = {
        "pose": _pose(centre, axes),
        "size": {"x": width, "y": height, "z": _THICKNESS_M},
        "color": _color(ink_of(sign["color"])),
    }
    return {"id": sign["sign_id"], "cubes": [cube], "texts": [_name(sign, above, axes)]}


def _name(sign: Row, place: NDArray[np.float64], axes: Rotation) -> Message:
    return {
        "pose": _pose(place, axes),
        "billboard": True,
        "font_size": _SCENE_TEXT_PX,
        "scale_invariant": True,
        "color": _color(ink_of(sign["color"])),
        "text": _words(sign),
    }


def _transform(row: Row, mount: Pose | None, world: str, child: str) -> FrameTransform | None:
    """The child frame in the world, by the camera's pose and its mount; None where the mount is not known."""
    if mount is None:
        return None
    turn = Rotation.from_quat([row[name] for name in _QUATERNION]).as_matrix()
    camera = Pose(turn, np.array([row[axis] for axis in "xyz"], np.float64))
    pose = camera.compose(Pose(np.eye(3), np.zeros(3)).relative_to(mount))
    if not math.isfinite(pose.centre.sum()):
        return None
    moved = _pose(pose.centre, Rotation.from_matrix(pose.rotation))
    return FrameTransform(
        timestamp=_stamp(row["header_time_ns"] or row["log_time_ns"]),
        parent_frame_id=world,
        child_frame_id=child,
        translation=moved["position"],
        rotation=moved["orientation"],
    )


def _pose(place: NDArray[np.float64], axes: Rotation) -> Message:
    turn = axes.as_quat(canonical=True).tolist()
    return {
        "position": dict(zip("xyz", place.tolist(), strict=True)),
        "orientation": dict(zip("xyzw", turn, strict=True)),
    }


def _words(sign: Row) -> str:
    """Name, status where it is not `sign`, colour, shape and review of a sign."""
    status = "" if sign.get("status") == "sign" else sign.get("status")
    look = [str(sign[name]).replace("_", " ") for name in ("color", "shape") if sign[name]]
    return " ".join([sign["sign_id"], *filter(None, (status, *look, sign.get("review")))])


def _stamp(time_ns: int | None) -> Timestamp | None:
    """None where the image has no time of its own, which leaves the field unset as there."""
    return None if time_ns is None else Timestamp(seconds=time_ns // 10**9, nanos=time_ns % 10**9)


def _color(ink: Ink) -> Message:
    r, g, b = (value / 255 for value in ink)
    return {"r": r, "g": g, "b": b, "a": 1.0}
