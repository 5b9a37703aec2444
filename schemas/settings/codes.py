"""Settings of what sign it is."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class CodeSettings:
    """The code of a sign by all that was measured of it."""

    system: str = setting(
        "auto",
        "",
        "system that the signs are of: `us` (MUTCD), `vienna` (Vienna Convention), or `auto`: by the signs themselves",
        origin="a drive crosses no ocean",
        choices=("auto", "us", "vienna"),
    )
    settled: float = setting(
        0.9,
        "",
        "probability from which a code is stated, else the series it belongs to, else nothing",
        origin="one stated code in ten may be wrong at the least sure",
        low=0.5,
        high=1,
    )
    size_sigmas: float = setting(
        2.0,
        "sigma",
        "a standard size is stated where width and height are this near",
        origin="95 % of normal errors",
        low=0,
    )
