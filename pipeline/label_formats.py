"""Labels in the formats of others (COCO, YOLO, Pascal VOC), and in those of wayside's rendered and real drives.

Classes are named by the data sets themselves. A class map (`class_map`) says which are signs and what these look like;
without one every class is a sign, except those that are named as a kind of label is (`back`, `not_sign`, `unsure`).
By the convention of all three formats, every object of an image that they list is labelled.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from wayside.pipeline.image_order import natural_key
from wayside.pipeline.input_files import open_input, read_input, read_input_text
from wayside.pipeline.json_text import parse_json
from wayside.pipeline.reading.image_headers import read_image_header
from wayside.pipeline.yaml_text import parse_yaml
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.detectors import SignClass
from wayside.schemas.errors import InputError
from wayside.schemas.labels import (
    BACK,
    LABEL_KINDS,
    NOT_A_SIGN,
    SIGN,
    UNSURE,
    Box,
    Label,
    LabelledImage,
    Labels,
    Polygon,
)

Entry = Mapping[str, Any]
Classes = Mapping[str, SignClass]
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".avif")
_HEADER_BYTES = 1 << 20
_TO_EDGES = 0.5
"""What an edge has more than in coordinates in which the middles of pixels lie at integers."""


class Collected:
    """Labels while they are read: what cannot be used is counted by reason."""

    def __init__(self, classes: Classes | None, source: str) -> None:
        self._classes, self._source = classes, source
        self._labels: list[Label] = []
        self._complete: list[LabelledImage] = []
        self._unread: set[LabelledImage] = set()
        self._names: set[str] = set()
        self._left_out: Counter[str] = Counter()

    def named(
        self,
        image: LabelledImage,
        name: str,
        box: Box,
        *,
        polygon: Polygon = (),
        wanted: bool = True,
        crowd: bool = False,
    ) -> None:
        """Add a box of a class by its name."""
        kind, sign = SIGN, SignClass()
        self._names.add(name)
        if crowd:
            kind = UNSURE
        elif self._classes is not None:
            if name not in self._classes:
                self._left_out["other_class"] += 1
                return
            sign = self._classes[name]
        elif name in LABEL_KINDS:
            kind = name
        self.add(
            image, kind, box, sign.color, sign.shape, polygon=polygon, wanted=wanted, note=name
        )

    def add(
        self,
        image: LabelledImage,
        kind: str,
        box: Box,
        color: str | None = None,
        shape: str | None = None,
        **rest: Any,
    ) -> None:
        """Add a label; a box without area is left out."""
        if not all(map(math.isfinite, box)) or box[0] >= box[2] or box[1] >= box[3]:
            self.leave_out("no_area", image)
            return
        color = color if color in COLORS else None
        shape = shape if shape in SHAPES else None
        self._labels.append(Label(image, kind, box, color, shape, source=self._source, **rest))

    def is_complete(self, image: LabelledImage) -> None:
        """Every sign of this image is labelled, unless one of its labels could not be used."""
        if image not in self._unread:
            self._complete.append(image)

    def leave_out(self, reason: str, image: LabelledImage | None = None) -> None:
        """Count a label or an image that cannot be used; an image with such a label is not complete."""
        self._left_out[reason] += 1
        if image is not None:
            self._unread.add(image)

    def done(self) -> Labels:
        """All of them; raises InputError where the class map names none of the classes that came in."""
        if self._classes is not None and self._names and not self._names & self._classes.keys():
            raise InputError(
                f"models.classes: wanted classes of {self._source} ({', '.join(sorted(self._names)[:20])}), "
                f"found {', '.join(map(repr, self._classes))}; correct the class map"
            )
        return Labels(tuple(self._labels), tuple(self._complete), dict(self._left_out))


def read_coco(content: Entry, classes: Classes | None, source: str) -> Labels:
    """Labels of a COCO data set; `frame` or `log_time_ns` of an image stand beside or instead of its `file_name`.

    Regions of a crowd are neither right nor wrong.
    """
    found = Collected(classes, source)
    names = {one["id"]: str(one["name"]) for one in content.get("categories", ())}
    images = {one["id"]: _coco_image(one) for one in content["images"]}
    for one in content["annotations"]:
        image = images.get(one["image_id"])
        if image is None:
            found.leave_out("no_such_image")
            continue
        if "bbox" not in one:
            found.leave_out("no_box", image)
            continue
        x, y, width, height = (float(value) for value in one["bbox"])
        number = one.get("category_id")
        found.named(
            image,
            names.get(number, str(number)),
            (x, y, x + width, y + height),
            polygon=_coco_polygon(one.get("segmentation")),
            crowd=bool(one.get("iscrowd")),
        )
    for image in images.values():
        found.is_complete(image)
    return found.done()


def read_yolo(folder: Path, classes: Classes | None) -> Labels:
    """Labels of a folder of YOLO: one text file an image, `class x y width height` or `class x1 y1 x2 y2 ...`.

    Numbers are fractions of the image, whose size is read from the image itself: beside the text, or in `images` where
    that lies in `labels`. Names of the classes are those of a `data.yaml` or `classes.txt`, else their numbers. An
    image without text is not labelled.
    """
    found = Collected(classes, folder.name)
    names = _yolo_names(folder)
    files = {
        path.relative_to(folder): path
        for path in folder.rglob("*")
        if path.suffix.lower() in IMAGE_SUFFIXES
    }
    for inside in sorted(files, key=natural_key):
        text = _yolo_text(folder, inside)
        if text is None:
            found.leave_out("image_without_text")
            continue
        with open_input(files[inside]) as stream:
            header = read_image_header(stream.read(_HEADER_BYTES))
        if header is None:
            found.leave_out("image_not_readable")
            continue
        image = LabelledImage(image_name=inside.name, size=(header.width, header.height))
        for row, line in enumerate(read_input_text(text).splitlines(), 1):
            if not line.strip():
                continue
            number, *values = line.split()
            try:
                box, polygon = _yolo_box([float(value) for value in values], header[1:])
                name = names.get(int(number), number)
            except ValueError as error:
                raise ValueError(f"{text}, line {row}: {error}") from error
            found.named(image, name, box, polygon=polygon)
        found.is_complete(image)
    return found.done()


def read_voc(folder: Path, classes: Classes | None) -> Labels:
    """Labels of a folder of Pascal VOC: one XML file an image, boxes with both ends included, the first pixel 1.

    What is `difficult` does not count for recall.
    """
    found = Collected(classes, folder.name)
    for path in sorted(folder.rglob("*.xml"), key=natural_key):
        try:
            root = ElementTree.fromstring(read_input(path))
        except ElementTree.ParseError as error:
            raise ValueError(f"{path}: {error}") from error
        if root.tag != "annotation":
            found.leave_out("other_xml")
            continue
        name = Path(root.findtext("filename") or f"{path.stem}.jpg").name
        size = (int(root.findtext(f"size/{side}") or 0) for side in ("width", "height"))
        width, height = size
        image = LabelledImage(image_name=name, size=(width, height) if width and height else None)
        for one in root.iter("object"):
            ends = [one.findtext(f"bndbox/{end}") for end in ("xmin", "ymin", "xmax", "ymax")]
            x0, y0, x1, y1 = (float(end) if end else math.nan for end in ends)
            hard = (one.findtext("difficult") or "0").strip() == "1"
            found.named(
                image, one.findtext("name") or "", (x0 - 1, y0 - 1, x1, y1), wanted=not hard
            )
        found.is_complete(image)
    return found.done()


def read_truth(truth: Entry, source: str) -> Labels:
    """Labels of a rendered drive by its `truth.json`: every view of every panel, and what resembles signs."""
    found = Collected(None, source)
    log = str(truth["name"])
    size = (int(truth["camera"]["width"]), int(truth["camera"]["height"]))
    images = {
        one["index"]: LabelledImage(log, one["index"], one["log_time_ns"], None, size)
        for one in truth["frames"]
    }
    for sign in truth["signs"]:
        for view in sign["frames"]:
            found.add(
                images[view["frame"]],
                SIGN if view["side"] == "front" else BACK,
                _to_edges(view["box"]),
                sign["color"],
                sign["shape"],
                polygon=_outline(view.get("polygons", ())),
                panel=str(sign["id"]),
                visible=view.get("visible_fraction"),
                wanted=bool(sign["faces_travel"]),
                note=sign["kind"],
            )
    for thing in truth.get("distractors", ()):
        for view in thing["frames"]:
            found.add(
                images[view["frame"]],
                NOT_A_SIGN,
                _to_edges(view["box"]),
                panel=str(thing["id"]),
                note=thing["kind"],
            )
    for image in images.values():
        found.is_complete(image)
    return found.done()


def read_real(labels: Entry, source: str) -> Labels:
    """Labels of a real drive by its `labels.json`: hand-made boxes, not complete, and what is known to be no sign."""
    found = Collected(None, source)
    log = Path(labels["log"]).stem
    width, height = labels["image_size"]

    def image(frame: int) -> LabelledImage:
        return LabelledImage(log, frame, None, None, (int(width), int(height)))

    for sign in labels["signs"]:
        for entry in sign.get("boxes", ()):
            found.add(
                image(entry["i"]),
                BACK if sign["facing"] == "back" else SIGN,
                _to_edges(entry["box"]),
                sign["colour"],
                _shape_in(sign["shape"]),
                panel=sign["id"],
                wanted=bool(sign["wanted"]),
                note=sign["what"],
            )
    for thing in labels["distractors"]:
        for entry in (*thing.get("boxes", ()), *([thing] if "box" in thing else ())):
            frame = entry["i"] if "i" in entry else entry["source_frame"] // labels["stride"]
            found.add(image(frame), NOT_A_SIGN, _to_edges(entry["box"]), note=thing["what"])
    return found.done()


def read_scenes(scenes: Sequence[Entry], source: str) -> Labels:
    """Labels of single images by a `scenes.json`: a list of `file`, `width`, `height`, `signs` and `complete`."""
    found = Collected(None, source)
    for scene in scenes:
        image = LabelledImage(
            image_name=scene["file"], size=(int(scene["width"]), int(scene["height"]))
        )
        for kind, things in ((SIGN, scene["signs"]), (NOT_A_SIGN, scene.get("distractors", ()))):
            for one in things:
                x0, y0, x1, y1 = (float(edge) for edge in one["box"])
                color, shape = one.get("color"), one.get("shape")
                found.add(image, kind, (x0, y0, x1, y1), color, shape, note=one.get("kind", ""))
        if scene["complete"]:
            found.is_complete(image)
    return found.done()


def read_marks(marks: Entry) -> Labels:
    """Labels of the marks that the page of `wayside label` saves: one mark counts for all views of its thing."""
    found = Collected(None, marks["reviewer"] or "wayside label")
    for mark in marks["marks"]:
        for view in mark["views"]:
            image = LabelledImage(marks["log"], int(view["frame"]), int(view["log_time_ns"]))
            x0, y0, x1, y1 = (float(edge) for edge in view["box"])
            box, look = (x0, y0, x1, y1), (mark.get("color"), mark.get("shape"))
            found.add(image, mark["kind"], box, *look, panel=f"{marks['log']} {mark['name']}")
    return found.done()


def read_json(path: Path, classes: Classes | None) -> Labels:
    """Labels of a JSON file of any of these formats, told apart by what it holds; ValueError where it is none."""
    content = parse_json(read_input(path))
    if isinstance(content, list) and content and "signs" in content[0]:
        return read_scenes(content, path.name)
    if isinstance(content, dict):
        if "wayside_marks" in content:
            return read_marks(content)
        if {"images", "annotations"} <= content.keys():
            return read_coco(content, classes, path.name)
        if {"signs", "stride", "distractors"} <= content.keys():
            return read_real(content, path.name)
        if {"signs", "frames", "camera"} <= content.keys():
            return read_truth(content, path.name)
    raise ValueError(
        "neither marks, COCO (images, annotations) nor truth of a drive (signs, frames)"
    )


def _coco_image(one: Entry) -> LabelledImage:
    size = (int(one["width"]), int(one["height"])) if {"width", "height"} <= one.keys() else None
    name = one.get("file_name")
    frame, time_ns = (None if key not in one else int(one[key]) for key in ("frame", "log_time_ns"))
    return LabelledImage(one.get("log"), frame, time_ns, None if name is None else str(name), size)


def _coco_polygon(segmentation: Any) -> Polygon:
    """The outline where it is one polygon; none where it is several, or a mask."""
    if not isinstance(segmentation, list) or len(segmentation) != 1:
        return ()
    values = [float(value) for value in segmentation[0]]
    return tuple(zip(values[::2], values[1::2], strict=True))


def _yolo_names(folder: Path) -> dict[int, str]:
    for parent in (folder, folder.parent):
        for path in (parent / "data.yaml", parent / "classes.txt"):
            if path.is_file():
                text = read_input_text(path)
                names = text.splitlines() if path.suffix == ".txt" else parse_yaml(text)["names"]
                return {
                    int(number): str(name)
                    for number, name in (
                        names.items() if isinstance(names, dict) else enumerate(names)
                    )
                }
    return {}


def _yolo_text(folder: Path, image: Path) -> Path | None:
    """The text file of an image."""
    parts = ["labels" if part == "images" else part for part in image.parts]
    beside = {folder / image, folder.joinpath(*parts), folder / "labels" / image}
    texts = (path.with_suffix(".txt") for path in sorted(beside))
    return next((text for text in texts if text.is_file()), None)


def _yolo_box(values: Sequence[float], size: tuple[int, int]) -> tuple[Box, Polygon]:
    width, height = size
    if len(values) == 4:
        x, y, w, h = values[0] * width, values[1] * height, values[2] * width, values[3] * height
        return (x - w / 2, y - h / 2, x + w / 2, y + h / 2), ()
    if len(values) < 6 or len(values) % 2:
        raise ValueError(f"wanted 4 numbers of a box or pairs of a polygon, found {len(values)}")
    points = tuple((x * width, y * height) for x, y in zip(values[::2], values[1::2], strict=True))
    across, down = zip(*points, strict=True)
    return (min(across), min(down), max(across), max(down)), points


def _to_edges(box: Sequence[float]) -> Box:
    x0, y0, x1, y1 = (float(edge) + _TO_EDGES for edge in box)
    return (x0, y0, x1, y1)


def _outline(polygons: Sequence[Sequence[Sequence[float]]]) -> Polygon:
    if len(polygons) != 1:
        return ()
    return tuple((x + _TO_EDGES, y + _TO_EDGES) for x, y in polygons[0])


def _shape_in(words: str) -> str | None:
    """The shape that a description names, None where it names none or several."""
    named = {word for word in _words(words) if word in SHAPES}
    return named.pop() if len(named) == 1 else None


def _words(text: str) -> Iterator[str]:
    yield from text.split(",")[0].replace("(", " ").replace(")", " ").split()
