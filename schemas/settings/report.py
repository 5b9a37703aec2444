"""Settings of the outlines and SIFT points of candidates (report chapters 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting

_CHOSEN = "chosen by hand"


@dataclass(frozen=True, slots=True)
class RegionOutlineSettings:
    """Outlines of candidates for their shape class (report chapter 4)."""

    most: int = setting(
        200,
        "candidates",
        "candidates of an image that get an outline where shape is no gate, nearest colours first",
        origin="chosen by hand, to bound the time of an image",
        expert=True,
        low=1,
    )
    longest_edges: int = setting(
        20_000,
        "pixel edges",
        "regions with a longer outline get none",
        origin="no face is so ragged",
        expert=True,
        low=4,
    )
    longest_side_px: int = setting(
        64,
        "px",
        "larger boxes are sampled in steps, so that the longer side has at most twice as many samples",
        origin=_CHOSEN,
        expert=True,
        low=1,
    )
    margin: float = setting(
        0.15,
        "longer sides",
        "a box is enlarged by this, at least 2 px, to sample its surroundings",
        origin=_CHOSEN,
        expert=True,
        low=0,
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
