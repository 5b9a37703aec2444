"""`wayside export`: the signs of a result, or of an inventory, as one file for another program."""

import csv
import filecmp
import json
import math
import os
import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from io import TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO

from wayside.pipeline.exporting.gis_files import made_files
from wayside.pipeline.exporting.links import linked
from wayside.pipeline.exporting.place import PlacedRows
from wayside.pipeline.exporting.table import (
    GEOMETRY,
    INVENTORY_TABLES,
    drive_roadside,
    drive_signs,
    inventory_rows,
    is_inventory,
)
from wayside.pipeline.files.parsing import guarded
from wayside.pipeline.files.writing import is_stream, refuse, whole_file
from wayside.pipeline.reviewing.matching import Review
from wayside.schemas.errors import UsageError
from wayside.schemas.settings import RouteSettings
from wayside.schemas.tables import POSTS, PROFILE

FORMATS = {
    "csv": "table of text",
    "xlsx": "workbook",
    "geojson": "GeoJSON (RFC 7946)",
    "gpkg": "GeoPackage",
    "fgb": "FlatGeobuf",
    "shp": "Shapefile",
    "kml": "KML",
    "kmz": "KML in an archive with its pictures",
    "mcap": "log for Foxglove",
}
"""What can be written, by the end of the file's name."""
_ALWAYS_WGS_84 = ("geojson", "kml", "kmz")
_WITH_PICTURES = ("gpkg", "kmz")


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    rows: int
    files: tuple[Path, ...]
    """The main one last."""
    notes: tuple[str, ...] = ()
    """What must be known to use them."""


