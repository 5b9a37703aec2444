"""Places of drives without satellite fixes: their route, drawn as a straight line over an ocean.

A milepost gives the place of a drive along its route, and the path the lateral offset. Merging needs WGS 84, so each
route is drawn along a parallel of the Pacific, where no road is. In the tables of an inventory route, measure and
lateral offset stand for such places.
"""

import hashlib
from math import cos, radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from wayside.pipeline.results.result import read_run
from wayside.schemas.routes import MEASURE_UNITS
from wayside.stages.kernels import Array

MEASURE_SIGMA_M, HEIGHT_SIGMA_M = 5.0, 0.3
"""Errors that the signs of a drive share: a milepost is read to 0.01 mile, and the road is not flat."""
_WEST_DEG, _EAST_DEG, _MOST_LAT_DEG = -150.0, -93.0, 5.0
_STARTS_DEG = 40.0
"""Routes begin so far from the west on, and have 1,890 km for their measures."""
_METRES_EAST, _METRES_NORTH = 111_319.5, 110_574.3
"""Of a degree at the equator."""
_CAMERA_HEIGHT_M = 1.5
"""Where a run did not measure it (estimate)."""
_NO_PLACE = dict.fromkeys(("lon_deg", "lat_deg", "alt_m", "geometry"))


class StraightRoute(NamedTuple):
    """A route as a line: longitude at measure 0, latitude, and metres in a degree of longitude."""

    lon_deg: float
    lat_deg: float
    metres_east: float

    def places(self, along_m: Array, right_m: Array) -> Array:
        """Longitude and latitude (n, 2) at measures, and to the right of the direction in which these rise."""
        lon, lat = along_m / self.metres_east, right_m / _METRES_NORTH
        return np.column_stack([self.lon_deg + lon, self.lat_deg - lat])


def straight_route(name: str | None) -> StraightRoute:
    """The line of a route: its name alone decides where it lies."""
    digest = hashlib.sha256((name or "").encode()).digest()
    west, north = (int.from_bytes(digest[k : k + 8]) / 2**64 for k in (0, 8))
    lat = (2 * north - 1) * _MOST_LAT_DEG
    return StraightRoute(_WEST_DEG + west * _STARTS_DEG, lat, _METRES_EAST * cos(radians(lat)))


def place_frames(folder: Path, table: pa.Table) -> pa.Table:
    """Rows of `frames.parquet` with places and headings by route and milepost, where the drive has these and no fixes.

    The camera turns against the line as against the path: curves are drawn out.
    """
    found = _by_milepost(folder, table, "heading_deg")
    if found is None:
        return table
    along, sense, route, height = found
    x, y, *quaternion = (column_of(table, name) for name in ("x", "y", "qx", "qy", "qz", "qw"))
    known = np.flatnonzero(np.isfinite(along) & np.isfinite(quaternion).all(axis=0))
    heading = np.full(len(table), np.nan)
    if len(known) > 1:
        ahead = Rotation.from_quat(np.column_stack(quaternion)[known]).as_matrix()[:, :, 2]
        travel = np.arctan2(np.gradient(y[known]), np.gradient(x[known]))
        off = travel - np.arctan2(ahead[:, 1], ahead[:, 0])
        heading[known] = (90 * sense + np.degrees(off)) % 360
    places = route.places(along, np.zeros(len(table)))
    return _with(table, places, {"alt_m": np.full(len(table), height), "heading_deg": heading})


def place_signs(folder: Path, table: pa.Table) -> pa.Table:
    """The same of rows of `signs.parquet`, with the errors that they share."""
    found = _by_milepost(folder, table, "lon_deg")
    if found is None:
        return table
    along, sense, route, height = found
    up, down, lateral = (column_of(table, name) for name in ("up_m", "down_m", "lateral_m"))
    level, rise = (
        np.hypot(shared, np.nan_to_num(column_of(table, own)))
        for shared, own in ((MEASURE_SIGMA_M, "sigma_along_m"), (HEIGHT_SIGMA_M, "sigma_up_m"))
    )
    errors = {"sigma_east_m": level, "sigma_north_m": level, "sigma_alt_m": rise}
    columns = {"alt_m": np.where(np.isfinite(up), up, height - down)} | errors
    return _with(table, route.places(along, sense * lateral), columns)


def without_place(row: dict[str, Any]) -> dict[str, Any]:
    """A row of an inventory; one on a straight route with measure and lateral offset in the place of its place."""
    lon, lat = row["lon_deg"], row["lat_deg"]
    if not (_WEST_DEG <= lon < _EAST_DEG and abs(lat) <= _MOST_LAT_DEG + 0.1):
        return row
    if row.get("measure_unit") is None:
        return row | _NO_PLACE
    route = straight_route(row["route"])
    along = (lon - route.lon_deg) * route.metres_east / MEASURE_UNITS[row["measure_unit"]]
    right = (route.lat_deg - lat) * _METRES_NORTH
    return row | _NO_PLACE | {"measure": along, "lateral_m": right, "up_m": row["alt_m"]}


def with_place(row: dict[str, Any]) -> dict[str, Any]:
    """The row of a panel as it was before `without_place`."""
    if row["lon_deg"] is not None:
        return row
    along = row["measure"] * MEASURE_UNITS[row["measure_unit"]]
    place = straight_route(row["route"]).places(np.array([along]), np.array([row["lateral_m"]]))
    lon, lat = place[0].tolist()
    return row | {"lon_deg": lon, "lat_deg": lat, "alt_m": row["up_m"]}


def _by_milepost(
    folder: Path, table: pa.Table, column: str
) -> tuple[Array, int, StraightRoute, float] | None:
    """Measures (n,) m, whether they rise (1) or fall (-1), route, and height of the camera; None: not to be placed."""
    if not len(table) or table[column].null_count < len(table):
        return None
    run = read_run(folder)
    told = run.get("settings", {}).get("route", {})
    if told.get("milepost", -1.0) < 0 or told.get("unit") not in MEASURE_UNITS:
        return None
    sense = -1 if told["decreasing"] else 1
    along = told["milepost"] * MEASURE_UNITS[told["unit"]] + sense * column_of(table, "station_m")
    height = float(run.get("camera_height_m") or _CAMERA_HEIGHT_M)
    return along, sense, straight_route(told["name"]), height


def column_of(table: pa.Table, name: str) -> Array:
    """A column as numbers (n,), null as nan."""
    return np.asarray(table[name].cast(pa.float64()).to_numpy(zero_copy_only=False), np.float64)


def _with(table: pa.Table, places: Array, columns: dict[str, Array]) -> pa.Table:
    """The table with these columns, nan as null."""
    for name, values in ({"lon_deg": places[:, 0], "lat_deg": places[:, 1]} | columns).items():
        at = table.schema.get_field_index(name)
        found = pa.array(values, table.schema.field(at).type, from_pandas=True)
        table = table.set_column(at, table.schema.field(at), found)
    return table
