"""Images with boxed faces to learn networks from: rendered drives, real drives and single real images.

An image says how far its boxes can be trusted: in most real ones some signs bear no box.
"""

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from training.truth import images, read_truth, views_by_frame
from wayside.schemas.detections import LEARNED_COLORS, NONE, SHAPES
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera

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


Face = tuple[Sequence[float], int, str | None, str | None]
"""Box, side, colour and shape of a face."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """An image with its faces.

    `source`: the camera or data set that it is from. `rgb` (height, width, 3) uint8. `box` (n, 4) float32. `side` (n,)
    `FRONT` or `BACK`. `color`, `shape` (n,) classes or `NONE`. `ignored` (m, 4): where nothing is known. `other` (k,
    4): what is labelled and no sign. `complete`: whether every face has a box, of fronts and of backs.
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
    complete: tuple[bool, bool]
    camera: Camera | None = None

    @classmethod
    def of(
        cls,
        name: tuple[str, str],
        rgb: NDArray[np.uint8],
        faces: Sequence[Face],
        ignored: Sequence[Sequence[float]] = (),
        other: Sequence[Sequence[float]] = (),
        complete: tuple[bool, bool] = (True, False),
        camera: Camera | None = None,
    ) -> Self:
        """From source and name, and faces by the names of their classes, `NONE` where these are none of ours."""
        return cls(
            *name,
            rgb,
            _boxes(box for box, *_ in faces),
            np.array([side for _, side, *_ in faces], np.int8),
            np.array([_code(LEARNED_COLORS, color) for *_, color, _ in faces], np.int8),
            np.array([_code(SHAPES, shape) for *_, shape in faces], np.int8),
            _boxes(ignored),
            _boxes(other),
            complete,
            camera,
        )


def _boxes(boxes: Iterable[Sequence[float]]) -> NDArray[np.float32]:
    return np.array(list(boxes), np.float32).reshape(-1, 4)


def _code(names: tuple[str, ...], name: str | None) -> int:
    return names.index(name) if name in names else NONE


