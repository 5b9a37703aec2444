"""What covers the ground across the road: zones of materials and painted lines."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.drives.arrays import Floats, Singles
from recordings.drives.paint.texture import linear
from recordings.drives.spec import RoadSpec

LEFT_FIELD, RIGHT_FIELD = -1, -2
"""Zones whose material changes from field to field along the road."""

FIELDS = ("wheat", "crop", "soil", "pasture", "pasture", "wheat")

_DASH_M, _PERIOD_M = 3.05, 12.2


@dataclass(frozen=True, slots=True)
class Material:
    """Ground cover: base colour (linear), second colour, noise strength fine / middle / coarse."""

    color: Singles
    other: Singles
    fine: float
    middle: float
    coarse: float

    def row(self) -> Floats:
        """All nine numbers."""
        return np.concatenate([self.color, self.other, [self.fine, self.middle, self.coarse]])


@dataclass(frozen=True, slots=True)
class Marking:
    """Painted line at offset t: half width, colour, dash length and period (0 for a solid line), m."""

    offset: float
    half_width: float
    color: Singles
    dash: float = 0.0
    period: float = 0.0


def materials(season: float) -> dict[str, Material]:
    """All ground covers; grass and pasture turn from lush (season 0) to dry (1)."""

    def mix(lush: Singles, dry: Singles) -> Singles:
        return lush * (1 - season) + dry * season

    grass = mix(linear(104, 112, 66), linear(172, 152, 104))
    dark_grass = mix(linear(74, 88, 48), linear(134, 120, 78))
    lawn = mix(linear(84, 118, 48), linear(150, 142, 82))
    pasture = mix(linear(104, 122, 58), linear(180, 158, 104))
    dark_pasture = mix(linear(84, 104, 46), linear(150, 134, 84))
    return {
        "asphalt": Material(linear(136, 135, 132), linear(112, 112, 111), 0.24, 0.05, 0.12),
        "concrete": Material(linear(172, 168, 158), linear(150, 146, 138), 0.10, 0.06, 0.08),
        "gravel": Material(linear(168, 154, 130), linear(134, 122, 104), 0.30, 0.14, 0.10),
        "grass": Material(grass, dark_grass, 0.22, 0.3, 0.45),
        "lawn": Material(lawn, linear(70, 98, 42), 0.2, 0.16, 0.2),
        "litter": Material(linear(96, 84, 52), linear(64, 78, 36), 0.3, 0.35, 0.4),
        "wheat": Material(linear(204, 172, 102), linear(172, 142, 78), 0.14, 0.2, 0.2),
        "crop": Material(linear(84, 110, 58), linear(64, 88, 46), 0.2, 0.25, 0.15),
        "soil": Material(linear(118, 92, 70), linear(96, 74, 56), 0.2, 0.3, 0.2),
        "pasture": Material(pasture, dark_pasture, 0.2, 0.3, 0.45),
    }


def zones(road: RoadSpec, names: list[str]) -> tuple[Singles, NDArray[np.int64]]:
    """Offsets (n,) where the ground cover changes, and the covers (n + 1,) between them.

    A cover is an index of `names`, or LEFT_FIELD or RIGHT_FIELD.
    """
    covers, limits = _PLANS[road.kind] if road.kind != "two_lane" else _two_lane(road.shoulder_m)
    fields = {"left": LEFT_FIELD, "right": RIGHT_FIELD}
    indices = [fields[name] if name in fields else names.index(name) for name in covers.split()]
    return np.array(limits, np.float32), np.array(indices)


def _two_lane(shoulder_m: float) -> tuple[str, tuple[float, ...]]:
    edge = 3.6 + shoulder_m
    right = (edge, edge + 1.1, 14)
    return (
        "left grass gravel asphalt gravel grass right",
        (*(-limit for limit in reversed(right)), *right),
    )


_PLANS: dict[str, tuple[str, tuple[float, ...]]] = {
    "forest": (
        "litter grass gravel asphalt gravel grass litter",
        (-8.5, -4.5, -3.95, 3.95, 4.5, 8.5),
    ),
    "four_lane": (
        "left grass gravel asphalt gravel grass gravel asphalt gravel grass right",
        (-38, -32, -31, -20, -19.2, -5.7, -5.0, 6.6, 7.3, 17),
    ),
    "street": ("lawn concrete asphalt concrete lawn", (-8.3, -6.0, 6.0, 8.3)),
}
"""Covers from left to right, and the offsets (m) between them."""


def markings(road: RoadSpec) -> list[Marking]:
    """Painted lines of a road: white at the edges, yellow between directions."""
    white, yellow = linear(214, 214, 208), linear(214, 168, 40)
    if road.kind == "four_lane":
        return [
            Marking(3.55, 0.06, white),
            Marking(-3.55, 0.06, yellow),
            Marking(0.0, 0.06, white, _DASH_M, _PERIOD_M),
            Marking(-21.6, 0.06, yellow),
            Marking(-28.7, 0.06, white),
            Marking(-25.1, 0.06, white, _DASH_M, _PERIOD_M),
        ]
    centre = {
        "dashed": [Marking(0.0, 0.055, yellow, _DASH_M, _PERIOD_M)],
        "solid": [
            Marking(-0.11, 0.055, yellow, _DASH_M, _PERIOD_M),
            Marking(0.11, 0.055, yellow),
        ],
        "double": [Marking(-0.12, 0.055, yellow), Marking(0.12, 0.055, yellow)],
    }[road.centre_line]
    if road.kind == "street":
        return centre
    return [*centre, Marking(3.5, 0.06, white), Marking(-3.5, 0.06, white)]
