"""The table as GeoPackage, Shapefile and KML, written by GDAL."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import pyarrow as pa

from wayside.pipeline.exporting.flat_table import FlatTable
from wayside.pipeline.exporting.place import Placement
from wayside.pipeline.exporting.units import short_names
from wayside.schemas.errors import UsageError

LAYER = "signs"
_GEOMETRY = "geometry"
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
            "wanted the package pyogrio for files of geographic information systems, found none; "
            "install it with pip install 'wayside[gis]'"
        ) from error
    return pyogrio  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class GisFile:
    """The bytes of a file and of those beside it, by suffix; notes: in words, what the format has no room for."""

    content: bytes
    beside: dict[str, bytes]
    notes: tuple[str, ...]


def format_gis(table: FlatTable, placement: Placement, kind: str, stem: str) -> GisFile:
    """The table as a file of a geographic information system.

    The same table gives the same bytes: where a format wants the time of its writing, it gets that of the drive.

    Parameters
    ----------
    table, placement
        The rows and where they lie.
    kind
        `gpkg`, `shp` or `kml`.
    stem
        Of the file's name; a Shapefile has no other name for its layer.

    Raises
    ------
    UsageError
        pyogrio is not installed.
    """
    pyogrio = load_pyogrio()
    points = placement.points
    geometry_type = "Point Z"
    options: dict[str, str] = {}
    if (
        kind == "kml"
    ):  # its heights are above the sea, those here above the ellipsoid: on the ground
        points = tuple(None if point is None else point[:2] for point in points)
        geometry_type = "Point"
    when = _time_of(table)
    if kind == "shp":
        options = {"ENCODING": "UTF-8", "DBF_DATE_LAST_UPDATE": f"{when:%Y-%m-%d}"}
    with TemporaryDirectory(prefix="wayside-") as scratch, _dated(pyogrio, when):
        file = Path(scratch) / f"{stem}.{kind}"
        pyogrio.write_arrow(
            _arrow(table, points, kind),
            file,
            layer=stem if kind == "shp" else LAYER,
            driver=_DRIVERS[kind],
            geometry_name=_GEOMETRY,
            geometry_type=geometry_type,
            crs=placement.crs,
            **options,
        )
        written = {part.suffix: part.read_bytes() for part in sorted(Path(scratch).iterdir())}
    main = written.pop(file.suffix)
    return GisFile(main, written, tuple(_cut_texts(table)) if kind == "shp" else ())


def _arrow(table: FlatTable, points: tuple[tuple[float, ...] | None, ...], kind: str) -> pa.Table:
    short = short_names(table.columns)
    fields: list[pa.Field[Any]] = []
    arrays: list[pa.Array[Any]] = []
    if kind == "kml":
        fields += [pa.field(name, pa.string()) for name in ("Name", "description")]
        arrays += [pa.array([str(row["sign_id"]) for row in table.rows], pa.string())]
        arrays += [pa.array([_appearance(row) for row in table.rows], pa.string())]
    for column in table.columns:
        values = [row.get(column.name) for row in table.rows]
        if kind == "shp":  # its numbers have 18 digits, times in nanoseconds have 19
            text = pa.types.is_int64(column.type) or pa.types.is_string(column.type)
            values = [v if v is None else _cut(str(v)) if text else v for v in values]
            fields.append(pa.field(short[column.name], pa.string() if text else column.type))
        else:
            comment = f"{column.words} [{column.unit}]" if column.unit else column.words
            about = {"GDAL:OGR:comment": comment} if kind == "gpkg" else None
            fields.append(pa.field(column.name, column.type, metadata=about))
        arrays.append(pa.array(values, fields[-1].type))
    fields.append(pa.field(_GEOMETRY, pa.binary()))
    arrays.append(pa.array([_wkb(point) for point in points], pa.binary()))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def _wkb(point: tuple[float, ...] | None) -> bytes | None:
    if point is None:
        return None
    kind = _WKB_POINT if len(point) == 2 else _WKB_POINT_Z
    return struct.pack(f"<BI{len(point)}d", 1, kind, *point)


def _appearance(row: dict[str, Any]) -> str:
    color, shape = (
        row.get(f"reviewed_{name}") or row.get(name) or "" for name in ("color", "shape")
    )
    words = f"{color} {shape}".replace("_", " ").strip() or "unknown"
    status, review = row.get("status"), row.get("review")
    return ", ".join([words, *filter(None, (status if status != "sign" else "", review))])


def _cut(text: str) -> str:
    """As much of a text as a dBASE file holds, without half a character at its end."""
    return text.encode()[:_LONGEST_TEXT].decode(errors="ignore")


def _cut_texts(table: FlatTable) -> Iterator[str]:
    for column in table.columns:
        if pa.types.is_string(column.type):
            texts = [str(row.get(column.name) or "").encode() for row in table.rows]
            if count := sum(len(text) > _LONGEST_TEXT for text in texts):
                yield f"{count} texts of {column.name} are cut to the {_LONGEST_TEXT} bytes that a Shapefile holds"


def _time_of(table: FlatTable) -> datetime:
    """The last time of the drive that a row names."""
    times = [row["best_time_ns"] for row in table.rows if row.get("best_time_ns") is not None]
    return datetime.fromtimestamp(max(times, default=0) // 10**9, UTC)


@contextmanager
def _dated(pyogrio: ModuleType, when: datetime) -> Iterator[None]:
    """GDAL takes this time for now."""
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": f"{when:%Y-%m-%dT%H:%M:%S.000Z}"})
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
