"""Rows as GeoPackage, Shapefile and KML, written by GDAL as they come."""

from __future__ import annotations

import hashlib
import struct
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import pyarrow as pa

from wayside.pipeline.exporting.place import PlacedRows, Point, short_names
from wayside.pipeline.exporting.table import GEOMETRY, Row
from wayside.pipeline.files.writing import PART, is_stream, not_whole, not_written, resolved
from wayside.schemas.errors import OutputError, UsageError
from wayside.schemas.tables import Column

_DRIVERS = {"gpkg": "GPKG", "shp": "ESRI Shapefile", "kml": "LIBKML"}
_LONGEST_TEXT = 254
"""Bytes of a text in a dBASE file."""
_WKB_POINT, _WKB_POINT_Z = 1, 1001


@contextmanager
def made_files(rows: PlacedRows, kind: str, file: Path) -> Iterator[tuple[list[Path], list[str]]]:
    """The files of a table in a scratch folder beside `file`, the main one last; and what was cut.

    GDAL says nothing where a Shapefile or KML finds no room, so that all rows are read back.

    Raises
    ------
    UsageError
        pyogrio is not installed.
    OutputError
        They cannot be written, or are not whole.
    """
    try:
        import pyogrio
    except ImportError as error:
        raise UsageError(
            "files of geographic information systems need the package pyogrio. Install it with pip install "
            "'wayside[gis]'."
        ) from error
    last = rows.source.last
    schema, cut, written = _schema(rows, kind), Counter[str](), hashlib.sha256()
    key = 0 if kind != "kml" else 2  # after its name and description

    def batches() -> Iterator[pa.RecordBatch]:
        for some in rows:
            batch = _batch(some, rows.columns, schema, kind, cut)
            _count(batch, schema.names[key], GEOMETRY, written)
            yield batch

    options = {
        "gpkg": {"VERSION": "1.2"},  # GDAL before 3.7, also that of QGIS 3.22, warns of later ones
        "shp": {"ENCODING": "UTF-8", "DBF_DATE_LAST_UPDATE": f"{last:%Y-%m-%d}"},
    }
    with _scratch_beside(file) as scratch:
        made = scratch / f"{file.stem}.{kind}"
        try:
            with _dated(pyogrio, last):
                pyogrio.write_arrow(
                    pa.RecordBatchReader.from_batches(schema, batches()),
                    made,
                    layer=file.stem if kind == "shp" else rows.source.name,
                    driver=_DRIVERS[kind],
                    geometry_name=GEOMETRY,
                    geometry_type="Point" if kind == "kml" else "Point Z",
                    crs=rows.crs,
                    **options.get(kind, {}),
                )
        except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
            raise OutputError(
                f"{file}: GDAL could not write it: {error}; free some space, or name another file"
            ) from error
        if _read_back(pyogrio, made, schema.names[key]) != written.digest():
            raise not_whole(file)
        beside = sorted(path for path in scratch.iterdir() if path != made)
        words = f"cut to the {_LONGEST_TEXT} bytes that a Shapefile holds"
        yield [*beside, made], [f"{n} texts of {name} are {words}" for name, n in cut.items()]


@contextmanager
def _scratch_beside(file: Path) -> Iterator[Path]:
    """A folder on the file system that the file will be on; elsewhere where that is a device."""
    try:
        parent = None if is_stream(file) else resolved(file).parent
        made = TemporaryDirectory(prefix=f".{file.name}.", suffix=PART, dir=parent)
    except OSError as error:
        raise not_written(file, error, "the file", "name another file") from error
    with made as scratch:
        yield Path(scratch)


@contextmanager
def _dated(pyogrio: ModuleType, when: datetime) -> Iterator[None]:
    """GDAL takes this time for now, so that the same rows give the same bytes."""
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": f"{when:%Y-%m-%dT%H:%M:%S.000Z}"})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})