def rendered_images(log: Path, every: int = 1, *, band: bool = True) -> Iterator[LabelledImage]:
    """The images of a rendered drive, every n-th one; of a `band`, only the rows in which signs can be."""
    truth = read_truth(log)
    camera, views = truth["camera"], views_by_frame(truth)
    top = max(0, round(camera["cy"] - BAND[0] * camera["fy"]))
    bottom = min(camera["height"], round(camera["cy"] + BAND[1] * camera["fy"]))
    if not band:
        top, bottom = 0, camera["height"]
    shift = np.array([0, top, 0, top])
    for image, rgb in images(log, every):
        faces: list[Face] = []
        ignored = []
        for sign, back, box, example in views.get(image.frame.index, ()):
            moved = (np.array(box) - shift).tolist()
            if example and (back or sign["faces_travel"]):
                faces.append((moved, BACK if back else FRONT, sign["color"], sign["shape"]))
            else:
                ignored.append(moved)
        yield LabelledImage.of(
            (f"rendered/{truth['name']}", f"{log.stem}/{image.frame.index}"),
            np.ascontiguousarray(rgb[top:bottom]),
            faces,
            ignored,
            complete=(True, True),
            camera=None if band else image.frame.camera,
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
    for image, rgb in images(log, every):
        frame = image.frame
        also = checked.get(str(frame.index), {})
        yield LabelledImage.of(
            (log.stem, f"{log.stem}/{frame.index}"),
            rgb,
            [*faces.get(frame.index, []), *_checked_faces(also)],
            [*ignored.get(frame.index, []), *also.get("unsure", ())],
            [*others.get(frame.index, []), *also.get("other", ())],
            (str(frame.index) in checked, False),
            frame.camera,
        )


def scene_set_images(folder: Path, prefixes: tuple[str, ...] = ("",)) -> Iterator[LabelledImage]:
    """The single images of a folder with a `scenes.json` whose names start with one of `prefixes`."""
    listed = json.loads((folder / "scenes.json").read_text(encoding="utf-8"))
    checked = checked_boxes(folder.name)
    for scene in listed:
        name = scene["file"]
        doubtful = name.startswith("ro_") and int(name[3:6]) < LEFT_OUT_RUN
        if doubtful or not name.startswith(prefixes):
            continue
        rgb = cv2.imread(str(folder / name), cv2.IMREAD_COLOR_RGB)
        if rgb is None:
            raise InputError(f"{folder / name}: the image cannot be read")
        complete = bool(scene["complete"]) or name in checked
        things, also = scene.get("distractors", ()), checked.get(name, {})
        unsure = [one["box"] for one in things if _may_be_sign(scene, one)]
        other = [one["box"] for one in things if not _may_be_sign(scene, one)]
        faces = [(sign["box"], FRONT, sign["color"], sign["shape"]) for sign in scene["signs"]]
        yield LabelledImage.of(
            (f"{folder.name}/{name.split('_')[0]}", name),
            np.ascontiguousarray(rgb, np.uint8),
            [*faces, *_checked_faces(also)],
            [*unsure, *also.get("unsure", ())],
            [*other, *also.get("other", ())],
            (complete, False),
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


def _may_be_sign(scene: dict[str, Any], thing: dict[str, Any]) -> bool:
    return scene["file"].startswith("jd_") or thing.get("kind") != "traffic light"


WEIGHTS = {
    "rendered": 0.35,
    "us_freeway_challenge": 0.03,
    "us_freeway_white_right": 0.03,
    "ca_city_garmin": 0.14,
    "scenes": 0.10,
    "scenes_speed_us": 0.12,
    "scenes_mixed": 0.23,
}
"""How often an image of a kind of source is drawn; within a kind, sources are alike."""

LICENCES = {
    "rendered": "own",
    "us_freeway_challenge": "MIT (upstream)",
    "us_freeway_white_right": "MIT (upstream)",
    "ca_city_garmin": "MIT",
    "scenes": "MIT (named by the source)",
    "scenes_speed_us": "GPL-3.0 (file of the source)",
    "scenes_mixed": "CC0 1.0 (as published elsewhere), pictures 0-156 left out",
}
"""Licences of the kinds of sources, as found; those of the drawn faces are stated with them."""


def source_kind(source: str) -> str:
    """The kind of a source, a key of `WEIGHTS`."""
    return source.split("/")[0]


def drawing_probability(images: Sequence[LabelledImage]) -> NDArray[np.float64]:
    """How often each image is drawn, (images,)."""
    count = Counter(image.source for image in images)
    per_kind = Counter(source_kind(source) for source in count)
    share = [
        WEIGHTS[source_kind(i.source)] / per_kind[source_kind(i.source)] / count[i.source]
        for i in images
    ]
    return np.asarray(np.array(share) / np.sum(share), np.float64)


def real_sources(
    folder: Path, without: Collection[str] = ()
) -> dict[str, Callable[[], Iterator[LabelledImage]]]:
    """The sources of a folder of real images that the models of one image are learned from, by name.

    Only what its README marks as fit for that; what is not here is for tests. A source is held out as a whole:
    `without` names those to be left out. Raises InputError if a source has no such name.
    """
    drives = ("us_freeway_challenge", "us_freeway_white_right", "ca_city_garmin")
    sources: dict[str, Callable[[], Iterator[LabelledImage]]] = {
        name: partial(real_drive_images, folder / f"{name}.mcap") for name in drives
    }
    for prefix in ("jd", "mi"):
        sources[f"scenes/{prefix}"] = partial(scene_set_images, folder / "scenes", (f"{prefix}_",))
    for name in ("scenes_mixed", "scenes_speed_us"):
        sources[name] = partial(scene_set_images, folder / name)
    if unknown := set(without) - sources.keys():
        raise InputError(
            f"there are no sources {', '.join(sorted(unknown))} to leave out among {', '.join(sources)}"
        )
    return {name: read for name, read in sources.items() if name not in without}


def training_images(
    drives: Path | None, real: Path | None, without: Collection[str] = ()
) -> list[LabelledImage]:
    """All images that are learned from; `without` names real sources that are held out."""
    found: list[LabelledImage] = []
    for log in sorted(drives.glob("learn_*.mcap")) if drives else []:
        found += rendered_images(log)
    for read in real_sources(real, without).values() if real else []:
        found += read()
    return found
