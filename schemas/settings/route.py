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
