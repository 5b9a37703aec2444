"""Rows as they are written: placed on the globe, in a projection of it, or in the drive's own frame."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pyarrow as pa
import pyproj
from pyproj.exceptions import CRSError, ProjError

from wayside.pipeline.exporting.flat_table import GEOMETRY, FlatTable, Point, Row
from wayside.pipeline.exporting.sources import Source
from wayside.pipeline.exporting.units import in_feet_and_inches
from wayside.schemas.errors import UsageError
from wayside.schemas.tables import Column

WGS_84 = "EPSG:4326"
_GLOBE, _LOCAL = ("lon_deg", "lat_deg", "alt_m"), ("x", "y", "z")
_WORLDS = {
    "drive_start": "x forward and y left of the first image",
    "log": "of the poses of the log",
}


class PlacedRows:
    """The rows of a source in one reference system and in the wanted units, counted while they are read.

    Without fixes, points are x, y, z of the world frame, in metres. With fixes, they are longitude, latitude and
    ellipsoidal height, or their projection. A projection keeps heights in metres above the WGS 84 ellipsoid and adds
    the columns `crs`, `crs_x` and `crs_y`. Reading raises UsageError where a point has no place in the wanted system.

    Attributes
    ----------
    source
        Where they come from.
    columns
        Of all rows.
    crs
        Of the points, as GDAL reads it.
    count
        Rows read so far.

    Raises
    ------
    UsageError
        The wanted system is none, or one with a height of its own, or the source has no place on the globe.
    """

    def __init__(self, source: Source, wanted: str | None, *, imperial: bool) -> None:
        self.source, self._wanted, self._imperial = source, wanted, imperial
        self.count = self._unplaced = self._outside = 0
        self._target = None if wanted is None else _horizontal(wanted)
        if source.world is not None and wanted is not None:
            raise UsageError(
                f"{source.folder}: --crs {wanted} needs longitude and latitude, but the log has no satellite fixes. "
                "Leave --crs out for x, y of the drive."
            )
        self.crs = WGS_84
        if source.world is not None:
            name = f"wayside {source.world}: {_WORLDS.get(source.world, 'local')}"
            self.crs = (
                f'ENGCRS["{name}",EDATUM["{source.world}"],CS[Cartesian,2],AXIS["x",unspecified],'
                'AXIS["y",unspecified],LENGTHUNIT["metre",1]]'
            )
        elif self._target is not None:
            self.crs = self._target.to_wkt()
            self._to_crs = pyproj.Transformer.from_crs(WGS_84, self._target, always_xy=True)
        self.columns = self._placed(FlatTable(source.columns, ())).columns

    def __iter__(self) -> Iterator[FlatTable]:
        for table in self.source.chunks():
            self.count += len(table.rows)
            yield self._placed(table)

    def _placed(self, table: FlatTable) -> FlatTable:
        names = _GLOBE if self.source.world is None else _LOCAL
        points = tuple(_point(row, names) for row in table.rows)
        self._unplaced += points.count(None)
        if self._target is not None:
            self._outside += _outside(self._target, points)
            points = tuple(None if point is None else self._project(point) for point in points)
            table = _with_coordinates(table, points, self._target)
        rows = zip(table.rows, points, strict=True)
        placed = FlatTable(table.columns, tuple(row | {GEOMETRY: point} for row, point in rows))
        return in_feet_and_inches(placed) if self._imperial else placed

    def notes(self) -> Iterator[str]:
        """In words, what the rows placed so far need."""
        if self.source.world is not None:
            yield "the log has no fixes: geometry is x, y, z of the drive's own frame, in metres"
            return
        if self._unplaced:
            yield f"{self._unplaced} rows have no place on the globe: they have no geometry"
        if self._target is not None and self.count > self._unplaced:
            yield _operation(self._target, self._to_crs)
        if self._target is not None and self._outside:
            yield (
                f"{self._outside} {self.source.table} lie outside of the area that {self._target.name} is made for: "
                f"{_area(self._target)}"
            )

    def _project(self, point: Point) -> Point:
        moved = (*self._to_crs.transform(point[0], point[1]), *point[2:])
        if not all(map(math.isfinite, moved[:2])) and self._target is not None:
            raise UsageError(
                f"--crs {self._wanted}: {self._target.name} does not cover all signs. It is made for "
                f"{_area(self._target)}."
            )
        return moved


def _with_coordinates(
    table: FlatTable, points: tuple[Point | None, ...], crs: pyproj.CRS
) -> FlatTable:
    name = ":".join(crs.to_authority() or (crs.name,))
    units = [axis.unit_name for axis in crs.axis_info]
    columns = (
        Column("crs", pa.string(), "", "coordinate reference system of `crs_x`, `crs_y`"),
        Column("crs_x", pa.float64(), units[0], f"easting or longitude, {crs.name}"),
        Column("crs_y", pa.float64(), units[-1], f"northing or latitude, {crs.name}"),
    )
    rows = tuple(
        row if point is None else row | {"crs": name, "crs_x": point[0], "crs_y": point[1]}
        for row, point in zip(table.rows, points, strict=True)
    )
    return FlatTable((*table.columns, *columns), rows)


def _point(row: Row, names: tuple[str, str, str]) -> Point | None:
    known = [row[name] for name in names if row.get(name) is not None]
    return tuple(known) if len(known) >= 2 else None


def _horizontal(wanted: str) -> pyproj.CRS:
    try:
        crs = pyproj.CRS.from_user_input(wanted)
    except CRSError as error:
        raise UsageError(
            f"--crs: PROJ does not know the coordinate reference system {wanted!r}. Write it as in EPSG:26914; "
            "https://epsg.org lists them."
        ) from error
    if not (crs.is_projected or crs.is_geographic) or len(crs.axis_info) != 2:
        raise UsageError(
            f"--crs {wanted}: {crs.name} is a {crs.type_name}, but a projected or geographic system is needed. "
            "Heights stay metres above the WGS 84 ellipsoid: name the horizontal part alone."
        )
    return crs


def _operation(crs: pyproj.CRS, transformer: pyproj.Transformer) -> str:
    """What PROJ did and how exact that is; a datum that moves with its continent is metres from WGS 84."""
    try:
        used = transformer.get_last_used_operation()
    except ProjError:  # nothing was done: it is the system that the signs are in
        return f"coordinates in {crs.name}, as they are"
    known = used.accuracy >= 0
    accuracy = f"accuracy {used.accuracy:g} m" if known else "accuracy unknown"
    return f"coordinates in {crs.name} by {used.description} ({accuracy})"


def _outside(crs: pyproj.CRS, points: tuple[Point | None, ...]) -> int:
    """How many points, longitude and latitude, lie where a system is not made for."""
    area = crs.area_of_use
    if area is None:
        return 0
    return sum(
        not _within(point, area.west, area.east, area.south, area.north)
        for point in points
        if point is not None
    )


def _within(point: Point, west: float, east: float, south: float, north: float) -> bool:
    lon, lat = point[:2]
    across = west <= lon <= east if west <= east else lon >= west or lon <= east
    return across and south <= lat <= north


def _area(crs: pyproj.CRS) -> str:
    return "an area that it does not state" if crs.area_of_use is None else crs.area_of_use.name
