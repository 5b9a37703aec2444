"""What all concerns of the layout share: the drive, its random streams and the growing lists."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Floats
from recordings.drives.parts import Group, Part, PlacedSign
from recordings.drives.scene import Mover
from recordings.drives.spec import DriveSpec

VIEW_BEYOND_M = 420.0
LISTED_REACH_M = 500.0


@dataclass
class LayoutPlan:
    """A layout in the making.

    Every concern draws from a random stream of its own, so that densities do not move the signs.
    """

    spec: DriveSpec
    road: RoadAlignment
    end: float  # station of the last image, m
    signs: list[PlacedSign] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    movers: list[Mover] = field(default_factory=list)
    assemblies: int = 0
    names: int = 0

    def rng(self, concern: int) -> np.random.Generator:
        """Fresh random stream of a concern."""
        return np.random.default_rng([self.spec.seed, 100 + concern])

    def name(self, kind: str) -> str:
        """Next identifier of a distractor."""
        self.names += 1
        return f"{kind}-{self.names:04d}"

    def add(
        self, kind: str, anchor: Floats, parts: Sequence[Part], reach_m: float = LISTED_REACH_M
    ) -> None:
        """Add a group that the truth lists as a distractor."""
        self.groups.append(Group(kind, anchor, list(parts), self.name(kind), reach_m))

    def add_unlisted(
        self, kind: str, anchor: Floats, parts: Sequence[Part], reach_m: float
    ) -> None:
        """Add a group that the truth does not list."""
        self.groups.append(Group(kind, anchor, list(parts), "", reach_m))

    def spread(
        self, rng: np.random.Generator, per_100m: float, beyond: float = VIEW_BEYOND_M
    ) -> Floats:
        """Random stations at a density, in order, up to a distance beyond the last image."""
        length = self.end + beyond
        return np.sort(rng.uniform(-10, length, round(per_100m * length / 100)))

    def clear_of_side_roads(self, station: float, margin: float = 9.0) -> bool:
        """Whether a station lies farther than a margin from every side road."""
        return all(abs(station - s) > margin for s in self.spec.road.side_roads)
