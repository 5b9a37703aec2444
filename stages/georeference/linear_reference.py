"""Route and measure of each sign: by a milepost at the start, or by route lines with measures."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from wayside.schemas.frame import EARTH_RADIUS_M
from wayside.schemas.routes import RouteSegments
from wayside.schemas.settings import RouteSettings
from wayside.schemas.signs import Sign
from wayside.stages.georeference.path import DrivePath
from wayside.stages.kernels import Array

ROUTE_REACH_M = 30.0
"""Farthest line of the path's route: half of eight lanes of 3.7 m with a median, and 5 m of fix and line."""
ANGLE_DEG = 30.0
"""Largest angle between a line and the travel, either way: crossing roads meet at more, ramps leave at less."""
SIGMA_M = 8.0
"""Scatter of the path about the line of its route: two lanes, and the scatter of fix and line."""
CHANGE = 25.0
"""Cost of a change of route, five standard deviations squared: crossing roads and ramps are left out."""


def measure_along_route(
    signs: Iterator[Sign],
    *,
    path: DrivePath,
    settings: RouteSettings,
    segments: RouteSegments | None = None,
) -> Iterator[Sign]:
    """Signs with the route and its measure abreast of them.

    With a milepost that is the measure at the start plus, or minus, the distance along the path. With route lines, the
    measure is taken at the point of the followed line that is nearest to the path abreast of the sign. A sign near a
    crossing keeps the route of the drive, also where another line is nearer.

    Without a place on the globe, and where the path followed no route, signs stay as they are. `segments`: of routes
    near the path; None: by milepost.
    """
    if segments is None:
        for sign in signs:
            yield replace(sign, **settings.measured(sign.station_m))
        return
    listed = list(signs)
    if path.globe is None or not len(segments) or not listed:
        yield from listed
        return
    places = path.globe.route()[[path.globe.rows[frame] for frame in path.stations], :2]
    stations = np.array(list(path.stations.values()))
    wanted = np.array([sign.station_m for sign in listed])
    for sign, found in zip(
        listed, measures_on_lines(wanted, stations, places, segments), strict=True
    ):
        yield replace(sign, **found)


def measures_on_lines(
    wanted: Array, stations: Array, places: Array, segments: RouteSegments
) -> list[dict[str, Any]]:
    """Route, measure and its unit at stations of a path, by the names of their columns; {} where it follows no route.

    wanted (n,), metres. stations (p,) and places (p, 2), longitude and latitude, degrees: of the path.
    """
    every = np.concatenate([wanted, stations])
    order = np.argsort(every, kind="stable")
    distance, measure = nearest_on_routes(*_along(places, stations, every[order]), segments)
    followed = np.empty(len(every), np.int64)
    followed[order] = follow_routes(distance)
    found: list[dict[str, Any]] = []
    for route, here in zip(followed[: len(wanted)], np.argsort(order), strict=False):
        known = route >= 0 and math.isfinite(measure[here, route])
        along = {"measure": float(measure[here, route]), "measure_unit": segments.unit}
        found.append({"route": segments.names[route]} | along if known else {})
    return found


def nearest_on_routes(
    points: Array, directions: Array, segments: RouteSegments
) -> tuple[Array, Array]:
    """Distance of each of p points to each of r routes, metres, and the measure of the nearest point; both (p, r).

    A point is compared with the pieces that lie within `ROUTE_REACH_M` and run along the travel. Without such a piece,
    the distance is infinite and the measure nan. Distances are those on the plane that touches the sphere at the point:
    exact to 1e-5 within the reach.

    `points` (p, 2): longitude and latitude, degrees. `directions` (p, 2): unit vectors of travel, east and north.
    """
    distance = np.full((len(points), len(segments.names)), math.inf)
    measure = np.full(distance.shape, math.nan)
    gained = segments.end_measure - segments.start_measure
    for row, (point, direction) in enumerate(zip(points, directions, strict=True)):
        shrink = math.cos(math.radians(point[1]))
        to_metres = math.radians(EARTH_RADIUS_M) * np.array([shrink, 1.0])
        start = (segments.start - point) * to_metres
        span = (segments.end - segments.start) * to_metres
        squared = (span**2).sum(axis=1)
        part = np.clip(-(start * span).sum(axis=1) / np.maximum(squared, 1e-12), 0.0, 1.0)
        apart = np.linalg.norm(start + part[:, None] * span, axis=1)
        along = np.abs(span @ direction) >= math.cos(math.radians(ANGLE_DEG)) * np.sqrt(squared)
        fits = np.flatnonzero((apart <= ROUTE_REACH_M) & along & (squared > 0))
        nearest_first = fits[np.argsort(apart[fits], kind="stable")]
        routes, first = np.unique(segments.route[nearest_first], return_index=True)
        near = nearest_first[first]
        distance[row, routes] = apart[near]
        measure[row, routes] = segments.start_measure[near] + part[near] * gained[near]
    return distance, measure


def follow_routes(distance: Array) -> np.ndarray[Any, np.dtype[np.int64]]:
    """The route (p,) that each point of a path is on, -1: none, so that it changes seldom (Viterbi 1967).

    Being on a route costs the squared distance in standard deviations, on none that of `ROUTE_REACH_M`; a change costs
    `CHANGE`. Of two routes with the same line the first by name stays.

    distance (p, r), metres: of the points in order of travel to each route.
    """
    none = (ROUTE_REACH_M / SIGMA_M) ** 2
    costs = np.column_stack([(distance / SIGMA_M) ** 2, np.full(len(distance), none)])
    total, came_from = costs[0], np.empty(costs.shape, np.int64)
    for row in range(1, len(costs)):
        best = int(np.argmin(total))
        stay = total <= total[best] + CHANGE
        came_from[row] = np.where(stay, np.arange(len(total)), best)
        total = np.minimum(total, total[best] + CHANGE) + costs[row]
    state, states = int(np.argmin(total)), np.empty(len(costs), np.int64)
    for row in range(len(costs) - 1, -1, -1):
        states[row] = state
        state = int(came_from[row, state])
    return np.where(states == distance.shape[1], -1, states)


def _along(places: Array, stations: Array, wanted: Array) -> tuple[Array, Array]:
    """Longitude, latitude (n, 2) and direction of travel (n, 2) at stations; beyond its ends the path goes on straight.

    `places` (p, 2), `stations` (p,): of the frames. Where the vehicle stands, the last direction is kept.
    """
    moving = np.concatenate([[True], np.diff(stations) > 0])
    places, stations = places[moving], stations[moving]
    if len(stations) < 2:
        return np.repeat(places[:1], len(wanted), axis=0), np.tile([1.0, 0.0], (len(wanted), 1))
    step = np.clip(np.searchsorted(stations, wanted, side="right") - 1, 0, len(stations) - 2)
    part = (wanted - stations[step]) / np.diff(stations)[step]
    change = np.diff(places, axis=0)[step]
    points = places[step] + part[:, None] * change
    change *= np.column_stack([np.cos(np.radians(points[:, 1])), np.ones(len(points))])
    return points, change / np.maximum(np.linalg.norm(change, axis=1), 1e-300)[:, None]
