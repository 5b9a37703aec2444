"""Rows as CSV and as GeoJSON, written as they come."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable
from datetime import datetime
from io import TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO

from wayside.pipeline.exporting.flat_table import GEOMETRY, FlatTable
from wayside.pipeline.files.parsing import guarded
from wayside.schemas.tables import Column


def write_csv(columns: Iterable[Column], tables: Iterable[FlatTable], stream: BinaryIO) -> None:
    """The first line has the names of the columns. Unknown values are empty, and times are ISO 8601, UTC.

    No text is a formula.
    """
    text = TextIOWrapper(stream, "utf-8", newline="")
    names = [column.name for column in columns]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for table in tables:
        writer.writerows([_cell(row.get(name)) for name in names] for row in table.rows)
    text.detach()


def write_geojson(columns: Iterable[Column], tables: Iterable[FlatTable], stream: BinaryIO) -> None:
    """RFC 7946, a feature a line: WGS 84, longitude before latitude; the height is that above the ellipsoid."""
    names = [column.name for column in columns]
    stream.write(b'{"type": "FeatureCollection", "features": [')
    between = "\n"
    for table in tables:
        for row in table.rows:
            point = row[GEOMETRY]
            geometry = None if point is None else {"type": "Point", "coordinates": point}
            values = {name: _finite(plain_value(row.get(name))) for name in names}
            feature = {"type": "Feature", "geometry": geometry, "properties": values}
            stream.write((between + json.dumps(feature)).encode())
            between = ",\n"
    stream.write(b"\n]}\n")


def count_rows(file: Path, kind: str) -> int:
    """Rows of a `csv`, or features of a `geojson`, that was written here, read back; -1 where its end is missing."""
    with file.open(encoding="utf-8", newline="") as text:
        if kind == "csv":
            return sum(1 for _ in csv.reader(text)) - 1
        ends = [
            line.rstrip("\n") == "]}" for line in text
        ]  # the first and the last line hold no feature
    return len(ends) - 2 if ends and ends[-1] else -1


def plain_value(value: Any) -> Any:
    """The value itself, a time in ISO 8601."""
    return value.isoformat() if isinstance(value, datetime) else value


def _cell(value: Any) -> Any:
    plain = plain_value(value)
    return "" if plain is None else guarded(plain) if isinstance(plain, str) else plain


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