def export(  # noqa: PLR0913 - one for each option
    out: Path,
    review: Review,
    file: Path,
    kind: str,
    *,
    table: str | None = None,
    units: str = "metric",
    crs: str | None = None,
    log: Path | None = None,
    every: bool = False,
    pictures: bool = False,
    accepted: bool = False,
    route: RouteSettings | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write the signs of a result, or a table of an inventory, to a file.

    `out`: folder written by `wayside run` or `wayside fleet`. `review`: of the rows of a result. `kind`: a key of
    `FORMATS`; a Shapefile is several files of one stem. `table`: of an inventory one of `INVENTORY_TABLES` (None: the
    panels), of a drive `profile` or `posts` (None: the signs). `units`: `metric`, or `us`: feet and inches. `crs`:
    reference system as PROJ reads it; None: WGS 84, or the drive's own frame without fixes. `log`: for `mcap` and
    pictures, where the drive's log lies now; None: where it lay at the time of the run. `every`: all columns, not only
    the main ones. `pictures`: for `gpkg` and `kmz`, the best image of each sign. `accepted`: without the rows that the
    review of a drive rejects. `route`: of the signs of a drive, instead of that of the run.

    Raises UsageError if options do not go together, or the format's package is not installed. Raises InputError if the
    folder is neither a result nor an inventory, or is damaged, or the log cannot be read. Raises OutputError if a file
    cannot be written, or another file has its name.
    """
    inventory, imperial = is_inventory(out), units != "metric"
    _require_fitting(out, kind, crs, table, units, routed=route is not None)
    if pictures and kind not in _WITH_PICTURES:
        raise UsageError(
            f"--pictures: {FORMATS[kind]} holds none. Choose {' or '.join(_WITH_PICTURES)} with -f."
        )
    if inventory:
        source = inventory_rows(out, table or next(iter(INVENTORY_TABLES)))
    elif table is not None:
        source = drive_roadside(out, table)
    else:
        source = drive_signs(out, review, route, accepted=accepted)
    if kind == "mcap":
        from wayside.pipeline.exporting.foxglove_log import write_foxglove_log

        (signs,) = source.chunks()
        with whole_file(file, overwrite=overwrite) as stream:
            notes = write_foxglove_log(out, signs, log, stream)
        return Exported(len(signs), (file,), tuple(notes))
    if kind in _ALWAYS_WGS_84 and source.world is not None:
        raise UsageError(
            f"{out}: {FORMATS[kind]} needs longitude and latitude, but the log has no satellite fixes. Export CSV, "
            "gpkg or shp, whose x and y are relative to the drive."
        )
    source = linked(source, file, pictures=pictures, log=log)
    rows = PlacedRows(source, crs, imperial=imperial, every=every)
    files: tuple[Path, ...] = (file,)
    cut: list[str] = []
    if kind in _WRITERS:
        with whole_file(file, overwrite=overwrite) as stream:
            _WRITERS[kind](rows, stream)
    else:
        with made_files(rows, kind, file) as (made, cut):
            files = (*(file.with_suffix(path.suffix) for path in made[:-1]), file)
            _copy_together(made, files, overwrite=overwrite)
    notes = list(rows.notes()) if kind != "csv" or crs is not None else []
    return Exported(rows.count, files, (*source.notes, *notes, *cut))


def _require_fitting(
    out: Path, kind: str, crs: str | None, table: str | None, units: str, *, routed: bool
) -> None:
    inventory = is_inventory(out)
    if crs is not None and kind in (*_ALWAYS_WGS_84, "mcap"):
        always = "uses the frames of the drive" if kind == "mcap" else "is WGS 84 by its standard"
        raise UsageError(
            f"--crs {crs}: the format {kind} {always}. Leave --crs out, or choose csv, gpkg or shp with -f."
        )
    if units != "metric" and kind == "mcap":
        raise UsageError(
            "--units us: the schemas of mcap are in metres. Leave --units out, or choose another format."
        )
    if routed and (inventory or table is not None):
        raise UsageError(
            "--route: only the signs of one drive are measured again. Leave --route and --milepost out."
        )
    known = (*INVENTORY_TABLES,) if inventory else (POSTS.name, PROFILE.name)
    if table is not None and (table not in known or kind == "mcap"):
        raise UsageError(
            f"--table {table}: {out} is {'an inventory' if inventory else 'the result of one drive'}, of which "
            f"{' and '.join(known)} can be chosen, in all formats but mcap. Leave --table out."
        )
    if kind == "mcap" and inventory:
        raise UsageError(
            f"{out}: -f mcap takes the result of one drive, not an inventory. Name a folder in {out / 'drives'}."
        )


def write_csv(rows: PlacedRows, stream: BinaryIO) -> None:
    """Names first; unknown values are empty, times are ISO 8601, UTC, and no text is a formula."""
    text = TextIOWrapper(stream, "utf-8", newline="")
    names = [column.name for column in rows.columns]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for some in rows:
        cells = ([_single(row.get(name)) for name in names] for row in some)
        writer.writerows([guarded(v) if isinstance(v, str) else v for v in row] for row in cells)
    text.detach()


def write_geojson(rows: PlacedRows, stream: BinaryIO) -> None:
    """RFC 7946, a feature a line: WGS 84, longitude before latitude; the height is that above the ellipsoid."""
    names = [column.name for column in rows.columns]
    stream.write(b'{"type": "FeatureCollection", "features": [')
    between = "\n"
    for some in rows:
        for row in some:
            point = row[GEOMETRY]
            geometry = None if point is None else {"type": "Point", "coordinates": point}
            values = {name: _single(row.get(name)) for name in names}
            feature = {"type": "Feature", "geometry": geometry, "properties": values}
            stream.write((between + json.dumps(feature)).encode())
            between = ",\n"
    stream.write(b"\n]}\n")


def _single(value: Any) -> Any:
    """A value as text and JSON have it."""
    if isinstance(value, datetime):
        return value.isoformat()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _copy_together(made: list[Path], targets: tuple[Path, ...], *, overwrite: bool) -> None:
    """Copy files that belong together; none where one of them would replace something else or has no room."""
    for path, target in zip(made, targets, strict=True):
        if not overwrite and target.is_file() and not filecmp.cmp(path, target, shallow=False):
            raise refuse(target, "another file")
    with ExitStack() as opened:  # each takes its place at the end, when all are on the disk
        for path, target in zip(made, targets, strict=True):
            source = opened.enter_context(path.open("rb"))
            stream = opened.enter_context(whole_file(target, overwrite=overwrite))
            shutil.copyfileobj(source, stream)
            stream.flush()
            if not is_stream(target):
                os.fsync(stream.fileno())


_WRITERS = {"csv": write_csv, "geojson": write_geojson}
"""Formats that need no other package."""
