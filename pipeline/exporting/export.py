"""`wayside export`: the signs of a result, or of an inventory, as one file for another program."""

from __future__ import annotations

import filecmp
import os
import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from wayside.pipeline.exporting.flat_table import FlatTable, flat_table
from wayside.pipeline.exporting.gis_files import made_files
from wayside.pipeline.exporting.place import PlacedRows
from wayside.pipeline.exporting.sources import (
    INVENTORY_TABLES,
    drive_signs,
    inventory_rows,
    is_inventory,
)
from wayside.pipeline.exporting.text_files import count_rows, write_csv, write_geojson
from wayside.pipeline.files.writing import is_stream, not_whole, refuse, whole_file
from wayside.pipeline.reviewing.review import Review
from wayside.schemas.errors import UsageError

FORMATS = {
    "csv": "table of text",
    "geojson": "GeoJSON (RFC 7946)",
    "gpkg": "GeoPackage",
    "shp": "Shapefile",
    "kml": "KML",
    "mcap": "log for Foxglove",
}
"""What can be written, by the end of the file's name."""
UNITS = ("metric", "us")
_ALWAYS_WGS_84 = ("geojson", "kml")


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written: rows, the files, the main one last, and what must be known to use them, in words."""

    rows: int
    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


def export(
    out: Path,
    review: Review,
    file: Path,
    kind: str,
    *,
    table: str | None = None,
    units: str = "metric",
    crs: str | None = None,
    log: Path | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write the signs of a result, or a table of an inventory, to a file.

    An inventory is read and written area by area, so that memory does not grow with it; only KML is made as a whole, by
    GDAL.

    Parameters
    ----------
    out
        Folder written by `wayside run`, or by `wayside fleet`.
    review
        What is said of the rows of a result; a missing sign is a row of its own. An inventory has no reviews.
    file, kind
        Where it goes, and a key of `FORMATS`. A Shapefile is several files of one stem.
    table
        Of an inventory: one of `INVENTORY_TABLES`; None: the panels.
    units
        One of `UNITS`: as measured, or feet and inches.
    crs
        Coordinate reference system of the geometry, as PROJ reads it; None: WGS 84, or the drive's own frame where
        there are no fixes.
    log
        For `mcap`: where the drive's log lies now; None: where it lay at the time of the run.
    overwrite
        Replace files that stand there.

    Raises
    ------
    UsageError
        The format does not go with units, reference system, an inventory, or a result that has no place on the globe;
        a table is named where there is none; or the package of the format is not installed.
    InputError
        The folder is no result folder and no inventory, or damaged; the log cannot be read.
    OutputError
        A file cannot be written, or another stands there.
    """
    inventory = is_inventory(out)
    _require_fitting(kind, crs, units)
    _require_table(out, kind, table, inventory=inventory)
    if kind == "mcap":
        return _write_log(out, flat_table(out, review), log, file, overwrite=overwrite)
    if inventory:
        source = inventory_rows(out, table or next(iter(INVENTORY_TABLES)))
    else:
        source = drive_signs(out, review)
    if kind in _ALWAYS_WGS_84 and source.world is not None:
        raise UsageError(
            f"{out}: {FORMATS[kind]} needs longitude and latitude, but the log has no satellite fixes. Export CSV, "
            "gpkg or shp, whose x and y are relative to the drive."
        )
    rows = PlacedRows(source, crs, imperial=units != UNITS[0])
    write = _write_text if kind in ("csv", "geojson") else _write_gis
    files, cut = write(rows, kind, file, overwrite=overwrite)
    told = kind != "csv" or crs is not None
    return Exported(rows.count, files, (*(rows.notes() if told else ()), *cut))


def _write_log(
    out: Path, signs: FlatTable, log: Path | None, file: Path, *, overwrite: bool
) -> Exported:
    from wayside.pipeline.exporting.foxglove_log import require_whole_log, write_foxglove_log

    with whole_file(file, overwrite=overwrite, read_back=require_whole_log) as stream:
        notes = write_foxglove_log(out, signs, log, stream)
    return Exported(len(signs.rows), (file,), tuple(notes))


def _write_text(
    rows: PlacedRows, kind: str, file: Path, *, overwrite: bool
) -> tuple[tuple[Path, ...], list[str]]:
    """Write CSV or GeoJSON; the file."""

    def read_back(made: Path) -> None:
        if count_rows(made, kind) != rows.count:
            raise not_whole(file)

    write = write_csv if kind == "csv" else write_geojson
    with whole_file(file, overwrite=overwrite, read_back=read_back) as stream:
        write(rows.columns, rows, stream)
    return (file,), []


def _write_gis(
    rows: PlacedRows, kind: str, file: Path, *, overwrite: bool
) -> tuple[tuple[Path, ...], list[str]]:
    """Write what GDAL writes; the files, and what was cut, in words."""
    with made_files(rows, kind, file) as (made, cut):
        targets = [file.with_suffix(path.suffix) for path in made[:-1]] + [file]
        _write_together(made, targets, overwrite=overwrite)
    return tuple(targets), cut


def _require_fitting(kind: str, crs: str | None, units: str) -> None:
    """Refuse a reference system or units that a format has not."""
    if crs is not None and kind in (*_ALWAYS_WGS_84, "mcap"):
        always = "uses the frames of the drive" if kind == "mcap" else "is WGS 84 by its standard"
        raise UsageError(
            f"--crs {crs}: the format {kind} {always}. Leave --crs out, or choose csv, gpkg or shp with -f."
        )
    if units != UNITS[0] and kind == "mcap":
        raise UsageError(
            f"--units {units}: the schemas of mcap are in metres. Leave --units out, or choose another format."
        )


def _require_table(out: Path, kind: str, table: str | None, *, inventory: bool) -> None:
    """Refuse what only the result of a drive, or only an inventory, has."""
    if table is not None and not inventory:
        raise UsageError(
            f"--table {table}: only an inventory of `wayside fleet` has tables to choose from, but {out} is the "
            "result of one drive. Leave --table out."
        )
    if kind == "mcap" and inventory:
        raise UsageError(
            f"{out}: -f mcap takes the result of one drive, not an inventory. Name a folder in {out / 'drives'}."
        )


def _write_together(made: list[Path], targets: list[Path], *, overwrite: bool) -> None:
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
