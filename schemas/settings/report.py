"""Settings of the outlines and SIFT points of candidates (report chapters 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class RegionOutlineSettings:
    """Outlines of candidates for their shape class (report chapter 4)."""

    longest_edges: int = setting(
        20_000,
        "pixel edges",
        "regions with a longer outline get none",
        origin="no face is so ragged",
        expert=True,
        low=4,
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
