"""Rows as GeoPackage, Shapefile and KML, written by GDAL as they come."""

import hashlib
import struct
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial
from html import escape
from operator import methodcaller
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any
from urllib.parse import quote
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import pyarrow as pa

from wayside.pipeline.code_words import code_of
from wayside.pipeline.exporting.links import PICTURE
from wayside.pipeline.exporting.place import PlacedRows, short_names
from wayside.pipeline.exporting.table import GEOMETRY, Row
from wayside.pipeline.files.parsing import guarded
from wayside.pipeline.files.writing import PART, is_stream, not_written, resolved
from wayside.schemas.errors import OutputError, UsageError

_DRIVERS = {
    **{"gpkg": "GPKG", "fgb": "FlatGeobuf", "shp": "ESRI Shapefile", "xlsx": "XLSX"},
    **{"kml": "LIBKML", "kmz": "LIBKML"},
}
_LONGEST_TEXT = 254
"""Bytes of a text in a dBASE file."""
_TEXT_IN_DBASE = pa.types.is_int64, pa.types.is_timestamp, pa.types.is_string
"""What a dBASE file holds as text: its numbers have 18 digits, its dates no time of day."""
_WKB_POINT, _WKB_POINT_Z = 1, 1001


@contextmanager
def made_files(rows: PlacedRows, kind: str, file: Path) -> Iterator[tuple[list[Path], list[str]]]:
    """The files of a table in a scratch folder beside `file`, the main one last; and what was cut.

    GDAL says nothing where a Shapefile or KML finds no room, so that all rows are read back. Raises UsageError without
    pyogrio, and OutputError where they cannot be written, or are not whole.
    """
    try:
        import pyogrio
    except ImportError as error:
        raise UsageError(
            "files of geographic information systems need the package pyogrio. Install it with pip install "
            "'wayside[gis]'."
        ) from error
    last, cut, written, pictures = rows.source.last, Counter[str](), 0, dict[str, bytes]()
    fields = list(_fields(rows, kind, cut))
    schema = pa.schema([field for field, _ in fields])
    key = schema.names[0]

    def batches() -> Iterator[pa.RecordBatch]:
        nonlocal written, pictures
        for some in rows:
            if kind == "fgb":  # its index takes no row without a place
                some = [row for row in some if row[GEOMETRY] is not None]
            if kind == "kmz":
                pictures |= {picture_name(row): row[PICTURE] for row in some if row.get(PICTURE)}
            columns = [pa.array([value(row) for row in some], one.type) for one, value in fields]
            batch = pa.record_batch(columns, schema=schema)
            written += _digest(batch, key, GEOMETRY)
            yield batch

    with _scratch_beside(file) as scratch:
        made = scratch / ("doc.kml" if kind == "kmz" else f"{file.stem}.{kind}")
        try:
            with _dated(pyogrio, last):
                pyogrio.write_arrow(
                    pa.RecordBatchReader.from_batches(schema, batches()),
                    made,
                    layer=file.stem if kind == "shp" else rows.source.name,
                    **_options(kind, rows.crs, last),
                )
        except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
            raise OutputError(
                f"{file}: GDAL could not write it: {error}; free some space, or name another file"
            ) from error
        if kind in ("kmz", "xlsx"):
            made = _archived(made, made.with_name(f"{file.stem}.{kind}"), pictures, last)
        if _read_back(pyogrio, made, key) != written:
            raise OutputError(
                f"{file}: not all that was written can be read back, so it is not kept; free some space, or name "
                "another file"
            )
        beside = sorted(path for path in scratch.iterdir() if path != made)
        words = f"cut to the {_LONGEST_TEXT} bytes that a Shapefile holds"
        yield [*beside, made], [f"{n} texts of {name} are {words}" for name, n in cut.items()]


@contextmanager
def _scratch_beside(file: Path) -> Iterator[Path]:
    """A folder on the file system that the file will be on; elsewhere where that is a device."""
    try:
        parent = None if is_stream(file) else resolved(file).parent
        made = TemporaryDirectory(prefix=f".{file.stem}.", suffix=PART, dir=parent)
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