def _count(batch: pa.RecordBatch, key: str, geometry: str, digest: Any) -> None:
    """Add the rows of a batch to a digest: what names each, and whether it has a place."""
    places = batch.column(geometry).is_valid().to_pylist()
    for name, placed in zip(batch.column(key).to_pylist(), places, strict=True):
        digest.update(f"{name}\0{placed}\n".encode())


def _read_back(pyogrio: ModuleType, made: Path, key: str) -> bytes:
    """The digest of all rows of a file; of those before a fault."""
    found = hashlib.sha256()
    faults = pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, KeyError, OSError
    with warnings.catch_warnings(action="ignore"), suppress(*faults):
        with pyogrio.open_arrow(made, columns=[key], use_pyarrow=True) as (about, batches):
            for batch in batches:
                _count(batch, key, about["geometry_name"] or "wkb_geometry", found)
    return found.digest()


def _schema(rows: PlacedRows, kind: str) -> pa.Schema:
    """One field a column, and the geometry; those of KML begin with name and description."""
    short = short_names(rows.columns)
    fields: list[pa.Field[Any]] = []
    if kind == "kml":
        fields += [pa.field(name, pa.string()) for name in ("Name", "description")]
    for column in rows.columns:
        if kind == "shp":
            kept = pa.string() if _is_text(column) else column.type
            fields.append(pa.field(short[column.name], kept))
        else:
            comment = f"{column.words} [{column.unit}]" if column.unit else column.words
            about = {"GDAL:OGR:comment": comment} if kind == "gpkg" else None
            fields.append(pa.field(column.name, column.type, metadata=about))
    return pa.schema([*fields, pa.field(GEOMETRY, pa.binary())])


def _batch(
    rows: list[Row], columns: tuple[Column, ...], schema: pa.Schema, kind: str, cut: Counter[str]
) -> pa.RecordBatch:
    """Rows in the fields of `_schema`; counts the texts that are cut by their column."""
    points = [row[GEOMETRY] for row in rows]
    arrays: list[list[Any]] = []
    if kind == "kml":
        # Its heights are above the sea, those here above the ellipsoid: signs lie on the ground.
        points = [None if point is None else point[:2] for point in points]
        arrays = [[str(row[columns[0].name]) for row in rows], [_appearance(row) for row in rows]]
    for column in columns:
        values = [row.get(column.name) for row in rows]
        if kind == "shp" and _is_text(column):
            texts = [None if value is None else _text(value) for value in values]
            values = [None if text is None else _cut(text) for text in texts]
            if count := sum(text != value for text, value in zip(texts, values, strict=True)):
                cut[column.name] += count
        arrays.append(values)
    arrays.append([_wkb(point) for point in points])
    filled = [pa.array(v, f.type) for v, f in zip(arrays, schema, strict=True)]
    return pa.record_batch(filled, schema=schema)


def _is_text(column: Column) -> bool:
    """Whether a dBASE file holds a column as text: its numbers have 18 digits, its dates no time of day."""
    kind = column.type
    return pa.types.is_int64(kind) or pa.types.is_timestamp(kind) or pa.types.is_string(kind)


def _text(value: Any) -> str:
    return value.isoformat() if isinstance(value, datetime) else str(value)


def _cut(text: str) -> str:
    """As much of a text as a dBASE file holds, without half a character at its end."""
    return text.encode()[:_LONGEST_TEXT].decode(errors="ignore")


def _wkb(point: Point | None) -> bytes | None:
    if point is None:
        return None
    kind = _WKB_POINT if len(point) == 2 else _WKB_POINT_Z
    return struct.pack(f"<BI{len(point)}d", 1, kind, *point)


def _appearance(row: Row) -> str:
    """What a row shows, in words for a person: the look of a panel, or how many a support holds."""
    if "panel_ids" in row:
        return f"{row['panels']} panels"
    look = [row.get(f"reviewed_{name}") or row.get(name) or "" for name in ("color", "shape")]
    words = " ".join(look).replace("_", " ").strip() or "unknown"
    status, review = row.get("status"), row.get("review")
    return ", ".join([words, *filter(None, (status if status != "sign" else "", review))])
