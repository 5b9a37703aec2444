"""Images with boxed faces for the detection network: rendered drives, real drives and single real images.

An image says how far its boxes can be trusted: in most real ones some signs bear no box.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wayside.pipeline.learning.labelled import FACE_FRACTION, FACE_PX
from wayside.pipeline.learning.truth import LEARN_READ, height_px, read_truth, visible_fraction
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera, Frame
from wayside.stages.imaging import decode

FRONT, BACK = 0, 1
"""Side of a panel that an image shows."""

BAND = (0.52, 0.22)
"""Rows of rendered images that are kept, as tangents above and below the optical axis: the rest shows no signs."""

LEFT_OUT_RUN = 157
"""Pictures of `scenes_mixed` below this number are of doubtful origin."""

CHECKED_BOXES = Path(__file__).with_name("checked_boxes.parquet")
"""Boxes of earlier networks in real images, off all that have a label, looked at one by one: signs, with colour and
shape where the networks were sure of them; other things; what is unsure or shows part of a sign. By folder and file, or
by drive and number of the image. Of an image that is there, every box above the threshold of faces was looked at."""

MAY_BE_SIGN = ("plate", "sign")
"""Words in the description of a distractor of a real drive that may be a sign after all."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """An image with its faces.

    `source`: the camera or data set that it is from. `rgb` (height, width, 3) uint8. `box` (n, 4) float32. `side` (n,)
    `FRONT` or `BACK`. `color`, `shape` (n,) classes or `NONE`. `ignored` (m, 4): where nothing is known. `other` (k,
    4): what is labelled and no sign. `fronts_complete`, `backs_complete`: whether every face of that side has a box.
    `camera`: where it is known and the image is whole.
    """

    source: str
    name: str
    rgb: NDArray[np.uint8]
    box: NDArray[np.float32]
    side: NDArray[np.int8]
    color: NDArray[np.int8]
    shape: NDArray[np.int8]
    ignored: NDArray[np.float32]
    other: NDArray[np.float32]
    fronts_complete: bool
    backs_complete: bool
    camera: Camera | None = None


Face = tuple[Sequence[float], int, str | None, str | None]
"""Box, side, colour and shape of a face."""


def labelled_image(  # noqa: PLR0913 - one for each field
    source: str,
    name: str,
    rgb: NDArray[np.uint8],
    faces: Sequence[Face],
    ignored: Sequence[Sequence[float]],
    *,
    fronts_complete: bool,
    backs_complete: bool,
    other: Sequence[Sequence[float]] = (),
    camera: Camera | None = None,
) -> LabelledImage:
    """An image with its faces as arrays; names of colours and shapes that are no classes become `NONE`."""
    return LabelledImage(
        source,
        name,
        rgb,
        np.array([box for box, *_ in faces], np.float32).reshape(-1, 4),
        np.array([side for _, side, *_ in faces], np.int8),
        np.array([_code(COLORS, color) for *_, color, _ in faces], np.int8),
        np.array([_code(SHAPES, shape) for *_, shape in faces], np.int8),
        np.array(ignored, np.float32).reshape(-1, 4),
        np.array(other, np.float32).reshape(-1, 4),
        fronts_complete,
        backs_complete,
        camera,
    )


def _code(names: tuple[str, ...], name: str | None) -> int:
    return names.index(name) if name in names else NONE


def rendered_images(log: Path, every: int = 1, *, band: bool = True) -> Iterator[LabelledImage]:
    """The images of a rendered drive, every n-th one; of a `band`, only the rows in which signs can be."""
    truth = read_truth(log.with_suffix(".truth.json"))
    camera = truth["camera"]
    faces: dict[int, list[Face]] = {}
    ignored: dict[int, list[Sequence[float]]] = {}
    for sign in truth["signs"]:
        for view in sign["frames"]:
            side = BACK if view["side"] == "back" else FRONT
            shown = height_px(view) >= FACE_PX and (
                side == BACK or (sign["faces_travel"] and visible_fraction(view) >= FACE_FRACTION)
            )
            if shown:
                faces.setdefault(view["frame"], []).append(
                    (view["box"], side, sign["color"], sign["shape"])
                )
            else:
                ignored.setdefault(view["frame"], []).append(view["box"])
    top = max(0, round(camera["cy"] - BAND[0] * camera["fy"]))
    bottom = min(camera["height"], round(camera["cy"] + BAND[1] * camera["fy"]))
    if not band:
        top, bottom = 0, camera["height"]
    shift = np.array([0, top, 0, top])
    frames = (f for f in read_frames(log, LEARN_READ, ReadReport()) if f.index % every == 0)
    for frame, rgb in _decoded(frames):
        here = [(np.array(box) - shift, *rest) for box, *rest in faces.get(frame.index, [])]
        yield labelled_image(
            f"rendered/{truth['name']}",
            f"{log.stem}/{frame.index}",
            np.ascontiguousarray(rgb[top:bottom]),
            [(box.tolist(), side, color, shape) for box, side, color, shape in here],
            [(np.array(box) - shift).tolist() for box in ignored.get(frame.index, [])],
            fronts_complete=True,
            backs_complete=True,
            camera=None if band else frame.camera,
        )


def real_drive_images(log: Path, every: int = 1) -> Iterator[LabelledImage]:
    """The images of a real drive with hand-made labels, every n-th one; complete where their boxes were checked.

    Signs that are not wanted, such as groups of plates that are also labelled one by one, are neither right nor wrong.
    The same holds for distractors whose description has a word of `MAY_BE_SIGN`.
    """
    labels = json.loads(log.with_suffix(".labels.json").read_text(encoding="utf-8"))
    faces: dict[int, list[Face]] = {}
    ignored: dict[int, list[Sequence[float]]] = {}
    for sign in labels["signs"]:
        side = BACK if sign["facing"] == "back" else FRONT
        shape = str(sign["shape"]).split(" ")[0]
        for view in sign["boxes"]:
            if side == BACK or sign["wanted"]:
                faces.setdefault(view["i"], []).append((view["box"], side, sign["colour"], shape))
            else:
                ignored.setdefault(view["i"], []).append(view["box"])
    others: dict[int, list[Sequence[float]]] = {}
    index = {frame["source_frame"]: frame["i"] for frame in labels["frames"]}
    for thing in labels["distractors"]:
        there = ignored if any(word in thing["what"] for word in MAY_BE_SIGN) else others
        for view in thing.get("boxes", [thing] if "box" in thing else []):
            there.setdefault(index.get(view["source_frame"], -1), []).append(view["box"])
    checked = checked_boxes(log.stem)
    frames = (f for f in read_frames(log, LEARN_READ, ReadReport()) if f.index % every == 0)
    for frame, rgb in _decoded(frames):
        also = checked.get(str(frame.index), {})
        yield labelled_image(
            log.stem,
            f"{log.stem}/{frame.index}",
            rgb,
            [*faces.get(frame.index, []), *_checked_faces(also)],
            [*ignored.get(frame.index, []), *also.get("unsure", ())],
            fronts_complete=str(frame.index) in checked,
            backs_complete=False,
            other=[*others.get(frame.index, []), *also.get("other", ())],
            camera=frame.camera,
        )


def _decoded(frames: Iterator[Frame]) -> Iterator[tuple[Frame, NDArray[np.uint8]]]:
    for image in decode(frames):
        if image.rgb is not None:
            yield image.frame, image.rgb


def scene_set_images(folder: Path, prefixes: tuple[str, ...] = ("",)) -> Iterator[LabelledImage]:
    """The single images of a folder with a `scenes.json` whose names start with one of `prefixes`."""
    listed = json.loads((folder / "scenes.json").read_text(encoding="utf-8"))
    checked = checked_boxes(folder.name)
    for scene in listed:
        name = scene["file"]
        if not name.startswith(prefixes) or _is_doubtful(name):
            continue
        rgb = cv2.imread(str(folder / name), cv2.IMREAD_COLOR_RGB)
        if rgb is None:
            raise InputError(f"{folder / name}: the image cannot be read")
        complete = bool(scene["complete"]) or name in checked
        things, also = scene.get("distractors", ()), checked.get(name, {})
        unsure = [one["box"] for one in things if _may_be_sign(scene, one)]
        other = [one["box"] for one in things if not _may_be_sign(scene, one)]
        faces = [(sign["box"], FRONT, sign["color"], sign["shape"]) for sign in scene["signs"]]
        yield labelled_image(
            f"{folder.name}/{name.split('_')[0]}",
            name,
            np.ascontiguousarray(rgb, np.uint8),
            [*faces, *_checked_faces(also)],
            [*unsure, *also.get("unsure", ())],
            fronts_complete=complete,
            backs_complete=False,
            other=[*other, *also.get("other", ())],
        )


def checked_boxes(name: str) -> dict[str, Any]:
    """Those of a folder or drive, by file or number of the image; signs end in colour and shape."""
    rows = pq.read_table(CHECKED_BOXES, filters=[("source", "=", name)]).to_pylist()
    kinds = ("signs", "other", "unsure")
    return {
        row["image"]: {kind: [tuple(box.values()) for box in row[kind]] for kind in kinds}
        for row in rows
    }


def _checked_faces(boxes: dict[str, Any]) -> list[Face]:
    return [(box, FRONT, color, shape) for *box, color, shape in boxes.get("signs", ())]


def _is_doubtful(name: str) -> bool:
    return name.startswith("ro_") and int(name[3:6]) < LEFT_OUT_RUN


def _may_be_sign(scene: dict[str, Any], thing: dict[str, Any]) -> bool:
    return scene["file"].startswith("jd_") or thing.get("kind") != "traffic light"
