"""A log of the results, to open in Foxglove together with the drive: boxes on its images, panels in its frames.

Schemas: https://docs.foxglove.dev/docs/sdk/schemas. Messages have the log times and capture times of the images that
they belong to.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap_protobuf.writer import Writer
from scipy.spatial.transform import Rotation

from wayside.pipeline.evidence.marks import Ink, ink_of
from wayside.pipeline.exporting.flat_table import FlatTable, Row
from wayside.pipeline.files.writing import not_whole
from wayside.pipeline.reading.contents import PoseContent
from wayside.pipeline.reading.messages import Kind
from wayside.pipeline.reading.plan import Plan, plan_reading
from wayside.pipeline.reading.poses import bare
from wayside.pipeline.results.earlier_result import log_fingerprint
from wayside.pipeline.results.result import find_log, read_rows, read_run, read_settings, read_table
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
_IDENTITY = Pose(Rotation.identity().as_matrix(), Rotation.identity().as_rotvec())


@dataclass(frozen=True, slots=True)
class _Frames:
    """Names of frames in the drive's log: that of the positions, and one above the camera that is placed in it.

    child: None where the log says itself how it moves; plan: of the log, for the mount of the camera.
    """

    world: str
    child: str | None
    plan: Plan

    def pose_of_child(self, camera: Pose) -> Pose | None:
        """The child in the world, by the camera's pose and its mount; None where the mount moves."""
        chain = self.plan.survey.tree.chain(self.plan.camera_frame)
        mount = self.plan.survey.tree.mount(chain)
        return None if mount is None else camera.compose(_IDENTITY.relative_to(mount))


def require_whole_log(file: Path) -> None:
    """Read a log back; raises OutputError where its end or a message is missing."""
    try:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary, found = reader.get_summary(), sum(1 for _ in reader.iter_messages())
    except McapError as error:
        raise not_whole(file) from error
    if summary is None or summary.statistics is None or summary.statistics.message_count != found:
        raise not_whole(file)


def write_foxglove_log(
    out: Path, table: FlatTable, log: Path | None, stream: BinaryIO
) -> list[str]:
    """Write the log and return notes on what it lacks.

    Topics, under `/wayside` and the name of the image topic: `signs` has the boxes of the signs on each image, and
    `rejected` all others with their verdicts (`foxglove.ImageAnnotations`). `scene` has the panels as oriented boxes
    with their names, and the path (`foxglove.SceneUpdate`, one message at the start). `camera` is the pose of the
    camera (`foxglove.FrameTransform`), unless the drive's log has transforms for it.

    Parameters
    ----------
    out, table
        Folder of the result, its signs with their review.
    log
        Where the drive's log lies; None: where it lay at the time of the run.
    stream
        To write to.

    Raises
    ------
    InputError
        The log cannot be read, or is another one.
    """
    run = read_run(out)
    drive = find_log(run, log)
    if run.get("log_fingerprint") not in (None, log_fingerprint(drive)):
        raise InputError(
            f"{drive}: this is not the log that {out} was made from. Give the right one with --log."
        )
    frames = _frames_of(drive, out, run)
    rows = read_rows(out, FRAMES, _FRAME_COLUMNS)
    prefix = f"/wayside/{frames.plan.camera.name.strip('/')}"
    writer = Writer(stream)
    lost = 0
    if rows:
        scene = _scene(table, rows, frames.world)
        first = min(row["log_time_ns"] for row in rows)
        writer.write_message(f"{prefix}/scene", scene, first, first)
    names = {row["sign_id"]: row for row in table.rows}
    for row, boxes in _with_boxes(out, rows):
        when = row["log_time_ns"]
        if frames.child is not None and row["qw"] is not None:
            moved = _transform(row, frames)
            lost += moved is None
            if moved is not None:
                writer.write_message(f"{prefix}/camera", moved, when, when)
        for topic, shown in _annotations(row, boxes, names):
            writer.write_message(f"{prefix}/{topic}", shown, when, when)
    writer.finish()  # type: ignore[no-untyped-call]
    return [f"{lost} images have no transform: the mount of the camera is unknown"] if lost else []


def _frames_of(drive: Path, out: Path, run: dict[str, Any]) -> _Frames:
    plan = plan_reading(drive, read_settings(out, run))
    world, tree = str(run.get("world") or "drive_start"), plan.survey.tree
    child = tree.root(plan.camera_frame) or "camera"
    if world != "log":
        return _Frames(f"wayside_{world}", child, plan)
    if tree.moving(plan.camera_frame):
        return _Frames(child, None, plan)
    firsts = (topic.first for topic in plan.survey.of_kind(Kind.POSE, Kind.ODOMETRY))
    named = next((bare(first.parent) for first in firsts if isinstance(first, PoseContent)), "")
    return _Frames(named or "wayside_log", None if child == named else child, plan)


def _with_boxes(out: Path, frames: Sequence[Row]) -> Iterator[tuple[Row, list[Row]]]:
    """Frames with their observations, one after the other: both tables stand in the same order."""
    found = read_table(out, OBSERVATIONS, _BOX_COLUMNS)
    rows = (row for batch in found.to_batches(max_chunksize=10_000) for row in batch.to_pylist())
    groups = groupby(rows, key=lambda row: int(row["frame"]))
    frame, boxes = next(groups, (None, iter(())))
    for row in frames:
        if row["frame"] != frame:
            yield row, []
            continue
        yield row, list(boxes)
        frame, boxes = next(groups, (None, iter(())))
    if frame is not None:
        raise InputError(
            f"{out}: observations name frame {frame}, which the table of frames lacks. The tables are of different "
            "runs: run the log again."
        )


