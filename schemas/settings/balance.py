"""Settings of the white balance."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class BalanceSettings:
    """White balance by the road, whose asphalt is grey."""

    on: bool = setting(True, "", "take the colour that the road has in an image from all of it")
    road_from: float = setting(
        0.1, "tangent", "the road is looked for so far below the optical axis", expert=True
    )
    road_until: float = setting(
        0.95,
        "",
        "down to this fraction of the height of the image",
        origin="bonnets and what recorders write into images lie below",
        expert=True,
        low=0,
        high=1,
    )
    tolerance: float = setting(
        0.18,
        "log ratio",
        "so much colour, red and blue against green together, a road may have; more is a cast, and is taken out whole",
        origin="nine of ten images of each of six real drives show at most 0.16, of rendered ones 0.07",
        expert=True,
        low=0,
    )
    largest: float = setting(
        0.3,
        "log ratio",
        "no more is taken out: a road of earth or brick has a colour of its own",
        expert=True,
        low=0,
    )
