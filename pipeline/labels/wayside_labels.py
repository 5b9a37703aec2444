"""Labels in wayside's own formats: the truth of rendered drives, hand-made boxes, marks, and the Parquet file."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.pipeline.files.input_files import open_input, read_input_text
from wayside.pipeline.files.parquet import read_parquet, record_batch
from wayside.pipeline.files.parsing import parse_json
from wayside.pipeline.files.writing import whole_file
from wayside.pipeline.labels.formats import Classes, Collected, Entry, read_coco
from wayside.schemas.detections import SHAPES
from wayside.schemas.errors import InputError
from wayside.schemas.labels import (
    BACK,
    COMPLETE,
    LABELS,
    NOT_A_SIGN,
    SIGN,
    Label,
    LabelledImage,
    Labels,
    Polygon,
)

CORNERS = ("x_min", "y_min", "x_max", "y_max")
_TO_EDGES = 0.5
"""Added to coordinates in which the middles of pixels lie at integers, to give edges."""
_OPTIONAL = {"wanted": True, "source": "", "note": ""}
"""Columns that a file of others may leave out; our own never does."""
_OF_LABEL = tuple(one.name for one in fields(Label) if one.name not in ("image", "box", "polygon"))
_OF_IMAGE = tuple(one.name for one in fields(LabelledImage) if one.name != "size")


def read_json(path: Path, classes: Classes | None) -> Labels:
    """Labels of a JSON file of any format, recognised by its content. Raises ValueError for other files."""
    content = parse_json(read_input_text(path))
    if isinstance(content, list) and content and "signs" in content[0]:
        return _read_scenes(content, path.name)
    if isinstance(content, dict):
        if "wayside_marks" in content:
            return _read_marks(content)
        if {"images", "annotations"} <= content.keys():
            return read_coco(content, classes, path.name)
        if {"signs", "stride", "distractors"} <= content.keys():
            return _read_real(content, path.name)
        if {"signs", "frames", "camera"} <= content.keys():
            return _read_truth(content, path.name)
    raise ValueError(
        "neither marks, COCO (images, annotations) nor truth of a drive (signs, frames)"
    )


def _read_truth(truth: Entry, source: str) -> Labels:
    """Labels of a rendered drive by its `truth.json`: every view of every panel, and what resembles signs."""
    found = Collected(source)
    size = (int(truth["camera"]["width"]), int(truth["camera"]["height"]))
    images = {
        one["index"]: LabelledImage(
            str(truth["name"]), one["index"], one["log_time_ns"], None, size
        )
        for one in truth["frames"]
    }
    for sign in truth["signs"]:
        for view in sign["frames"]:
            polygons = view.get("polygons", ())
            found.add(
                images[view["frame"]],
                SIGN if view["side"] == "front" else BACK,
                _to_edges(view["box"]),
                sign["color"],
                sign["shape"],
                polygon=tuple(
                    map(tuple, map(_to_edges, polygons[0])) if len(polygons) == 1 else ()
                ),
                panel=str(sign["id"]),
                visible=view.get("visible_fraction"),
                wanted=bool(sign["faces_travel"]),
                note=sign["kind"],
            )
    for thing in truth.get("distractors", ()):
        for view in thing["frames"]:
            about = {"panel": str(thing["id"]), "note": thing["kind"]}
            found.add(images[view["frame"]], NOT_A_SIGN, _to_edges(view["box"]), **about)
    for image in images.values():
        found.is_complete(image)
    return found.done()


def _read_real(labels: Entry, source: str) -> Labels:
    """Labels of a real drive by its `labels.json`: hand-made boxes, not complete, and what is known to be no sign."""
    found, log = Collected(source), Path(labels["log"]).stem
    width, height = labels["image_size"]

    def image(frame: int) -> LabelledImage:
        return LabelledImage(log, frame, None, None, (int(width), int(height)))

    for sign in labels["signs"]:
        named = set(re.split(r"[\s()]+", sign["shape"].split(",")[0])) & set(SHAPES)
        for entry in sign.get("boxes", ()):
            found.add(
                image(entry["i"]),
                BACK if sign["facing"] == "back" else SIGN,
                _to_edges(entry["box"]),
                sign["colour"],
                min(named) if len(named) == 1 else None,
                panel=sign["id"],
                wanted=bool(sign["wanted"]),
                note=sign["what"],
            )
    for thing in labels["distractors"]:
        for entry in (*thing.get("boxes", ()), *([thing] if "box" in thing else ())):
            frame = entry["i"] if "i" in entry else entry["source_frame"] // labels["stride"]
            found.add(image(frame), NOT_A_SIGN, _to_edges(entry["box"]), note=thing["what"])
    return found.done()


def _read_scenes(scenes: Sequence[Entry], source: str) -> Labels:
    """Labels of single images by a `scenes.json`: a list of `file`, `width`, `height`, `signs` and `complete`."""
    found = Collected(source)
    for scene in scenes:
        size = (int(scene["width"]), int(scene["height"]))
        image = LabelledImage(image_name=scene["file"], size=size)
        for kind, things in ((SIGN, scene["signs"]), (NOT_A_SIGN, scene.get("distractors", ()))):
            for one in things:
                looks = one.get("color"), one.get("shape")
                found.add(image, kind, one["box"], *looks, note=one.get("kind", ""))
        if scene["complete"]:
            found.is_complete(image)
    return found.done()


def _read_marks(marks: Entry) -> Labels:
    """Labels of the marks that the page of `wayside label` saves: one mark counts for all views of its thing."""
    found = Collected(marks["reviewer"] or "wayside label")
    for mark in marks["marks"]:
        for view in mark["views"]:
            image = LabelledImage(marks["log"], int(view["frame"]), int(view["log_time_ns"]))
            looks = mark.get("color"), mark.get("shape")
            panel = f"{marks['log']} {mark['name']}"
            found.add(image, mark["kind"], view["box"], *looks, panel=panel)
    return found.done()


def _to_edges(numbers: Sequence[float]) -> list[float]:
    return [float(number) + _TO_EDGES for number in numbers]


def write_labels(labels: Labels, path: Path, *, overwrite: bool = False) -> None:
    """Write labels in their order, then the images in which every sign is labelled.

    Raises OutputError where the file cannot be written, or another file has its name.
    """
    rows = list(_rows(labels))
    values = {column.name: [row.get(column.name) for row in rows] for column in LABELS.columns}
    table = pa.Table.from_batches([record_batch(LABELS, values)], LABELS.schema)
    with whole_file(path, is_own=is_label_file, overwrite=overwrite) as stream:
        pq.write_table(table, stream, compression="zstd")


def _rows(labels: Labels) -> Iterator[dict[str, Any]]:
    for label in labels.labels:
        row = {name: getattr(label, name) for name in _OF_LABEL}
        row |= {"polygon": [list(point) for point in label.polygon] or None}
        yield _image_row(label.image) | row | dict(zip(CORNERS, label.box, strict=True))
    for image in labels.complete:
        yield _image_row(image) | {"kind": COMPLETE} | _OPTIONAL


def _image_row(image: LabelledImage) -> dict[str, Any]:
    width, height = image.size or (None, None)
    row = {name: getattr(image, name) for name in _OF_IMAGE}
    return row | {"image_width": width, "image_height": height}


def is_label_file(path: Path) -> bool:
    """Whether a file is Parquet with the columns that labels must have."""
    try:
        with open_input(path) as stream:
            names = set(pq.read_schema(stream).names)
    except (OSError, pa.ArrowException):
        return False
    return {"kind", *CORNERS} <= names


def read_label_file(path: Path) -> Labels:
    """The labels of a Parquet file; columns that it lacks are unknown, others are ignored.

    Raises InputError where it cannot be read, lacks the boxes or what they are of, or a row says what is no label.
    """
    try:
        table = read_parquet(path)
        missing = {"kind", *CORNERS} - set(table.column_names)
        if missing:
            raise InputError(
                f"{path}: the column {min(missing)} is missing. Labels have the columns kind, {', '.join(CORNERS)}; "
                "see docs/labels.md."
            )
        columns = [column for column in LABELS.columns if column.name in table.column_names]
        kinds = pa.schema([(c.name, pa.string() if c.values else c.type) for c in columns])
        rows = table.select(kinds.names).cast(kinds).to_pylist()
    except (OSError, pa.ArrowException) as error:
        words = " ".join(str(error).split())[:200]
        raise InputError(
            f"{path}: the labels cannot be read as Parquet: {words}. See docs/labels.md."
        ) from error
    labels: list[Label] = []
    complete: list[LabelledImage] = []
    for number, values in enumerate(rows):
        row = _OPTIONAL | {name: value for name, value in values.items() if value is not None}
        try:
            image = _image(row)
            if row.get("kind") == COMPLETE:
                complete.append(image)
            else:
                labels.append(_label(image, row))
        except (KeyError, ValueError) as error:
            found = f"no {error}" if isinstance(error, KeyError) else str(error)
            raise InputError(
                f"{path}: row {number}: {found}; correct it, see docs/labels.md"
            ) from error
    return Labels(tuple(labels), tuple(complete))


def _image(row: dict[str, Any]) -> LabelledImage:
    known = {name: row.get(name) for name in _OF_IMAGE}
    whole = "image_width" in row and "image_height" in row
    return LabelledImage(**known, size=(row["image_width"], row["image_height"]) if whole else None)


def _label(image: LabelledImage, row: dict[str, Any]) -> Label:
    x0, y0, x1, y1 = (row[name] for name in CORNERS)
    polygon: Polygon = tuple((x, y) for x, y in row.get("polygon", ()))
    known: dict[str, Any] = {name: row.get(name) for name in _OF_LABEL} | {"kind": row["kind"]}
    return Label(image=image, box=(x0, y0, x1, y1), polygon=polygon, **known)
