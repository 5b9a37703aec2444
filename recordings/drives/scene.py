"""Everything that can be seen in one drive."""

from collections.abc import Iterator
from dataclasses import dataclass

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Singles
from recordings.drives.paint.vehicles import VehicleStyle
from recordings.drives.parts import Group, PlacedSign
from recordings.drives.solids import Stand, vehicle_group


@dataclass(frozen=True, slots=True)
class Mover:
    """Vehicle that drives along the road at constant speed."""

    name: str
    style: VehicleStyle
    start: Stand  # at the time of the first image
    speed: float  # m/s along the stations


@dataclass(frozen=True, slots=True)
class Scene:
    """Road, signs, standing groups and moving vehicles."""

    road: RoadAlignment
    signs: list[PlacedSign]
    groups: list[Group]
    movers: list[Mover]
    dapple: Singles | None  # tile of light through leaves, 1 where it is full

    def groups_at(self, seconds: float) -> Iterator[Group]:
        """All groups at a time after the first image."""
        yield from self.groups
        for mover in self.movers:
            station = mover.start.station + mover.speed * seconds
            if -50 < station < self.road.station[-1] - 10:
                stand = Stand(station, mover.start.offset, mover.start.heading)
                yield vehicle_group(self.road, mover.style, stand, mover.name)
