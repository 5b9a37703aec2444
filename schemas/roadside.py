"""The ground and the lines across the road, at stations along the route, and what signs stand on."""

from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

GROUND_STATUSES = {
    "ground": "measured",
    "hidden": "the images agree on no height (plants, a rail, a vehicle in front, nothing to compare)",
    "unseen": "no two images show it",
}
"""What is known of the ground at one offset."""
SIDES = ("left", "right")
"""Of the path, in the direction of travel."""

POST_KINDS = {
    "wood": "wooden post",
    "round_metal": "metal tube",
    "u_channel": "steel channel, open to one side",
    "steel_beam": "steel beam with flanges",
    "pole": "thicker pole, as of a lamp or of wires",
    "gantry": "no post below: the panel hangs over the road",
    "unknown": "hidden, or not certain",
}
"""Kinds of posts."""


@dataclass(frozen=True, slots=True)
class Posts:
    """What a panel stands on."""

    kind: str = "unknown"
    """A key of `POST_KINDS`."""
    probability: float = nan
    """Of the kind. nan: not by the look of a post."""
    number: int = 0
    """Of the posts that are seen."""
    width_m: float = nan
    """Of one of them, the mean. nan: none is seen."""
    sigma_width_m: float = nan
    """Standard deviation of the width."""
    views: int = 0
    """Images that show them."""


@dataclass(frozen=True, slots=True)
class Roadside:
    """One side of the road abreast of a station. Offsets are metres from the path, outwards; nan: not found."""

    line_m: float = nan
    """Of the nearest painted line."""
    edge_m: float = nan
    """Of the edge of the travelled way: the outermost solid line."""
    shoulder_m: float = nan
    """Of the break where the ground begins to fall or rise faster: the outer edge of the shoulder."""
    ditch_m: float = nan
    """Of the bottom of the ditch, or the foot of a bank."""
    ditch_height_m: float = nan
    """Height of the ground there, above the road."""
    fore_slope: float = nan
    """Of the ground from the shoulder to the ditch, rise over run; below 0 it falls away from the road."""
    back_slope: float = nan
    """Of the ground beyond the ditch."""


@dataclass(frozen=True, slots=True)
class CrossSection:
    """The ground across the road abreast of a station, n offsets, from left to right."""

    station_m: float
    """Along the travelled path."""
    frame: int
    """Last used frame before it."""
    camera_m: float
    """Height of the camera above the road, the same all the drive. nan: unknown."""
    offset_m: NDArray[np.float64]
    """To the right of the path, (n,)."""
    height_m: NDArray[np.float64]
    """Above the road below the camera, (n,). nan: unseen."""
    sigma_m: NDArray[np.float64]
    """Standard deviation of the height, (n,)."""
    pairs: NDArray[np.int64]
    """Pairs of images that were compared, (n,)."""
    status: tuple[str, ...]
    """A key of `GROUND_STATUSES` each."""
    points: NDArray[np.float64] = field(repr=False)
    """In the world frame, (n, 3), metres."""
    sides: tuple[Roadside, Roadside]
    """Left and right."""

    @property
    def lane_width_m(self) -> float:
        """Between the nearest lines of both sides. nan: one is not seen."""
        return self.sides[0].line_m + self.sides[1].line_m
