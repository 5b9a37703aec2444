"""Labels of YOLO, and what programs write behind them: confidences, numbers of tracks, key points."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from wayside.pipeline.files.input_files import files_below, open_input, read_input_text
from wayside.pipeline.files.parsing import parse_yaml
from wayside.pipeline.labels.label_formats import Classes, Collected
from wayside.pipeline.reading.image_headers import read_image_header
from wayside.pipeline.reading.image_order import natural_key
from wayside.schemas.labels import Box, LabelledImage, Labels, Polygon

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".avif")
_HEADER_BYTES = 1 << 20
_BEYOND = 0.01
"""How far rounding may carry a fraction of the image out of 0 to 1."""
_OUTSIDE = 0.1
"""How far a box that a tracker has predicted may reach out of the image."""
_BOX = "a box"
_FAR = 4.0
"""Points of a polygon that pass for key points of a box span at most four times the box: so far are they from it."""
_FARTHEST = 30.0
"""Key points of most boxes do not lie together so closely."""

Readings = Mapping[str, tuple[Box, Polygon]]


@dataclass(frozen=True, slots=True)
class _Line:
    """A line and what it can mean: boxes and polygons in fractions of the image, by what its numbers would be."""

    place: str
    image: LabelledImage
    name: str
    count: int
    readings: Readings


def read_yolo(folder: Path, classes: Classes | None) -> Labels:
    """Labels of a folder of YOLO: one text file an image, `class x y width height` or `class x1 y1 x2 y2 ...`.

    Behind a box there may be key points, behind these or a polygon a confidence and the number of a track. Numbers are
    fractions of the image, whose size is read from the image itself: next to the text, or in `images` where the text is
    in `labels`. Names of the classes are from a `data.yaml` or `classes.txt`, else they are numbers. An image without
    text is not labelled. A line of another form, or of an unknown form, is left out.
    """
    found = Collected(classes, folder.name)
    names = _names(folder)
    files = {
        path.relative_to(folder): path
        for path in files_below(folder)
        if path.suffix.lower() in IMAGE_SUFFIXES
    }
    images: list[LabelledImage] = []
    lines: list[_Line] = []
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
            image = LabelledImage(image_name=inside.name, size=(header.width, header.height))
            lines += _lines(found, image, text, folder, names)
            images.append(image)
    sure = _sure([one.readings for one in lines if one.count > 5])
    for one in lines:
        told = _told(one.readings) or _told(one.readings, sure)
        with found.entry(one.place, one.image):
            if not told:
                raise ValueError(f"it can be {' or '.join(one.readings)}")
            box, polygon = one.readings[told]
            width, height = one.image.size or (0, 0)
            x0, y0, x1, y1 = box
            points = tuple((x * width, y * height) for x, y in polygon)
            edges = (x0 * width, y0 * height, x1 * width, y1 * height)
            found.named(one.image, one.name, edges, polygon=points)
    for image in images:
        found.is_complete(image)
    return found.done()


def _lines(
    found: Collected, image: LabelledImage, text: Path, folder: Path, names: Mapping[int, str]
) -> list[_Line]:
    """The lines of the text of an image."""
    lines = []
    for row, line in enumerate(read_input_text(text).splitlines(), 1):
        place = f"{text.relative_to(folder)}, line {row}"
        with found.entry(place, image):
            if line.strip():
                number, *values = (float(value) for value in line.split())
                if not number.is_integer():
                    raise ValueError(f"class {number} is no whole number")
                name = names.get(int(number), f"{number:.0f}")
                lines.append(_Line(place, image, name, len(values), _readings(values)))
    return lines


def _told(readings: Readings, kinds: Collection[str] = ()) -> str:
    """What a line means: of these kinds where it can be several, else by itself; empty where that cannot be told."""
    area = {kind: _area(box) for kind, (box, _) in readings.items()}
    best, *others = sorted((k for k in area if k in (kinds or area)), key=lambda k: area[k]) or [""]
    if len(area) == 1 or not best:
        return best
    alone = all(area[best] * _FAR < area[other] for other in others)
    likely = area[best] <= min(area.values()) * _FAR if kinds else best == _BOX
    return best if alone and likely else ""


def _sure(lines: Sequence[Readings]) -> set[str]:
    """What the lines of a set mean where by themselves they can mean several.

    It is what others of them must mean. Where all can be boxes and polygons, the polygons are small or it is not known.
    """
    sure = {_told(readings) for readings in lines} - {""}
    if lines and not sure:
        areas = [[_area(box) for box, _ in readings.values()] for readings in lines]
        if median(max(of_line) / max(min(of_line), 1e-12) for of_line in areas) > _FARTHEST:
            sure = {kind for readings in lines for kind in readings} - {_BOX}
    return sure


def _area(box: Box) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


def _readings(values: Sequence[float]) -> Readings:
    """What the numbers behind the class can mean; raises ValueError where that is nothing."""
    found: dict[str, tuple[Box, Polygon]] = {}
    if _is_box(values):
        x, y, w, h = values[:4]
        found[_BOX] = (x - w / 2, y - h / 2, x + w / 2, y + h / 2), ()
    for behind, words in enumerate(("", " and a number", " and two numbers")):
        corners = values[: len(values) - behind]
        if len(corners) < 6 or len(corners) % 2 or not _are_fractions(corners):
            continue
        if _is_tail(values[len(corners) :]):
            across, down = corners[::2], corners[1::2]
            box = (min(across), min(down), max(across), max(down))
            found[f"a polygon{words}"] = box, tuple(zip(across, down, strict=True))
    if not found:
        raise ValueError(
            f"{len(values)} numbers that are no box or polygon in fractions of the image, "
            "alone or with key points, confidence or track"
        )
    return found


def _is_box(values: Sequence[float]) -> bool:
    """Whether numbers can be a box, and what is behind it key points on it, a confidence and the number of a track."""
    if len(values) < 4 or not _are_fractions(values[:4]):
        return False
    x, y, w, h = values[:4]
    if len(values) > 4 and max(w / 2 - x, h / 2 - y, x + w / 2 - 1, y + h / 2 - 1) > _OUTSIDE:
        return False
    for tail in range(3):
        points = values[4 : len(values) - tail]
        if len(values) - tail < 4 or not _is_tail(values[4 + len(points) :]):
            continue
        for step in (2, 3):
            groups = [points[k : k + step] for k in range(0, len(points), step)]
            if len(points) % step == 0 and all(
                ((abs(px - x) <= w and abs(py - y) <= h) or px == py == 0)
                and all(0 <= seen <= 2 for seen in rest)
                for px, py, *rest in groups
            ):
                return True
    return False


def _is_tail(values: Sequence[float]) -> bool:
    """Whether these can be a confidence, the number of a track, or both."""
    if len(values) == 1:
        return 0 <= values[0] <= 1 or (values[0] > 1 and values[0].is_integer())
    return not values or (0 <= values[0] <= 1 and values[1] >= 0 and values[1].is_integer())


def _are_fractions(values: Sequence[float]) -> bool:
    return all(-_BEYOND <= value <= 1 + _BEYOND for value in values)


def _names(folder: Path) -> dict[int, str]:
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


def _text_of(folder: Path, image: Path) -> Path | None:
    """The text file of an image."""
    parts = ["labels" if part == "images" else part for part in image.parts]
    beside = {folder / image, folder.joinpath(*parts), folder / "labels" / image}
    texts = (path.with_suffix(".txt") for path in sorted(beside))
    return next((text for text in texts if text.is_file()), None)
