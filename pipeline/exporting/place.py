"""Rows placed on the globe, in a projection of it or in the drive's own frame; in metres, or in feet and inches."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import pyarrow as pa
import pyproj
from pyproj.exceptions import CRSError, ProjError

from wayside.pipeline.exporting.table import GEOMETRY, Row, Source, main_columns
from wayside.pipeline.files.lengths import METRES_IN_FOOT
from wayside.pipeline.files.visible_text import counted
from wayside.schemas.errors import UsageError
from wayside.schemas.tables import Column

Point = tuple[float, ...]
"""x, y, or x, y and height."""
WGS_84 = "EPSG:4326"
SHORT_NAME = 10
"""Characters of a column's name in a dBASE file, which holds the attributes of a Shapefile."""
_WORLDS = {
    "drive_start": "x forward and y left of the first image",
    "log": "of the poses of the log",
}
_INCHES = ("panel_width_m", "panel_height_m", "sigma_width_m", "sigma_height_m")
"""Sizes of faces are ordered in inches, distances are in feet."""
_DIGITS = {"m": 3, "ft": 3, "in": 2, "px": 1, "deg": 1, "m^2": 6, "ft^2": 5, "": 3}
_DIGITS["mi, km, ft or m"] = 5
"""Decimals of a unit, finer than what is measured; a longitude and what is not listed has `_PLACE_DIGITS`."""
_PLACE_DIGITS = 8
_GLOBE = ("lon_deg", "lat_deg")


class PlacedRows:
    """The rows of a source in one reference system and in the wanted units, counted while they are read.

    Each row has its `geometry`. Without fixes it is x, y, z of the world frame in metres. With fixes it is longitude,
    latitude and ellipsoidal height, or their projection, which adds the columns `crs`, `crs_x` and `crs_y`. Raises
    UsageError for a system that cannot be used, and while reading, for a point that has no place in it.
    """

    def __init__(
        self, source: Source, wanted: str | None, *, imperial: bool, every: bool = True
    ) -> None:
        self.source = source
        self.count = self._unplaced = self._outside = 0
        self._target = None if wanted is None else _horizontal(wanted)
        columns = source.columns if every else main_columns(source)
        if source.world is not None:
            if wanted is not None:
                raise UsageError(
                    f"{source.folder}: --crs {wanted} needs longitude and latitude, but the log has no satellite "
                    "fixes. Leave --crs out for x, y of the drive."
                )
            name = f"wayside {source.world}: {_WORLDS.get(source.world, 'local')}"
            self.crs = (
                f'ENGCRS["{name}",EDATUM["{source.world}"],CS[Cartesian,2],AXIS["x",unspecified],'
                'AXIS["y",unspecified],LENGTHUNIT["metre",1]]'
            )
        elif self._target is None:
            self.crs = WGS_84
        else:
            self.crs = self._target.to_wkt()
            self._to_crs = pyproj.Transformer.from_crs(WGS_84, self._target, always_xy=True)
            columns += _crs_columns(self._target)
        units = {column.name: imperial_column(column) for column in columns} if imperial else {}
        self.columns = tuple(units[c.name][0] if imperial else c for c in columns)
        self._digits = {
            c.name: _PLACE_DIGITS if c.name in _GLOBE else _DIGITS.get(c.unit, _PLACE_DIGITS)
            for c in self.columns
        }
        self._converted = {name: (c.name, f) for name, (c, f) in units.items() if f != 1.0}

    def __iter__(self) -> Iterator[list[Row]]:
        for rows in self.source.chunks():
            self.count += len(rows)
            yield [self._placed(row) for row in rows]

    def _placed(self, row: Row) -> Row:
        axes = (*_GLOBE, "alt_m") if self.source.world is None else ("x", "y", "z")
        known: Point = tuple(row[name] for name in axes if row.get(name) is not None)
        point = known if len(known) >= 2 else None
        row = row.copy()
        self._unplaced += point is None
        if self._target is not None and point is not None:
            point = self._project(self._target, point)
            name = ":".join(self._target.to_authority() or (self._target.name,))
            row |= {"crs": name, "crs_x": point[0], "crs_y": point[1]}
        for name, (renamed, factor) in self._converted.items():
            if name in row:
                value = row.pop(name)
                row[renamed] = None if value is None else value * factor
        for name, digits in self._digits.items():
            if isinstance(value := row.get(name), float):
                row[name] = round(value, digits)
        return row | {GEOMETRY: point}

    def _project(self, crs: pyproj.CRS, point: Point) -> Point:
        self._outside += not _within(crs, point)
        moved = self._to_crs.transform(point[0], point[1])
        if not all(map(math.isfinite, moved)):
            raise UsageError(
                f"--crs {crs.srs}: {crs.name} does not cover all signs. It is made for {_area(crs)}."
            )
        return (*moved, *point[2:])

    def notes(self) -> Iterator[str]:
        """What must be known to use the rows read so far."""
        if self.source.world is not None:
            yield "the log has no fixes: geometry is x, y, z of the drive's own frame, in metres"
            return
        if self._unplaced:
            yield f"without a place on the globe, and so without geometry: {counted(self._unplaced, 'row')}"
        if self._target is not None and self.count > self._unplaced:
            yield _operation(self._target, self._to_crs)
        if self._target is not None and self._outside:
            yield (
                f"{self._outside} {self.source.name} lie outside of the area that {self._target.name} is made for: "
                f"{_area(self._target)}"
            )


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


