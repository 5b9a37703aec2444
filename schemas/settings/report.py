"""Settings of what only the report's chain has: its gates, and the SIFT points of candidates (chapters 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class ReportSettings:
    """The report's own chain, and the gates that it built and replaced; its last one is `locate.gate`."""

    on: bool = setting(False, "", "the chain of the report, which its presets switch on")
    shape: bool = setting(
        False, "", "after the colour: refuse regions whose outline is of no shape (chapter 4)"
    )
    trajectory: str = setting(
        "off",
        "",
        "refuse tracks that do not move as signs do (chapter 5): image: by u, v, du, dv as in the report; compensated: "
        "with the rotation of the camera taken out",
        choices=("off", "image", "compensated"),
    )


@dataclass(frozen=True, slots=True)
class SiftSettings:
    """SIFT points on candidates and their matching (report chapter 5)."""

    margin_px: int = setting(
        3,
        "px",
        "points so far outside the box of a candidate belong to it",
        origin="a face's own corners lie on its border",
        expert=True,
        low=0,
    )
    ratio: float = setting(
        0.8,
        "",
        "largest distance to the nearest descriptor over that to the second nearest",
        origin="Lowe 2004",
        expert=True,
        low=0,
        high=1,
    )