def _archived(made: Path, target: Path, pictures: Mapping[str, bytes], when: datetime) -> Path:
    """A KML file with its pictures, or an archive that GDAL made, as an archive of the same bytes at any hour."""
    parts = {made.name: made.read_bytes(), **pictures}
    if made.suffix == target.suffix:
        with ZipFile(made) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
    made.unlink()
    with ZipFile(target, "w", ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            about = ZipInfo(name, max(when.timetuple()[:6], (1980, 1, 1, 0, 0, 0)))
            archive.writestr(about, content, ZIP_DEFLATED)
    return target


def _digest(batch: pa.RecordBatch, key: str, geometry: str) -> int:
    """A sum over rows in any order: what names each, and whether it has a place; a workbook has no places."""
    named = geometry in batch.schema.names
    places = batch.column(geometry).is_valid() if named else pa.nulls(len(batch))
    rows = zip(batch.column(key).to_pylist(), places.to_pylist(), strict=True)
    return sum(int.from_bytes(hashlib.sha256(f"{a}\0{b}".encode()).digest()) for a, b in rows)


def _read_back(pyogrio: ModuleType, made: Path, key: str) -> int:
    """The digest of all rows of a file; of those before a fault."""
    found = 0
    faults = pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, KeyError, OSError
    with warnings.catch_warnings(action="ignore"), suppress(*faults):
        with pyogrio.open_arrow(made, columns=[key], use_pyarrow=True) as (about, batches):
            for batch in batches:
                found += _digest(batch, key, about["geometry_name"] or "wkb_geometry")
    return found


def _fields(
    rows: PlacedRows, kind: str, cut: Counter[str]
) -> Iterator[tuple["pa.Field[Any]", Callable[[Row], Any]]]:
    """Fields with their value of a row: names first in KML, the geometry last; `cut` counts texts that are cut."""
    if kind in ("kml", "kmz"):
        yield pa.field("Name", pa.string()), lambda row: str(row[rows.columns[0].name])
        yield pa.field("description", pa.string()), partial(_balloon, shown=kind == "kmz")
    short = short_names(rows.columns)
    for column in rows.columns:
        if column.name == PICTURE and kind == "kmz":
            continue
        name, held = column.name, column.type
        value: Callable[[Row], Any] = methodcaller("get", name)
        if kind == "xlsx" and pa.types.is_string(held):
            value = partial(_guarded, column.name)
        elif kind == "shp" and any(is_of(held) for is_of in _TEXT_IN_DBASE):
            held, value = pa.string(), partial(_dbase_text, column.name, cut)
        name = short[name] if kind == "shp" else name
        comment = f"{column.words} [{column.unit}]" if column.unit else column.words
        about = {"GDAL:OGR:comment": comment} if kind == "gpkg" else None
        yield pa.field(name, held, metadata=about), value
    # heights of KML are above the sea, those here above the ellipsoid: its signs lie on the ground
    if kind != "xlsx":
        yield pa.field(GEOMETRY, pa.binary()), partial(_wkb, 2 if kind in ("kml", "kmz") else 3)


def _options(kind: str, crs: str, last: datetime) -> dict[str, str]:
    """What GDAL must know of a format and of the places."""
    shape = "Point" if kind in ("kml", "kmz") else "Point Z"
    places = {"geometry_name": GEOMETRY, "geometry_type": shape, "crs": crs}
    more = {
        "gpkg": {"VERSION": "1.2"},  # GDAL before 3.7, also that of QGIS 3.22, warns of later ones
        "shp": {"ENCODING": "UTF-8", "DBF_DATE_LAST_UPDATE": f"{last:%Y-%m-%d}"},
    }
    return {"driver": _DRIVERS[kind]} | (places if kind != "xlsx" else {}) | more.get(kind, {})


def _guarded(name: str, row: Row) -> str | None:
    """A text that GDAL does not write as a formula."""
    return None if row.get(name) is None else guarded(row[name])


def _dbase_text(name: str, cut: Counter[str], row: Row) -> str | None:
    """As much of a text as a dBASE file holds, without half a character at its end."""
    value = row.get(name)
    if value is None:
        return None
    text = value.isoformat() if isinstance(value, datetime) else str(value)
    kept = text.encode()[:_LONGEST_TEXT].decode(errors="ignore")
    if kept != text:
        cut[name] += 1
    return kept


def _wkb(most: int, row: Row) -> bytes | None:
    """The place of a row with `most` coordinates."""
    if row[GEOMETRY] is None:
        return None
    point = row[GEOMETRY][:most]
    kind = _WKB_POINT if len(point) == 2 else _WKB_POINT_Z
    return struct.pack(f"<BI{len(point)}d", 1, kind, *point)


def picture_name(row: Row) -> str:
    """Where the picture of a row lies in an archive."""
    return f"images/{(row.get('panel_id') or row['sign_id']).replace('/', '_')}.jpg"


def _balloon(row: Row, *, shown: bool) -> str:
    """What a click shows, in HTML: the look with the picture, or with the sheet, which no archive links to."""
    lines = [escape(_appearance(row))]
    if shown and row.get(PICTURE):
        lines.insert(0, f'<img src="{escape(quote(picture_name(row)))}">')
    if row.get("evidence") and not shown:
        lines.append(f'<a href="{escape(quote(row["evidence"]))}">evidence</a>')
    return "<br>".join(lines)


def _appearance(row: Row) -> str:
    """What a row shows, in words for a person: the look of a panel, or how many a support holds."""
    if "panel_ids" in row:
        return f"{row['panels']} panels"
    look = [row.get(f"final_{name}") or row.get(name) or "" for name in ("color", "shape")]
    words = " ".join(look).replace("_", " ").strip() or "unknown"
    words = " ".join(filter(None, (words, code_of(row))))
    status, review = row.get("status"), row.get("review")
    return ", ".join([words, *filter(None, (status if status != "sign" else "", review))])
