"""Measures along routes: by a milepost, and by lines that the path follows."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.routes import RouteSegments
from wayside.schemas.settings import RouteSettings
from wayside.stages.georeference import measure_along_route
from wayside.stages.georeference.linear_reference import (
    CHANGE,
    ROUTE_REACH_M,
    SIGMA_M,
    follow_routes,
    nearest_on_routes,
)

GEOD = pyproj.Geod(ellps="sphere", R=6_371_008.8)
LON, LAT = -98.86, 38.88
SETTINGS = RouteSettings(file="routes.gpkg")


@dataclass(frozen=True)
class Placed:
    """What of a sign is read and written here."""

    station_m: float
    route: str | None = None
    measure: float = math.nan
    measure_unit: str | None = None


def at(east, north):
    """Longitude and latitude of a point, metres from a corner of the map."""
    lon, lat, _ = GEOD.fwd(LON, LAT, 90, east)
    return GEOD.fwd(lon, lat, 0, north)[:2]


def drive(points):
    """A path through points (east, north), metres."""
    places = np.array([at(*point) for point in points])
    steps = np.linalg.norm(np.diff(np.array(points, float), axis=0), axis=1)
    stations = np.concatenate([[0.0], np.cumsum(steps)]).tolist()
    globe = SimpleNamespace(
        rows={frame: frame for frame in range(len(points))},
        route=lambda: np.column_stack([places, np.zeros(len(places))]),
    )
    return SimpleNamespace(stations=dict(enumerate(stations)), globe=globe)


def lines(**routes):
    """Segments of routes, each a list of (east, north, measure); none where a measure is missing."""
    names, rows = tuple(sorted(routes)), []
    for index, name in enumerate(names):
        for a, b in pairwise(routes[name]):
            if not math.isnan(a[2] + b[2]):
                rows.append((index, at(*a[:2]), at(*b[:2]), a[2], b[2]))
    route, start, end, first, last = zip(*rows, strict=True)
    return RouteSegments(names, np.array(route), *map(np.array, (start, end, first, last)), "mi")


def measured(stations, path, segments=None, settings=SETTINGS):
    signs = iter([Placed(float(station)) for station in stations])
    return list(measure_along_route(signs, path=path, settings=settings, segments=segments))


EAST = [(x, 0.0) for x in range(0, 1001, 10)]
MAIN = [(-50, 3, 10.0), (1050, 3, 11.1)]


@pytest.mark.parametrize(("decreasing", "sense"), [(False, 1), (True, -1)])
def test_a_milepost_counts_miles_in_the_direction_of_travel(decreasing, sense):
    settings = RouteSettings(name="US-36 EB", milepost=12.35, decreasing=decreasing)
    (sign,) = measured([1609.344], drive(EAST), settings=settings)
    assert (sign.route, sign.measure_unit) == ("US-36 EB", "mi")
    assert sign.measure == pytest.approx(12.35 + sense)
    km = replace(settings, unit="km")
    assert measured([1500.0], drive(EAST), settings=km)[0].measure == pytest.approx(
        12.35 + sense * 1.5
    )


def test_the_measure_is_that_of_the_line_abreast_of_the_sign_beyond_the_ends_of_the_path_too():
    signs = measured([0, 333, 1000, 1030], drive(EAST), lines(MAIN=MAIN))
    assert [sign.route for sign in signs] == ["MAIN"] * 4
    wanted = [10.05, 10.383, 11.05, 11.08]
    assert [sign.measure for sign in signs] == pytest.approx(wanted, abs=1e-6)


def test_a_crossing_road_and_a_short_nearer_one_do_not_count():
    crossing = [(500, -300, 1.0), (500, 300, 2.0)]
    nearer = [(480, 0, 5.0), (520, 0, 6.0)]
    segments = lines(MAIN=MAIN, CROSS=crossing, RAMP=nearer)
    assert {sign.route for sign in measured([495, 500, 505], drive(EAST), segments)} == {"MAIN"}


def test_the_route_changes_where_the_path_turns_into_another():
    bend = [*EAST[:51], *((500.0, -10.0 * step) for step in range(1, 51))]
    segments = lines(MAIN=MAIN, SOUTH=[(502, 100, 0.0), (502, -600, 7.0)])
    found = measured([100, 450, 560, 900], drive(bend), segments)
    assert [sign.route for sign in found] == ["MAIN", "MAIN", "SOUTH", "SOUTH"]
    assert found[-1].measure == pytest.approx(5.0, abs=0.02)


def test_measures_that_fall_against_the_travel_and_gaps_of_the_lines_are_kept():
    falling = lines(MAIN=[(1050, 3, 0.0), (600, 3, 0.45), (-50, 3, math.nan)])
    found = measured([100, 700], drive(EAST), falling)
    assert found[0].route is None
    assert math.isnan(found[0].measure)
    assert found[1].measure == pytest.approx(0.35, abs=1e-6)


def test_a_path_far_from_every_line_or_on_no_globe_has_no_route():
    far = lines(FAR=[(0, 200, 0.0), (1000, 200, 1.0)])
    assert measured([500], drive(EAST), far) == [Placed(500.0)]
    nowhere = SimpleNamespace(stations={}, globe=None)
    assert measured([500], nowhere, lines(MAIN=MAIN)) == [Placed(500.0)]


@given(st.floats(-25, 25), st.floats(0, 1000), st.floats(0, 360))
def test_distances_are_those_on_the_sphere(offset, along, heading):
    east, north = math.sin(math.radians(heading)), math.cos(math.radians(heading))
    segments = lines(A=[(-100 * east, -100 * north, 0.0), (1100 * east, 1100 * north, 1200.0)])
    place = at(along * east + offset * north, along * north - offset * east)
    found = nearest_on_routes(np.array([place]), np.array([[east, north]]), segments)
    distance, measure = found
    assert distance[0, 0] == pytest.approx(abs(offset), abs=0.05)
    assert measure[0, 0] == pytest.approx(along + 100, abs=0.2)


@given(st.lists(st.tuples(*[st.floats(0, 60)] * 2), min_size=1, max_size=5))
def test_the_routes_that_are_followed_cost_least_of_all_sequences(rows):
    distance = np.array(rows)
    chosen = follow_routes(distance)
    none = (ROUTE_REACH_M / SIGMA_M) ** 2

    def cost(states):
        own = [none if s < 0 else (distance[i, s] / SIGMA_M) ** 2 for i, s in enumerate(states)]
        return sum(own) + CHANGE * sum(a != b for a, b in pairwise(states))

    every = np.stack(np.meshgrid(*[[-1, 0, 1]] * len(rows)), -1).reshape(-1, len(rows))
    assert cost(chosen.tolist()) == pytest.approx(min(cost(states) for states in every.tolist()))