def _annotations(
    row: Row, boxes: Sequence[Row], names: dict[str, Row]
) -> Iterator[tuple[str, ImageAnnotations]]:
    """The boxes of an image by topic. A topic without boxes is empty, which clears the last ones.

    Those of signs have the colours of their faces and their names; all others are grey, with the verdict on them where
    it was given over several images.
    """
    signs, others = [], []
    for box in boxes:
        if box["verdict"] != "sign":
            words = "" if box["verdict"] in _UNTOLD else box["verdict"]
            others.append((box["box"], words, _REJECTED_INK, _REJECTED_INK))
        elif (sign := names.get(box["sign_id"])) is not None:
            signs.append((box["box"], _words(sign), ink_of(sign["color"]), _WHITE))
    yield "signs", _outlined(row, signs, _BOX_PX)
    yield "rejected", _outlined(row, others, _REJECTED_PX)


def _outlined(
    row: Row, boxes: Iterable[tuple[Sequence[float], str, Ink, Ink]], thickness: float
) -> ImageAnnotations:
    """Outlines of boxes, each with its words, in the colours of both."""
    time = _stamp(row["header_time_ns"])
    outlines: list[Any] = []
    texts: list[Any] = []
    for (x0, y0, x1, y1), words, ink, ink_of_words in boxes:
        outline = {
            "timestamp": time,
            "type": "LINE_LOOP",
            "points": [{"x": x, "y": y} for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))],
            "outline_color": _color(ink),
            "thickness": thickness,
        }
        text = {
            "timestamp": time,
            "position": {"x": x0, "y": y0},
            "text": words,
            "font_size": _TEXT_PX,
            "text_color": _color(ink_of_words),
            "background_color": {"a": 0.6},
        }
        outlines.append(outline)
        texts += [text] if words else []
    return ImageAnnotations(timestamp=time, points=outlines, texts=texts)


def _scene(table: FlatTable, rows: Sequence[Row], world: str) -> SceneUpdate:
    """Every panel as a thin box in the colour of its face, missing signs by name, and the path; all stay to the end."""
    first = rows[0]
    time = _stamp(first["header_time_ns"] or min(row["log_time_ns"] for row in rows))
    placed = {row["frame"]: row for row in rows if row["qw"] is not None}
    entities = [_path(list(placed.values()))]
    entities += [
        (_missing if sign.get("status") is None else _panel)(sign, placed[sign["best_frame"]])
        for sign in table.rows
        if sign["best_frame"] in placed
    ]
    shared = {"timestamp": time, "frame_id": world}
    whole: list[Any] = [entity | shared for entity in entities]
    return SceneUpdate(entities=whole)


def _path(placed: Sequence[Row]) -> Message:
    line = {
        "type": "LINE_STRIP",
        "pose": _pose(_IDENTITY),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": [{axis: row[axis] for axis in "xyz"} for row in placed],
        "color": _color(_WHITE),
    }
    return {"id": "path", "lines": [line] if len(placed) > 1 else []}


def _panel(sign: Row, camera: Row) -> Message:
    """A sign: axes of its box as those of the camera turned by `facing_deg` about its y axis, which points down."""
    turn = Rotation.from_euler("y", sign["facing_deg"] or 0.0, degrees=True)
    axes = (Rotation.from_quat([camera[name] for name in _QUATERNION]) * turn).as_matrix()
    width, height = (sign[f"panel_{side}_m"] or _THICKNESS_M for side in ("width", "height"))
    panel = Pose(axes, _IDENTITY.centre + [sign[axis] for axis in "xyz"])
    above = Pose(axes, panel.centre - (height / 2 + _TEXT_ABOVE_M) * axes[:, 1])
    color = _color(ink_of(sign["color"]))
    size = {"x": width, "y": height, "z": _THICKNESS_M}
    return {
        "id": sign["sign_id"],
        "cubes": [{"pose": _pose(panel), "size": size, "color": color}],
        "texts": [_name(above, color, _words(sign))],
    }


def _missing(sign: Row, camera: Row) -> Message:
    """The name of a sign that only the review knows, at the height of the camera, as its own is not known."""
    place = np.array([sign["x"], sign["y"], camera["z"]], np.float64)
    look = {name: sign[f"reviewed_{name}"] for name in ("color", "shape")}
    at = Pose(_IDENTITY.rotation, place)
    return {
        "id": sign["sign_id"],
        "texts": [_name(at, _color(ink_of(look["color"])), _words(sign | look))],
    }


def _name(at: Pose, color: Message, words: str) -> Message:
    return {
        "pose": _pose(at),
        "billboard": True,
        "font_size": _SCENE_TEXT_PX,
        "scale_invariant": True,
        "color": color,
        "text": words,
    }


def _transform(row: Row, frames: _Frames) -> FrameTransform | None:
    rotation = Rotation.from_quat([row[name] for name in _QUATERNION]).as_matrix()
    camera = Pose(rotation, _IDENTITY.centre + [row[axis] for axis in "xyz"])
    time_ns = row["header_time_ns"] or row["log_time_ns"]
    pose = frames.pose_of_child(camera)
    if pose is None or not math.isfinite(pose.centre.sum()):
        return None
    moved = _pose(pose)
    return FrameTransform(
        timestamp=_stamp(time_ns),
        parent_frame_id=frames.world,
        child_frame_id=frames.child or "",
        translation=moved["position"],
        rotation=moved["orientation"],
    )


def _pose(pose: Pose) -> Message:
    turn = Rotation.from_matrix(pose.rotation).as_quat(canonical=True).tolist()
    return {
        "position": dict(zip("xyz", pose.centre.tolist(), strict=True)),
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
