"""`wayside export`: the signs of a result as one file for another program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wayside.pipeline.exporting.flat_table import flat_table
from wayside.pipeline.exporting.gis_files import format_gis
from wayside.pipeline.exporting.place import place_rows, project, with_coordinates
from wayside.pipeline.exporting.text_files import format_csv, format_geojson
from wayside.pipeline.exporting.units import in_feet_and_inches
from wayside.pipeline.reviewing.review import Review
from wayside.pipeline.writing import refuse, whole_file, write_file
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
    units: str = "metric",
    crs: str | None = None,
    log: Path | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write the signs of a result to a file.

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    review
        What is said of its rows; a missing sign is a row of its own.
    file, kind
        Where it goes, and a key of `FORMATS`. A Shapefile is several files of one stem.
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
        The format does not go with units, reference system, or a result that has no place on the globe; or its
        package is not installed.
    InputError
        The folder is no result folder, or damaged; the log cannot be read.
    OutputError
        A file cannot be written, or another stands there.
    """
    if crs is not None and kind in (*_ALWAYS_WGS_84, "mcap"):
        always = (
            "lies in the frames of the drive" if kind == "mcap" else "is WGS 84 by its standard"
        )
        raise UsageError(
            f"--crs {crs}: wanted csv, gpkg or shp, found {kind}, which {always}; leave --crs out or choose another -f"
        )
    if units != UNITS[0] and kind == "mcap":
        raise UsageError(
            f"--units {units}: wanted another format, found mcap, whose schemas are in metres; leave --units out"
        )
    table = flat_table(out, review)
    if kind == "mcap":
        from wayside.pipeline.exporting.foxglove_log import write_foxglove_log

        with whole_file(file, overwrite=overwrite) as stream:
            notes = write_foxglove_log(out, table, log, stream)
        return Exported(len(table.rows), (file,), tuple(notes))
    placement = place_rows(out, table)
    if kind in _ALWAYS_WGS_84 and not placement.on_globe:
        raise UsageError(
            f"{out}: wanted signs on the globe for {FORMATS[kind]}, found none with longitude and latitude: the log "
            "has no satellite fixes; export CSV, gpkg or shp, whose x and y are relative to the drive"
        )
    if crs is not None:
        placement = project(out, placement, crs)
        table = with_coordinates(table, placement, crs)
    if units == "us":
        table = in_feet_and_inches(table)
    if kind == "csv":
        write_file(file, format_csv(table).encode(), overwrite=overwrite)
        return Exported(len(table.rows), (file,), placement.notes if crs is not None else ())
    if kind == "geojson":
        write_file(file, format_geojson(table, placement).encode(), overwrite=overwrite)
        return Exported(len(table.rows), (file,), placement.notes)
    made = format_gis(table, placement, kind, file.stem)
    parts = {file.with_suffix(suffix): content for suffix, content in made.beside.items()}
    _write_together(parts | {file: made.content}, overwrite=overwrite)
    return Exported(len(table.rows), (*parts, file), (*placement.notes, *made.notes))


def _write_together(files: dict[Path, bytes], *, overwrite: bool) -> None:
    """Write files that belong together; none where one of them would replace something else."""
    for path, content in files.items():
        if not overwrite and path.is_file() and path.read_bytes() != content:
            raise refuse(path, "another file of that name")
    for path, content in files.items():
        write_file(path, content, overwrite=overwrite)
