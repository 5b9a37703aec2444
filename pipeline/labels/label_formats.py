"""Labels in formats of others (COCO, Pascal VOC; YOLO: `yolo_labels`), and of wayside's rendered and real drives.

Classes are named by the data sets themselves. A class map (`class_map`) states which classes are signs and how these
look. Without one every class is a sign, except those named like a kind of label (`back`, `not_sign`, `unsure`). By the
convention of all three formats, every object of an image that they list is labelled.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from wayside.pipeline.files.input_files import files_below, read_input, read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.labels.coco import Entry, coco_box, coco_classes
from wayside.pipeline.reading.image_order import natural_key
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

Classes = Mapping[str, SignClass]
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
        self._first: dict[str, str] = {}
        self._place = ""

    @contextmanager
    def entry(
        self, place: str, image: LabelledImage | None = None, reason: str = "no_box"
    ) -> Iterator[None]:
        """Leave an entry that is no label out, and say where it stands."""
        outer, self._place = self._place, place
        try:
            yield
        except CONTENT_FAULTS as error:
            words = f"no {error}" if isinstance(error, KeyError) else str(error)
            self.leave_out(reason, image, f": {words[:160]}")
        self._place = outer

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

    def leave_out(self, reason: str, image: LabelledImage | None = None, words: str = "") -> None:
        """Count a label or an image that cannot be used; an image with such a label is not complete."""
        self._left_out[reason] += 1
        if self._place:
            self._first.setdefault(reason, f"the first: {self._place}{words}")
        if image is not None:
            self._unread.add(image)

    def done(self) -> Labels:
        """All of them; raises InputError where the class map names none of the classes that came in."""
        if self._classes is not None and self._names and not self._names & self._classes.keys():
            raise InputError(
                f"models.classes: none of {', '.join(map(repr, self._classes))} is a class of {self._source}, which "
                f"has {', '.join(sorted(self._names)[:20])}. Correct the class map."
            )
        return Labels(tuple(self._labels), tuple(self._complete), dict(self._left_out), self._first)


def read_coco(content: Entry, classes: Classes | None, source: str) -> Labels:
    """Labels of a COCO data set; `frame` or `log_time_ns` of an image stand beside or instead of its `file_name`.

    Regions of a crowd are neither right nor wrong.
    """
    found = Collected(classes, source)
    names = coco_classes(content)
    images: dict[Any, LabelledImage] = {}
    for place, one in enumerate(content["images"]):
        with found.entry(f"image {place}", reason="image_not_readable"):
            images[one["id"]] = _coco_image(one)
    for place, one in enumerate(content["annotations"]):
        image = images.get(one.get("image_id"))
        if image is None:
            found.leave_out("no_such_image")
            continue
        with found.entry(f"annotation {place}", image):
            number = one.get("category_id")
            found.named(
                image,
                names.get(number, str(number)),
                coco_box(one),
                polygon=_coco_polygon(one.get("segmentation")),
                crowd=bool(one.get("iscrowd")),
            )
    for image in images.values():
        found.is_complete(image)
    return found.done()


def read_voc(folder: Path, classes: Classes | None) -> Labels:
    """Labels of a folder of Pascal VOC: one XML file an image, boxes with both ends included, the first pixel 1.

    What is `difficult` does not count for recall.
    """
    found = Collected(classes, folder.name)
    for path in sorted(files_below(folder), key=natural_key):
        if path.suffix.lower() != ".xml":
            continue
        with found.entry(path.name, reason="image_not_readable"):
            _read_annotation(path, found)
    return found.done()


def _read_annotation(path: Path, found: Collected) -> None:
    """The labels of one file of Pascal VOC; raises ValueError if it cannot be read."""
    try:
        root = ElementTree.fromstring(read_input(path))
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    if root.tag != "annotation":
        found.leave_out("other_xml")
        return
    name = Path(root.findtext("filename") or f"{path.stem}.jpg").name
    size = (int(root.findtext(f"size/{side}") or 0) for side in ("width", "height"))
    width, height = size
    image = LabelledImage(image_name=name, size=(width, height) if width and height else None)
    for one in root.iter("object"):
        name = one.findtext("name") or ""
        hard = (one.findtext("difficult") or "0").strip() == "1"
        ends = [one.findtext(f"bndbox/{end}") for end in ("xmin", "ymin", "xmax", "ymax")]
        with found.entry(f"{path.name}, object {name}", image):
            x0, y0, x1, y1 = (float(end) if end else math.nan for end in ends)
            found.named(image, name, (x0 - 1, y0 - 1, x1, y1), wanted=not hard)
    found.is_complete(image)


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
    """Labels of a JSON file of any of these formats, recognised by its content. Raises ValueError for other files."""
    content = parse_json(read_input_text(path))
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
    if not isinstance(segmentation, list) or len(segmentation) != 1 or len(segmentation[0]) % 2:
        return ()
    values = [float(value) for value in segmentation[0]]
    return tuple(zip(values[::2], values[1::2], strict=True))


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
