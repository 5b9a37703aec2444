"""Settings of the SIFT points of candidates (report chapter 5)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


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
