"""Route lines with measures, read from a GeoPackage, a GeoParquet or another file that GDAL reads."""

import difflib
import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wayside.pipeline.files.parquet import read_parquet
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.routes import RouteSegments
from wayside.schemas.settings import RouteSettings
from wayside.stages.georeference import ROUTE_REACH_M

_WGS_84 = "OGC:CRS84"
_NAMES = "route route_id routeid route_name routename rte_id rte_nm rid rte name".split()
"""Usual names of the column that names a route, the surest first."""
_PARQUET = (".parquet", ".geoparquet")
_MOST_LISTED = 8
_SAMPLE = 100
"""Lines that are looked at for measures before a run."""

Bounds = tuple[float, float, float, float]
_WORLD: Bounds = (-180.0, -90.0, 180.0, 90.0)


@dataclass(frozen=True, slots=True)
class RouteFile:
    """A file of route lines that can be read."""

    path: Path
    """Of the file."""
    layer: str
    """Of a file that GDAL reads; "" of Parquet."""
    column: str
    """That names the routes."""
    geometry: str
    """Column of the lines in Parquet."""
    crs: Any
    """Their reference system, of pyproj."""
    settings: RouteSettings
    """Which route, in which unit."""

    def near(self, places: NDArray[np.float64]) -> RouteSegments:
        """Pieces of the routes in the box about places (n, 2), degrees, and `ROUTE_REACH_M` around.

        Pieces without a measure at both ends are left out. Raises InputError where the file can no longer be read.
        """
        margin = ROUTE_REACH_M / 1e4  # degrees: a metre is at most 1e-4, up to a latitude of 84
        low, high = (places.min(axis=0) - margin).tolist(), (places.max(axis=0) + margin).tolist()
        try:
            names, lines = self._read((low[0], low[1], high[0], high[1]))
        except Exception as error:
            raise _unreadable(self.path, error) from error
        chosen = self._chosen(names)
        return _segments(names[chosen], lines[chosen], self, (*low, *high))

    def places(self, wanted: Sequence[tuple[str, float]]) -> list[tuple[float, float]]:
        """Latitude and longitude, deg, at measures of routes; raises ValueError where the lines do not reach one."""
        names, lines = self._read()
        of = {route for route, _ in wanted}
        routes = {r: _segments(names[names == r], lines[names == r], self, _WORLD) for r in of}
        found = []
        for route, measure in wanted:
            pieces = routes[route]
            a, b = pieces.start_measure, pieces.end_measure
            at = np.flatnonzero((np.minimum(a, b) <= measure) & (measure <= np.maximum(a, b)))
            if not len(at):
                raise ValueError(f"route {route} has no measure {measure:g} in {self.path}")
            k = at[0]
            part = (measure - a[k]) / (b[k] - a[k] or 1.0)
            lon, lat = (pieces.start[k] + part * (pieces.end[k] - pieces.start[k])).tolist()
            found.append((lat, lon))
        return found

    def _chosen(self, names: NDArray[Any]) -> NDArray[np.bool_]:
        """Which lines are of the route that the settings name, or of any."""
        return np.array([self.settings.name in ("", name) for name in names], bool)

    def _read(
        self, box: Bounds | None = None, most: int | None = None
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Names and geometries of the lines in a box of WGS 84, or of so many at most where GDAL reads them."""
        import shapely

        geometry = self.geometry
        if self.layer:
            import pyogrio
            import pyproj

            to_file = pyproj.Transformer.from_crs(_WGS_84, self.crs, always_xy=True)
            with warnings.catch_warnings(action="ignore"):  # geometries have their M all the same
                meta, table = pyogrio.read_arrow(
                    self.path,
                    layer=self.layer,
                    columns=[self.column],
                    bbox=None if box is None else to_file.transform_bounds(*box),
                    max_features=most,
                )
            geometry = meta["geometry_name"] or "wkb_geometry"
        else:
            table = read_parquet(self.path, [self.column, geometry])
        table = table.filter(table.column(geometry).is_valid())
        names = [str(name) for name in table.column(self.column).to_pylist()]
        lines = shapely.from_wkb(np.array(table.column(geometry).to_pylist(), object))
        return np.array(names, object), lines


def open_routes(settings: RouteSettings) -> RouteFile | None:
    """The file of route lines that the settings name, checked; None where they name none.

    Raises UsageError where a package that reads it is missing, or it has no such column or route.
    Raises InputError where it cannot be read, or has no reference system or no measures.
    """
    if not settings.file:
        return None
    try:
        import pyogrio  # noqa: F401  (the packages come together)
        import shapely
    except ImportError as error:
        raise UsageError(
            "--routes needs the packages pyogrio and shapely. Install them with pip install 'wayside[gis]'."
        ) from error
    path = Path(settings.file)
    if not path.exists():
        raise InputError(f"--routes {path}: there is no such file")
    try:
        layout = _parquet if path.suffix.lower() in _PARQUET else _layer
        layer, columns, geometry, crs = layout(path)
        file = RouteFile(path, layer, _column(path, columns, settings), geometry, crs, settings)
        names, lines = file._read(most=None if settings.name else _SAMPLE)
    except (UsageError, InputError):
        raise
    except Exception as error:  # GDAL, PROJ and Arrow have errors of their own for each damage
        raise _unreadable(path, error) from error
    known = sorted(set(names))
    if settings.name and settings.name not in known:
        near = difflib.get_close_matches(settings.name, known, n=_MOST_LISTED, cutoff=0.4)
        raise UsageError(
            f"--routes {path}: there is no route {settings.name!r} among the {len(known)} of its column {file.column}; "
            f"the nearest: {', '.join(near or known[:_MOST_LISTED])}"
        )
    lines = lines[file._chosen(names)]
    if not any(shapely.has_m(lines)):
        kinds = sorted({str(line.geom_type) for line in lines})
        raise InputError(
            f"--routes {path}: the lines need measures (M), but the file holds {' and '.join(kinds) or 'no lines'} "
            "without. Export the calibrated routes as LineString M or LineString ZM."
        )
    return file


def route_notes(
    settings: RouteSettings, routes: Sequence[str | None], *, on_globe: bool = True
) -> list[str]:
    """What a person has to know of the routes of the signs of a drive: those without one, and why."""
    if not settings.file or not routes:
        return []
    if not on_globe:
        return [
            "--routes: the log has no satellite fixes, so route and measure are empty; "
            "give --route and --milepost instead"
        ]
    count = routes.count(None)
    if not count:
        return []
    return [
        f"{count} of {len(routes)} signs have no route: the path follows no line of {Path(settings.file).name} within "
        f"{ROUTE_REACH_M:g} m there"
    ]


def _layer(path: Path) -> tuple[str, list[str], str, Any]:
    """The first layer of lines: its name, columns, and reference system."""
    import pyogrio
    import pyproj

    with warnings.catch_warnings(action="ignore"):
        layers = [(str(name), str(kind)) for name, kind in pyogrio.list_layers(path)]
        lines = [name for name, kind in layers if "LineString" in kind or kind == "Unknown"]
        if not lines:
            found = ", ".join(f"{name} ({kind})" for name, kind in layers) or "no layers"
            raise InputError(f"--routes {path}: there is no layer of lines, only {found}")
        info = pyogrio.read_info(path, layer=lines[0])
    if info["crs"] is None:
        raise _no_crs(path)
    return lines[0], [str(name) for name in info["fields"]], "", pyproj.CRS(info["crs"])


def _parquet(path: Path) -> tuple[str, list[str], str, Any]:
    """Columns, geometry column and reference system of a GeoParquet file."""
    import pyproj

    metadata = pq.read_metadata(path)
    about = (metadata.metadata or {}).get(b"geo")
    if about is None:
        raise InputError(
            f"--routes {path}: this is Parquet without the metadata of GeoParquet. Write it with geopandas or GDAL."
        )
    geo = json.loads(about)
    name = str(geo["primary_column"])
    stated = geo["columns"][name].get("crs", _WGS_84)
    if stated is None:
        raise _no_crs(path)
    columns = [one for one in metadata.schema.to_arrow_schema().names if one != name]
    return "", columns, name, pyproj.CRS.from_user_input(stated)


def _column(path: Path, columns: Sequence[str], settings: RouteSettings) -> str:
    by_name = {name.lower(): name for name in reversed(columns)}
    wanted = [settings.column] if settings.column else _NAMES
    found = next((by_name[name.lower()] for name in wanted if name.lower() in by_name), None)
    if found is None:
        listed = ", ".join(columns) or "none"
        raise UsageError(
            f"--routes {path}: there is no column with names of routes ({', '.join(wanted)}) among {listed}. Name it, "
            "as in --set route.column=RTE_NAME."
        )
    return found


def _segments(
    names: NDArray[Any], lines: NDArray[Any], file: RouteFile, box: Bounds
) -> RouteSegments:
    """Pieces of lines that reach into a box of WGS 84, with a measure at both ends."""
    import pyproj
    import shapely

    parts, of_line = shapely.get_parts(lines, return_index=True)
    points, of_part = shapely.get_coordinates(parts, include_m=True, return_index=True)
    to_globe = pyproj.Transformer.from_crs(file.crs, _WGS_84, always_xy=True)
    places = np.column_stack(to_globe.transform(points[:, 0], points[:, 1]))
    joined = (of_part[1:] == of_part[:-1]) & np.isfinite(points[1:, 2] + points[:-1, 2])
    low, high = np.minimum(places[1:], places[:-1]), np.maximum(places[1:], places[:-1])
    kept = np.flatnonzero(joined & (high >= box[:2]).all(axis=1) & (low <= box[2:]).all(axis=1))
    of_segment = names[of_line[of_part[kept]]] if len(kept) else np.array([])
    known, route = np.unique(of_segment.astype(str), return_inverse=True)
    return RouteSegments(
        tuple(known.tolist()),
        route.astype(np.int64),
        places[kept],
        places[kept + 1],
        points[kept, 2],
        points[kept + 1, 2],
        file.settings.unit,
    )


def _no_crs(path: Path) -> InputError:
    return InputError(
        f"--routes {path}: the lines have no coordinate reference system. Assign one in a GIS and export again."
    )


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(f"--routes {path}: the route lines cannot be read ({error}). Check the file.")
