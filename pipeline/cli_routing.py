"""Options of the command line for where along which route a drive lies. Heavy imports stand inside."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from wayside.pipeline.cli_help import ROUTE
from wayside.schemas.errors import UsageError

Route = Annotated[
    str | None,
    typer.Option(rich_help_panel=ROUTE, metavar="NAME", help='Route of the drive: "US-36 EB".'),
]
Milepost = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=ROUTE, help="Measure at the first used image: 12.35 (miles), 19.875km."
    ),
]
Decreasing = Annotated[
    bool,
    typer.Option(
        "--decreasing", rich_help_panel=ROUTE, help="Mileposts fall in the direction of travel."
    ),
]
Routes = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=ROUTE,
        metavar="FILE",
        help="Route lines with measures (M), GeoPackage or GeoParquet; needs fixes.",
    ),
]
_MEASURE = re.compile(r"(\d+\.?\d*|\.\d+)\s*([a-z]*)")


def options(
    route: str | None,
    milepost: str | None,
    decreasing: bool,
    routes: Path | None,
    logs: Sequence[Path],
) -> dict[str, Any]:
    """The options as settings, those given only; raises UsageError for what does not go together."""
    if milepost is not None and len(logs) > 1:
        raise UsageError(
            f"--milepost: wanted one log, as each begins elsewhere, found {len(logs)}; run them one by one"
        )
    given: dict[str, Any] = {} if milepost is None else parse_milepost(milepost)
    if route is not None:
        given["route.name"] = route
    if decreasing:
        given["route.decreasing"] = True
    if routes is not None:
        given["route.file"] = str(routes)
    return given


def parse_milepost(text: str) -> dict[str, Any]:
    """Measure and unit of a milepost as settings: "12.35" and "12.35mi" are miles, "19.875km" kilometres.

    Raises
    ------
    UsageError
        The text is no milepost.
    """
    from wayside.schemas.routes import MEASURE_UNITS

    found = _MEASURE.fullmatch(text.strip().lower())
    if found is None or (found[2] and found[2] not in MEASURE_UNITS):
        raise UsageError(
            f"--milepost: wanted a measure such as 12.35 (miles) or 19.875km, found {text!r}; units are "
            f"{', '.join(MEASURE_UNITS)}"
        )
    unit = {"route.unit": found[2]} if found[2] else {}
    return {"route.milepost": float(found[1]), **unit}
