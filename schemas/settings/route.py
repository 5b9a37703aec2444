"""Settings of what is added after the drive: the place along a route, the roadside, the sign codes."""

from dataclasses import dataclass
from typing import Any

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
        False, "", "whether measures decrease in the direction of travel; with `milepost`"
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

    def measured(self, station_m: float) -> dict[str, Any]:
        """Route, measure and its unit so far along the path by the milepost, by the names of their columns."""
        along = (-1.0 if self.decreasing else 1.0) * station_m / MEASURE_UNITS[self.unit]
        unit = {"measure": self.milepost + along, "measure_unit": self.unit}
        return {"route": self.name or None} | unit


@dataclass(frozen=True, slots=True)
class RoadsideSettings:
    """Cross-sections of the road: height of the ground, edge of the travelled way, slopes."""

    on: bool = setting(False, "", "measure the ground and the painted lines along the path")


@dataclass(frozen=True, slots=True)
class CodeSettings:
    """The code of a sign, from all its measurements."""

    system: str = setting(
        "auto",
        "",
        "system of the signs: `us` (MUTCD), `vienna` (Vienna Convention), or `auto`: by the signs themselves",
        origin="a drive crosses no ocean",
        choices=("auto", "us", "vienna"),
    )
    settled: float = setting(
        0.9,
        "",
        "least probability to state a code, else the series it belongs to, else nothing",
        origin="at this probability, one stated code in ten is wrong",
        low=0.5,
        high=1,
    )
    size_sigmas: float = setting(
        2.0,
        "sigma",
        "a standard size is stated if width and height are this near",
        origin="95 % of normal errors",
        low=0,
    )
