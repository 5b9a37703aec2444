"""What rules can ask of a sign: columns of its row, and what follows from several of them, each with its error."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import pyarrow as pa

from wayside.schemas.sign_catalogue import SERIES, US
from wayside.schemas.tables import SIGNS

Row = Mapping[str, Any]
MISSED = 0.03
"""Share of signs that a run misses (7 of 272 on held-out drives): the next one found need not be the next one."""


class Measured(NamedTuple):
    """A quantity of a sign: its value with standard deviation, or what is missing to know it."""

    value: float = math.nan
    sigma: float = 0.0
    missing: str = ""
    less: float = 0.0
    """Probability that it is less than the value by more than its error."""


def measure(name: str, row: Row, rows: Sequence[Row]) -> Measured:
    """A quantity of a sign, of the rows of its drive; of a column without a column `sigma_...` the value is exact."""
    if name in DERIVED:
        return DERIVED[name](row, rows)
    found = _known(row[name], row.get(f"sigma_{name}", 0.0), name)
    return found._replace(less=MISSED if name == "spacing_m" else 0.0)


def _known(value: float | None, sigma: float | None, what: str, scale: float = 1.0) -> Measured:
    if value is None or sigma is None:
        return Measured(missing=what)
    return Measured(scale * value, scale * sigma)


def _extent(axis: str, row: Row, rows: Sequence[Row]) -> Measured:
    """Width or height as the tables of sizes have it: of a diamond the side of its square."""
    scale = math.sqrt(0.5) if row["shape"] == "diamond" else 1.0
    name = f"panel_{axis}_m"
    return _known(row[name], row[f"sigma_{axis}_m"], name, scale)


def _offset(row: Row, rows: Sequence[Row]) -> Measured:
    """From the edge of the travelled way to the near edge of the panel; unknown where no edge was seen."""
    edge = "the edge of the travelled way"
    return _known(row.get("offset_edge_m"), row.get("sigma_offset_edge_m"), edge)


def _curve_radius(row: Row, rows: Sequence[Row]) -> Measured:
    """Radius of the curve of a sign and the next of its type: the smaller one, as a curve begins and ends wider."""
    after = next((other for other in rows if other["sign_id"] == row["next_sign_id"]), row)
    known = [one for one in (row, after) if one["radius_m"] is not None]
    if not known:
        return Measured(missing="a curve")
    sharpest = min(known, key=lambda one: abs(float(one["radius_m"])))
    return Measured(abs(sharpest["radius_m"]), sharpest["sigma_radius_m"])


def _pair(row: Row, rows: Sequence[Row]) -> Measured:
    """Distance along the path to the nearest sign of the same type on the other side."""
    if row["station_m"] is None or row["lateral_m"] is None:
        return Measured(missing="its place on the path")
    across = [
        (abs(float(other["station_m"] - row["station_m"])), other["sigma_along_m"] or 0.0)
        for other in rows
        if _type_of(other) == _type_of(row)
        and other["station_m"] is not None
        and ((other["lateral_m"] or 0.0) > 0) != (row["lateral_m"] > 0)
    ]
    if not across:
        return Measured(missing="one of its type on the other side")
    apart, sigma = min(across)
    return Measured(apart, math.hypot(row["sigma_along_m"] or 0.0, sigma), less=MISSED)


def _type_of(row: Row) -> tuple[str | None, ...]:
    code = row["mutcd"] or row["vienna"]
    return (code,) if code and code not in SERIES[US] else (row["color"], row["shape"])


DERIVED: dict[str, Callable[[Row, Sequence[Row]], Measured]] = {
    "width_m": partial(_extent, "width"),
    "height_m": partial(_extent, "height"),
    "offset_m": _offset,
    "curve_radius_m": _curve_radius,
    "pair_m": _pair,
}
_NUMBERS = (pa.types.is_floating, pa.types.is_integer)
KNOWN_QUANTITIES = (*DERIVED, *(c.name for c in SIGNS.columns if any(f(c.type) for f in _NUMBERS)))
"""Those, and all columns of numbers."""
