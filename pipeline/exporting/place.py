"""Where the rows of a table lie: on the globe, in a projection of it, or in the drive's own frame."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyproj
from pyproj.exceptions import CRSError

from wayside.pipeline.exporting.flat_table import FlatTable, Row
from wayside.pipeline.result import read_run
from wayside.schemas.errors import UsageError
from wayside.schemas.tables import Column

WGS_84 = "EPSG:4326"
_WORLDS = {
    "drive_start": "x forward and y left of the first image",
    "log": "of the poses of the log",
}


@dataclass(frozen=True, slots=True)
class Placement:
    """A point for each row: x, y, or x, y and height, in the axes of `crs`; None where a row has no place.

    crs: as GDAL reads it; on_globe: whether points are longitude and latitude of WGS 84; notes: in words, what must be
    known to trust the points.
    """

    crs: str
    points: tuple[tuple[float, ...] | None, ...]
    on_globe: bool = False
    notes: tuple[str, ...] = ()


def place_rows(out: Path, table: FlatTable) -> Placement:
    """Longitude, latitude and ellipsoidal height of each row; without fixes x, y, z of the world frame, in metres."""
    globe = [_point(row, ("lon_deg", "lat_deg", "alt_m")) for row in table.rows]
    if not table.rows or any(point is not None for point in globe):
        return Placement(WGS_84, tuple(globe), True, tuple(_unplaced(globe)))
    world = str(read_run(out).get("world") or "drive_start")
    name = f"wayside {world}: {_WORLDS.get(world, 'local')}"
    crs = (
        f'ENGCRS["{name}",EDATUM["{world}"],CS[Cartesian,2],AXIS["x",unspecified],'
        'AXIS["y",unspecified],LENGTHUNIT["metre",1]]'
    )
    note = "the log has no fixes: geometry is x, y, z of the drive's own frame, in metres"
    return Placement(crs, tuple(_point(row, ("x", "y", "z")) for row in table.rows), notes=(note,))


def project(out: Path, placement: Placement, wanted: str) -> Placement:
    """The same points in another coordinate reference system; heights stay metres above the WGS 84 ellipsoid.

    Parameters
    ----------
    out
        Folder of the result, for messages.
    placement
        On the globe.
    wanted
        What PROJ understands: `EPSG:26914`, a PROJ string, WKT.

    Raises
    ------
    UsageError
        It is no such system or one with a height of its own, the result has no place on the globe, or the points have
        none in that system.
    """
    crs = _horizontal(wanted)
    if not placement.on_globe:
        raise UsageError(
            f"{out}: wanted signs on the globe for --crs {wanted}, found none with longitude and latitude: the log "
            "has no satellite fixes; leave --crs out for x, y of the drive"
        )
    to_crs = pyproj.Transformer.from_crs(WGS_84, crs, always_xy=True)
    points: list[tuple[float, ...] | None] = []
    for point in placement.points:
        points.append(
            None if point is None else (*to_crs.transform(point[0], point[1]), *point[2:])
        )
    if any(point is not None and not all(map(math.isfinite, point[:2])) for point in points):
        raise UsageError(
            f"--crs {wanted}: wanted a system that holds all signs, found that {crs.name} does not; "
            f"it is made for {_area(crs)}"
        )
    notes = [*placement.notes, *_operation(crs, to_crs, points), *_outside(crs, placement)]
    return replace(
        placement, crs=crs.to_wkt(), points=tuple(points), on_globe=False, notes=tuple(notes)
    )


def with_coordinates(table: FlatTable, placement: Placement, wanted: str) -> FlatTable:
    """The table with the projected coordinates as columns `crs`, `crs_x`, `crs_y`."""
    crs = _horizontal(wanted)
    name = ":".join(crs.to_authority() or (crs.name,))
    units = [axis.unit_name for axis in crs.axis_info]
    columns = (
        Column("crs", pa.string(), "", "coordinate reference system of `crs_x`, `crs_y`"),
        Column("crs_x", pa.float64(), units[0], f"easting or longitude, {crs.name}"),
        Column("crs_y", pa.float64(), units[-1], f"northing or latitude, {crs.name}"),
    )
    rows = tuple(
        row if point is None else row | {"crs": name, "crs_x": point[0], "crs_y": point[1]}
        for row, point in zip(table.rows, placement.points, strict=True)
    )
    return FlatTable((*table.columns, *columns), rows)


def _point(row: Row, names: tuple[str, str, str]) -> tuple[float, ...] | None:
    known = [row[name] for name in names if row.get(name) is not None]
    return tuple(known) if len(known) >= 2 else None


def _unplaced(points: list[tuple[float, ...] | None]) -> Iterator[str]:
    if count := points.count(None):
        yield f"{count} rows have no place on the globe: they have no geometry"


def _horizontal(wanted: str) -> pyproj.CRS:
    try:
        crs = pyproj.CRS.from_user_input(wanted)
    except CRSError as error:
        raise UsageError(
            f"--crs: wanted a coordinate reference system such as EPSG:26914, found {wanted!r}, which PROJ does not "
            "know; https://epsg.org lists them"
        ) from error
    crs = crs.to_2d()
    if not (crs.is_projected or crs.is_geographic) or len(crs.axis_info) != 2:
        raise UsageError(
            f"--crs {wanted}: wanted a projected or geographic system, found {crs.type_name} ({crs.name}); heights "
            "stay metres above the WGS 84 ellipsoid, so name its horizontal part"
        )
    return crs


def _operation(
    crs: pyproj.CRS, transformer: pyproj.Transformer, points: list[tuple[float, ...] | None]
) -> Iterator[str]:
    """What PROJ did and how exact that is; a datum that moves with its continent is metres from WGS 84."""
    if all(point is None for point in points):
        return
    used = transformer.get_last_used_operation()
    known = used.accuracy >= 0
    accuracy = f"accuracy {used.accuracy:g} m" if known else "accuracy unknown"
    yield f"coordinates in {crs.name} by {used.description} ({accuracy})"


def _outside(crs: pyproj.CRS, placement: Placement) -> Iterator[str]:
    area = crs.area_of_use
    if area is None:
        return
    count = sum(
        not _within(point, area.west, area.east, area.south, area.north)
        for point in placement.points
        if point is not None
    )
    if count:
        yield f"{count} signs lie outside of the area that {crs.name} is made for: {_area(crs)}"


def _within(point: tuple[float, ...], west: float, east: float, south: float, north: float) -> bool:
    lon, lat = point[:2]
    across = west <= lon <= east if west <= east else lon >= west or lon <= east
    return across and south <= lat <= north


def _area(crs: pyproj.CRS) -> str:
    return "an area that it does not state" if crs.area_of_use is None else crs.area_of_use.name
