"""Our file of labels: Parquet, its columns those of `schemas.labels.LABELS`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.pipeline.files.input_files import open_input, read_parquet
from wayside.pipeline.files.parquet import record_batch
from wayside.pipeline.files.writing import whole_file
from wayside.schemas.errors import InputError
from wayside.schemas.labels import COMPLETE, LABELS, Box, Label, LabelledImage, Labels, Polygon

CORNERS = ("x_min", "y_min", "x_max", "y_max")
_OPTIONAL = {"wanted": True, "source": "", "note": ""}
"""What a file of others may leave out, though our own never does."""


def write_labels(labels: Labels, path: Path, *, overwrite: bool = False) -> None:
    """Write labels in their order, then the images in which every sign is labelled.

    Raises
    ------
    OutputError
        The file cannot be written, or one that holds no labels stands there.
    """
    rows = list(_rows(labels))
    values = {column.name: [row.get(column.name) for row in rows] for column in LABELS.columns}
    table = pa.Table.from_batches([record_batch(LABELS, values)], LABELS.schema)
    with whole_file(path, is_own=is_label_file, overwrite=overwrite) as stream:
        pq.write_table(table, stream, compression="zstd")


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

    Raises
    ------
    InputError
        It cannot be read, lacks the boxes or what they are of, or a row says what is no label.
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
    labels, complete = [], []
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


def _rows(labels: Labels) -> Iterator[dict[str, Any]]:
    for label in labels.labels:
        rest: dict[str, Any] = {
            name: getattr(label, name)
            for name in ("kind", "color", "shape", "panel", "visible", "wanted", "source", "note")
        }
        corners = dict(zip(CORNERS, label.box, strict=True))
        polygon = [list(point) for point in label.polygon] or None
        yield _image_values(label.image) | corners | rest | {"polygon": polygon}
    for image in labels.complete:
        yield _image_values(image) | {"kind": COMPLETE} | _OPTIONAL


def _image_values(image: LabelledImage) -> dict[str, Any]:
    width, height = image.size or (None, None)
    return {
        "log": image.log,
        "frame": image.frame,
        "log_time_ns": image.log_time_ns,
        "image_name": image.image_name,
        "image_width": width,
        "image_height": height,
    }


def _image(row: dict[str, Any]) -> LabelledImage:
    image = LabelledImage(
        row.get("log"), row.get("frame"), row.get("log_time_ns"), row.get("image_name")
    )
    if "image_width" in row and "image_height" in row:
        return replace(image, size=(row["image_width"], row["image_height"]))
    return image


def _label(image: LabelledImage, row: dict[str, Any]) -> Label:
    x0, y0, x1, y1 = (row[name] for name in CORNERS)
    box: Box = (x0, y0, x1, y1)
    polygon: Polygon = tuple((x, y) for x, y in row.get("polygon", ()))
    return Label(
        image,
        row["kind"],
        box,
        row.get("color"),
        row.get("shape"),
        polygon,
        row.get("panel"),
        row.get("visible"),
        row["wanted"],
        row["source"],
        row["note"],
    )
