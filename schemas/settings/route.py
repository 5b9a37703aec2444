"""Settings of where along which route a sign stands."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.routes import MEASURE_UNITS
from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class RouteSettings:
    """Linear referencing: the measure along a route, by a milepost at the start or by route lines with measures."""

    name: str = setting(
        "", "", "route that the drive follows; empty with `file`: found by the path, else none"
    )
    milepost: float = setting(
        -1.0, "", "measure at the first used image, in `unit`; below 0: not known", low=-1
    )
    decreasing: bool = setting(
        False, "", "whether measures fall in the direction of travel; with `milepost`"
    )
    unit: str = setting(
        "mi",
        "",
        "unit of `milepost` and of the measures in `file`: miles, kilometres, feet, metres",
        choices=tuple(MEASURE_UNITS),
    )
    file: str = setting(
        "", "file", "route lines with measures (M): GeoPackage, GeoParquet or what GDAL reads"
    )
    column: str = setting(
        "", "", "column of `file` that names the route; empty: the first of the usual names"
    )
    reach_m: float = setting(
        30.0,
        "m",
        "the path is on a route only where its line is so near",
        origin="lines of a road in one, lanes of 3.7 m: half of eight lanes with a median, and 5 m of fix and line",
        expert=True,
        low=1,
    )
    angle_deg: float = setting(
        30.0,
        "deg",
        "and where it runs within this angle of the travel, in either direction",
        origin="crossing roads meet at more, ramps leave at less",
        expert=True,
        low=1,
        high=90,
    )
    sigma_m: float = setting(
        8.0,
        "m",
        "scatter of the path about the line of its route",
        origin="two lanes, and the scatter of fix and line",
        expert=True,
        low=0.1,
    )
    change: float = setting(
        25.0,
        "",
        "squared standard deviations that a change of route costs: a shorter stretch of a nearer line is ignored",
        origin="five standard deviations: crossing roads and ramps that run along are left out",
        expert=True,
        low=0,
    )
