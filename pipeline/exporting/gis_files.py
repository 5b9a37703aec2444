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

from wayside.pipeline.exporting.flat_table import GEOMETRY, FlatTable, Point, Row
from wayside.pipeline.exporting.place import PlacedRows
from wayside.pipeline.exporting.text_files import plain_value
from wayside.pipeline.exporting.units import short_names
from wayside.pipeline.files.writing import PART, is_stream, not_whole, not_written, resolved
from wayside.schemas.errors import OutputError, UsageError
from wayside.schemas.tables import Column

_DRIVERS = {"gpkg": "GPKG", "shp": "ESRI Shapefile", "kml": "LIBKML"}
_LONGEST_TEXT = 254
"""Bytes of a text in a dBASE file."""
_WKB_POINT, _WKB_POINT_Z = 1, 1001


def load_pyogrio() -> ModuleType:
    """The package that GDAL comes with.

    Raises
    ------
    UsageError
        It is not installed.
    """
    try:
        import pyogrio
    except ImportError as error:
        raise UsageError(
            "files of geographic information systems need the package pyogrio. Install it with pip install "
            "'wayside[gis]'."
        ) from error
    return pyogrio  # type: ignore[no-any-return]


@contextmanager
def made_files(rows: PlacedRows, kind: str, file: Path) -> Iterator[tuple[list[Path], list[str]]]:
    """The files of a table in a scratch folder, which goes with the block, the main one last; and what was cut.

    GDAL says nothing where a Shapefile or KML finds no room, so that all rows are read back. Where a format wants the
    time of its writing, it gets the latest of the rows, so that the same rows give the same bytes.

    Parameters
    ----------
    rows
        Read once, while the file is written.
    kind
        `gpkg`, `shp` or `kml`.
    file
        Where they will go; the scratch folder lies beside it. A Shapefile has no other name than its for the layer.

    Raises
    ------
    UsageError
        pyogrio is not installed.
    OutputError
        They cannot be written, or are not whole.
    """
    pyogrio = load_pyogrio()
    source = rows.source
    cut: Counter[str] = Counter()
    schema = _schema(rows.columns, kind)
    key = short_names(rows.columns)[source.key] if kind == "shp" else source.key
    written = hashlib.sha256()

    def batches() -> Iterator[pa.RecordBatch]:
        for table in rows:
            batch = _batch(table, source.key, schema, kind, cut)
            _count(batch, key, GEOMETRY, written)
            yield batch

    with _scratch_beside(file) as scratch:
        made = scratch / f"{file.stem}.{kind}"
        try:
            with _dated(pyogrio, source.last):
                pyogrio.write_arrow(
                    pa.RecordBatchReader.from_batches(schema, batches()),
                    made,
                    layer=file.stem if kind == "shp" else source.table,
                    driver=_DRIVERS[kind],
                    geometry_name=GEOMETRY,
                    geometry_type="Point" if kind == "kml" else "Point Z",
                    crs=rows.crs,
                    **_options(kind, source.last),
                )
        except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
            raise OutputError(
                f"{file}: GDAL could not write it: {error}; free some space, or name another file"
            ) from error
        if _read_back(pyogrio, made, key) != written.digest():
            raise not_whole(file)
        beside = sorted(path for path in scratch.iterdir() if path != made)
        words = f"cut to the {_LONGEST_TEXT} bytes that a Shapefile holds"
        yield [*beside, made], [f"{n} texts of {name} are {words}" for name, n in cut.items()]


def _options(kind: str, last: datetime) -> dict[str, str]:
    if kind == "gpkg":  # GDAL before 3.7, that of QGIS 3.22 too, warns of later versions
        return {"VERSION": "1.2"}
    if kind == "shp":
        return {"ENCODING": "UTF-8", "DBF_DATE_LAST_UPDATE": f"{last:%Y-%m-%d}"}
    return {}


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


def _schema(columns: tuple[Column, ...], kind: str) -> pa.Schema:
    """One field a column, and the geometry; those of KML begin with name and description."""
    short = short_names(columns)
    fields: list[pa.Field[Any]] = []
    if kind == "kml":
        fields += [pa.field(name, pa.string()) for name in ("Name", "description")]
    for column in columns:
        if kind == "shp":
            kept = pa.string() if _is_text(column) else column.type
            fields.append(pa.field(short[column.name], kept))
        else:
            comment = f"{column.words} [{column.unit}]" if column.unit else column.words
            about = {"GDAL:OGR:comment": comment} if kind == "gpkg" else None
            fields.append(pa.field(column.name, column.type, metadata=about))
    return pa.schema([*fields, pa.field(GEOMETRY, pa.binary())])


def _batch(
    table: FlatTable, key: str, schema: pa.Schema, kind: str, cut: Counter[str]
) -> pa.RecordBatch:
    """Rows in the fields of `_schema`; counts the texts that are cut by their column."""
    rows = table.rows
    points = [row[GEOMETRY] for row in rows]
    arrays: list[list[Any]] = []
    if (
        kind == "kml"
    ):  # its heights are above the sea, those here above the ellipsoid: on the ground
        points = [None if point is None else point[:2] for point in points]
        arrays += [[str(row[key]) for row in rows], [_appearance(row) for row in rows]]
    for column in table.columns:
        values = [row.get(column.name) for row in rows]
        if kind == "shp" and _is_text(column):
            texts = [None if v is None else str(plain_value(v)) for v in values]
            values = [None if text is None else _cut(text) for text in texts]
            if count := sum(text != value for text, value in zip(texts, values, strict=True)):
                cut[column.name] += count
        arrays.append(values)
    arrays.append([_wkb(point) for point in points])
    return pa.record_batch(
        [pa.array(v, f.type) for v, f in zip(arrays, schema, strict=True)], schema=schema
    )


def _is_text(column: Column) -> bool:
    """Whether a dBASE file holds a column as text: its numbers have 18 digits, its dates no time of day."""
    kind = column.type
    return pa.types.is_int64(kind) or pa.types.is_timestamp(kind) or pa.types.is_string(kind)


def _wkb(point: Point | None) -> bytes | None:
    if point is None:
        return None
    kind = _WKB_POINT if len(point) == 2 else _WKB_POINT_Z
    return struct.pack(f"<BI{len(point)}d", 1, kind, *point)


def _appearance(row: Row) -> str:
    """What a row shows, in words for a person: the look of a panel, or how many a support holds."""
    if "panel_ids" in row:
        return f"{row['panels']} panels"
    color, shape = (
        row.get(f"reviewed_{name}") or row.get(name) or "" for name in ("color", "shape")
    )
    words = f"{color} {shape}".replace("_", " ").strip() or "unknown"
    status, review = row.get("status"), row.get("review")
    return ", ".join([words, *filter(None, (status if status != "sign" else "", review))])


def _cut(text: str) -> str:
    """As much of a text as a dBASE file holds, without half a character at its end."""
    return text.encode()[:_LONGEST_TEXT].decode(errors="ignore")


@contextmanager
def _dated(pyogrio: ModuleType, when: datetime) -> Iterator[None]:
    """GDAL takes this time for now."""
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": f"{when:%Y-%m-%dT%H:%M:%S.000Z}"})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
