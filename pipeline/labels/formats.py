"""Labels in formats of others: COCO, Pascal VOC and YOLO.

Classes are named by the data sets themselves. A class map (`class_map`) states which classes are signs and how these
look. Without one every class is a sign, except those named like a kind of label (`back`, `not_sign`, `unsure`). By the
convention of all three formats, every object of an image that they list is labelled.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from wayside.pipeline.files.input_files import files_below, open_input, read_input, read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_yaml
from wayside.pipeline.reading.image_headers import read_image_header
from wayside.pipeline.reading.image_order import natural_key
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.detectors import SignClass
from wayside.schemas.errors import InputError
from wayside.schemas.labels import (
    LABEL_KINDS,
    SIGN,
    UNSURE,
    Box,
    Label,
    LabelledImage,
    Labels,
    Polygon,
)

Classes = Mapping[str, SignClass]
Entry = Mapping[str, Any]
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".avif")
_HEADER_BYTES = 1 << 20
_BEYOND = 0.01
"""How far rounding may carry a fraction of the image out of 0 to 1."""


class Collected:
    """Labels while they are read: what cannot be used is counted by reason."""

    def __init__(self, source: str, classes: Classes | None = None) -> None:
        self._source, self._classes = source, classes
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
        """Leave out an entry that is not a label, and say where it is."""
        outer, self._place = self._place, place
        try:
            yield
        except CONTENT_FAULTS as error:
            words = f"no {error}" if isinstance(error, KeyError) else str(error)
            self.leave_out(reason, image, f": {words[:160]}")
        self._place = outer

    def named(
        self, image: LabelledImage, name: str, box: Box, *, crowd: bool = False, **rest: Any
    ) -> None:
        """Add a box of a class by its name."""
        kind, sign = name if name in LABEL_KINDS else SIGN, SignClass()
        self._names.add(name)
        if crowd:
            kind = UNSURE
        elif self._classes is not None:
            if name not in self._classes:
                self._left_out["other_class"] += 1
                return
            kind, sign = SIGN, self._classes[name]
        self.add(image, kind, box, sign.color, sign.shape, note=name, **rest)

    def add(
        self,
        image: LabelledImage,
        kind: str,
        box: Sequence[float],
        color: str | None = None,
        shape: str | None = None,
        **rest: Any,
    ) -> None:
        """Add a label; a box without area is left out."""
        x0, y0, x1, y1 = (float(edge) for edge in box)
        if not (x0 < x1 and y0 < y1):
            self.leave_out("no_area", image)
            return
        color = color if color in COLORS else None
        shape = shape if shape in SHAPES else None
        edges = (x0, y0, x1, y1)
        self._labels.append(Label(image, kind, edges, color, shape, source=self._source, **rest))

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
    """Labels of a COCO data set; `frame` or `log_time_ns` of an image may replace or accompany its `file_name`.

    Regions of a crowd are neither right nor wrong.
    """
    found, names = Collected(source, classes), coco_classes(content)
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
            name = names.get(one.get("category_id"), str(one.get("category_id")))
            polygon = _coco_polygon(one.get("segmentation"))
            crowd = bool(one.get("iscrowd"))
            found.named(image, name, coco_box(one), polygon=polygon, crowd=crowd)
    for image in images.values():
        found.is_complete(image)
    return found.done()


def coco_box(entry: Entry) -> Box:
    """Corners of the box of an annotation or a result, pixels. Raises ValueError without a box."""
    values = entry.get("bbox")
    try:
        x, y, width, height = (float(value) for value in values or ())
    except (OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"bbox is {str(values)[:40]}, not x, y, width, height") from error
    return x, y, x + width, y + height


def coco_classes(content: Entry) -> dict[Any, str]:
    """Names of the classes of a data set by their ids."""
    return {one["id"]: str(one["name"]) for one in content.get("categories", ())}


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


def read_voc(folder: Path, classes: Classes | None) -> Labels:
    """Labels of a folder of Pascal VOC: one XML file an image, boxes with both ends included, the first pixel 1.

    What is `difficult` does not count for recall.
    """
    found = Collected(folder.name, classes)
    for path in sorted(files_below(folder), key=natural_key):
        if path.suffix.lower() == ".xml":
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
    width, height = (int(root.findtext(f"size/{side}") or 0) for side in ("width", "height"))
    image = LabelledImage(image_name=name, size=(width, height) if width and height else None)
    for one in root.iter("object"):
        name = one.findtext("name") or ""
        hard = (one.findtext("difficult") or "0").strip() == "1"
        with found.entry(f"{path.name}, object {name}", image):
            ends = [one.findtext(f"bndbox/{end}") for end in ("xmin", "ymin", "xmax", "ymax")]
            x0, y0, x1, y1 = (float(end) if end else math.nan for end in ends)
            found.named(image, name, (x0 - 1, y0 - 1, x1, y1), wanted=not hard)
    found.is_complete(image)


def read_yolo(folder: Path, classes: Classes | None) -> Labels:
    """Labels of a folder of YOLO: one text file an image, `class x y width height` or `class x1 y1 x2 y2 ...`.

    Numbers are fractions of the image, whose size is read from the image itself: next to the text, or in `images`
    where the text is in `labels`. Names of the classes, and how many key points stand behind a box, are from a
    `data.yaml` or `classes.txt`. An image without text is not labelled.
    """
    found = Collected(folder.name, classes)
    names, points = _yolo_classes(folder)
    files = {
        path.relative_to(folder): path
        for path in files_below(folder)
        if path.suffix.lower() in IMAGE_SUFFIXES
    }
    for inside in sorted(files, key=natural_key):
        text = _text_of(folder, inside)
        if text is None:
            found.leave_out("image_without_text")
            continue
        with found.entry(str(inside), reason="image_not_readable"):
            with open_input(files[inside]) as stream:
                header = read_image_header(stream.read(_HEADER_BYTES))
            if header is None:
                raise ValueError("no image of a known format")
            size = header.width, header.height
            image = LabelledImage(image_name=inside.name, size=size)
            for row, line in enumerate(read_input_text(text).splitlines(), 1):
                with found.entry(f"{text.relative_to(folder)}, line {row}", image):
                    if line.strip():
                        number, box, polygon = _yolo_line(line, size, points)
                        found.named(image, names.get(number, str(number)), box, polygon=polygon)
            found.is_complete(image)
    return found.done()


def _yolo_line(line: str, size: tuple[int, int], points: int) -> tuple[int, Box, Polygon]:
    """Class, box and polygon of a line, pixels; raises ValueError as `_yolo_outline`."""
    number, *values = (float(value) for value in line.split())
    if not number.is_integer():
        raise ValueError(f"class {number} is not a whole number")
    (x0, y0, x1, y1), corners = _yolo_outline(values, points)
    w, h = size
    return int(number), (x0 * w, y0 * h, x1 * w, y1 * h), tuple((x * w, y * h) for x, y in corners)


def _yolo_outline(values: Sequence[float], points: int) -> tuple[Box, Polygon]:
    """Box and polygon, as fractions, that the numbers behind a class are; ValueError where that is not clear.

    Behind a box may stand `points` numbers of key points, a confidence and the number of a track, behind a polygon a
    confidence. The number of a track may stand alone.
    """
    count = len(values)
    behind = 0 if count == 4 else count - 4 - points
    corners = values[: count - count % 2]
    is_box = _are_fractions(values[:4]) and 0 <= behind <= 2 and _is_tail(values[count - behind :])
    is_polygon = not points and count >= 6 and _are_fractions(corners)
    is_polygon = is_polygon and _is_tail(values[len(corners) :])
    if is_polygon and (is_box or _may_be_key_points(values)):
        raise ValueError(
            f"{count} numbers can be a polygon or a box with more behind it; key points need kpt_shape in data.yaml"
        )
    if is_box:
        x, y, w, h = values[:4]
        return (x - w / 2, y - h / 2, x + w / 2, y + h / 2), ()
    if is_polygon:
        across, down = corners[::2], corners[1::2]
        box = (min(across), min(down), max(across), max(down))
        return box, tuple(zip(across, down, strict=True))
    raise ValueError(f"{count} numbers are neither a box nor a polygon in fractions of the image")


def _may_be_key_points(values: Sequence[float]) -> bool:
    """Whether what could be a polygon is rather a box, and points on it: these lie nearer together than all corners."""
    x, y, w, h, *rest = values
    across, down = rest[::2], rest[1::2]
    on_it = all(abs(one - x) <= w for one in across) and all(abs(one - y) <= h for one in down)
    wide, high = (max(*own, side) - min(*own, side) for own, side in ((across, w), (down, h)))
    return on_it and w * h < wide * high


def _is_tail(values: Sequence[float]) -> bool:
    """Whether these can be a confidence, the number of a track, or both."""
    if len(values) == 2:
        return 0 <= values[0] <= 1 and values[1] >= 0 and values[1].is_integer()
    return all(0 <= value <= 1 or (value > 1 and value.is_integer()) for value in values)


def _are_fractions(values: Sequence[float]) -> bool:
    return all(-_BEYOND <= value <= 1 + _BEYOND for value in values)


def _yolo_classes(folder: Path) -> tuple[dict[int, str], int]:
    """Names of the classes, and how many numbers of key points stand behind a box."""
    for parent in (folder, folder.parent):
        for path in (parent / "data.yaml", parent / "classes.txt"):
            if path.is_file():
                text = read_input_text(path)
                content = (
                    parse_yaml(text) if path.suffix == ".yaml" else {"names": text.splitlines()}
                )
                names, points = content["names"], content.get("kpt_shape", (0, 0))
                pairs = names.items() if isinstance(names, dict) else enumerate(names)
                return {int(n): str(name) for n, name in pairs}, int(points[0]) * int(points[1])
    return {}, 0


def _text_of(folder: Path, image: Path) -> Path | None:
    """The text file of an image."""
    parts = ["labels" if part == "images" else part for part in image.parts]
    beside = {folder / image, folder.joinpath(*parts), folder / "labels" / image}
    texts = (path.with_suffix(".txt") for path in sorted(beside))
    return next((text for text in texts if text.is_file()), None)
