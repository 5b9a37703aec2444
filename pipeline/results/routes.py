"""Where along a route the rows of a result are, by a route that is given after the run."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wayside.pipeline.files.route_file import open_routes
from wayside.pipeline.results.result import read_rows
from wayside.schemas.errors import InputError
from wayside.schemas.settings import RouteSettings
from wayside.schemas.tables import FRAMES
from wayside.stages.georeference import measures_on_lines

Row = dict[str, Any]
"""Values by column name; one that is absent or None is unknown."""


def with_route(out: Path, rows: Iterable[Row], route: RouteSettings | None) -> list[Row]:
    """The rows with route, measure and unit at their `station_m`; null where that is unknown, or on no route.

    `route`: None leaves the rows as they are. Raises as `open_routes`, and InputError where route lines are given for a
    drive that has no place on the globe.
    """
    rows = list(rows)
    if route is None:
        return rows
    stations = sorted({row["station_m"] for row in rows if row.get("station_m") is not None})
    by = _by_lines(out, route, stations) if route.file else map(route.measured, stations)
    found = dict(zip(stations, by, strict=True))
    unknown = dict.fromkeys(("route", "measure", "measure_unit"))
    return [row | unknown | found.get(row.get("station_m"), {}) for row in rows]


def _by_lines(out: Path, route: RouteSettings, stations: Sequence[float]) -> list[Row]:
    lines, names = open_routes(route), ("station_m", "lon_deg", "lat_deg")
    path = [[row[name] for name in names] for row in read_rows(out, FRAMES, names)]
    passed = np.array([one for one in path if None not in one], np.float64).reshape(-1, 3)
    if lines is None or not len(passed):
        raise InputError(
            f"--routes: {out} has no place on the globe, because its log has no satellite fixes. Give --route and "
            "--milepost instead."
        )
    places, segments = passed[:, 1:], lines.near(passed[:, 1:])
    if not len(segments):
        return [{} for _ in stations]
    return measures_on_lines(np.array(stations), passed[:, 0], places, segments)