def _crs_columns(crs: pyproj.CRS) -> tuple[Column, ...]:
    units = [axis.unit_name for axis in crs.axis_info]
    return (
        Column("crs", pa.string(), "", "coordinate reference system of `crs_x`, `crs_y`"),
        Column("crs_x", pa.float64(), units[0], f"easting or longitude, {crs.name}"),
        Column("crs_y", pa.float64(), units[-1], f"northing or latitude, {crs.name}"),
    )


def _operation(crs: pyproj.CRS, transformer: pyproj.Transformer) -> str:
    """What PROJ did and how exact that is; a datum that moves with its continent is metres from WGS 84."""
    try:
        used = transformer.get_last_used_operation()
    except ProjError:  # nothing was done: it is the system that the signs are in
        return f"coordinates in {crs.name}, as they are"
    accuracy = f"accuracy {used.accuracy:g} m" if used.accuracy >= 0 else "accuracy unknown"
    return f"coordinates in {crs.name} by {used.description} ({accuracy})"


def _within(crs: pyproj.CRS, point: Point) -> bool:
    """Whether longitude and latitude lie where a system is made for, as far as it states that."""
    area, (lon, lat) = crs.area_of_use, point[:2]
    if area is None:
        return True
    east, west = lon <= area.east, lon >= area.west
    across = east and west if area.west <= area.east else east or west
    return across and area.south <= lat <= area.north


def _area(crs: pyproj.CRS) -> str:
    return "an area that it does not state" if crs.area_of_use is None else crs.area_of_use.name


def imperial_column(column: Column) -> tuple[Column, float]:
    """A length in international feet (0.3048 m), a face's size in inches; its factor, 1 for what is no length."""
    power = {"m": 1, "m^2": 2}.get(column.unit)
    if power is None:
        return column, 1.0
    unit = "in" if column.name in _INCHES else "ft"
    factor = (12 if unit == "in" else 1) / METRES_IN_FOOT
    unit += "^2" if power == 2 else ""
    return replace(column, name=f"{_stem(column)}_{_suffix(unit)}", unit=unit), factor**power


def short_names(columns: Iterable[Column]) -> dict[str, str]:
    """A name of at most `SHORT_NAME` characters for each column by its name, each another one, units kept.

    Long ones lose vowels from their end on, then their end: `panel_width_m` is `pnl_wdth_m`.
    """
    names: dict[str, str] = {}
    for column in columns:
        stem = _stem(column)
        unit = column.name.removeprefix(stem)
        room = SHORT_NAME - len(unit)
        for at in range(len(stem) - 1, 0, -1):
            if len(stem) > room and stem[at] in "aeiou" and stem[at - 1] != "_":
                stem = stem[:at] + stem[at + 1 :]
        stem = stem[:room]
        number, short = 1, stem + unit
        while short in names.values():
            number += 1
            short = f"{stem[: room - len(str(number))]}{number}{unit}"
        names[column.name] = short
    return names


def _stem(column: Column) -> str:
    """Name of a column without its unit."""
    return column.name.removesuffix(f"_{_suffix(column.unit)}") if column.unit else column.name


def _suffix(unit: str) -> str:
    return unit.replace("^", "")
