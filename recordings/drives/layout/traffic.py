"""Places parked and moving vehicles."""

from dataclasses import dataclass

import numpy as np

from recordings.drives.layout.placing import LayoutPlan
from recordings.drives.paint.vehicles import VehicleStyle, vehicle
from recordings.drives.scene import Mover
from recordings.drives.solids import Stand, vehicle_group

_KINDS = (
    *("car", "car", "pickup", "pickup", "van"),
    *("truck", "school_bus", "tractor", "car", "car"),
)
_QUICK_KINDS = 5
"""The first so many can overtake."""
_PARKING_M = 15.0
_LEFT_LANE_M = -1.8


@dataclass(frozen=True, slots=True)
class _Fleet:
    """Vehicles to choose from, and the stream that chooses."""

    plan: LayoutPlan
    rng: np.random.Generator
    styles: list[VehicleStyle]

    def pick(self) -> VehicleStyle:
        """Any of the vehicles."""
        return self.styles[int(self.rng.integers(len(self.styles)))]

    def drive(self, style: VehicleStyle, start: Stand, speed: float) -> None:
        """Set a vehicle in motion."""
        self.plan.movers.append(Mover(self.plan.name(style.kind), style, start, speed))


def place_traffic(plan: LayoutPlan) -> None:
    """Place all vehicles."""
    rng = plan.rng(25)
    fleet = _Fleet(plan, rng, [vehicle(rng, kind) for kind in _KINDS])
    _parked(fleet)
    _oncoming(fleet)
    _leading(fleet)
    if plan.spec.road.kind in ("four_lane", "two_lane"):
        _overtaking(fleet)


def _parked(fleet: _Fleet) -> None:
    """Vehicles at rest on both sides, not inside each other."""
    plan, rng, kind = fleet.plan, fleet.rng, fleet.plan.spec.road.kind
    free = {True: -50.0, False: -50.0}
    for s in plan.spread(rng, plan.spec.scene.parked, 80.0):
        on_right = rng.random() < 0.6
        station = max(s, free[on_right])
        free[on_right] = station + _PARKING_M
        yard = rng.uniform(0, 14)
        if on_right:
            offset = {"street": 4.9, "four_lane": 5.3}.get(kind, 13.0 + yard)
        else:
            offset = {"street": -4.9, "four_lane": -29.9}.get(kind, -13.0 - yard)
        style = fleet.pick()
        stand = Stand(station, offset, 1 if on_right else -1)
        plan.groups.append(vehicle_group(plan.road, style, stand, plan.name(style.kind)))


def _oncoming(fleet: _Fleet) -> None:
    """Vehicles that come towards the camera in their lanes."""
    plan, rng, kind = fleet.plan, fleet.rng, fleet.plan.spec.road.kind
    speed, seconds = plan.spec.path.speed_mps, plan.end / plan.spec.path.speed_mps
    lanes = {"four_lane": (-23.3, -26.9), "street": (-1.9,)}.get(kind, (-1.8,))
    last = dict.fromkeys(lanes, 0.0)
    density = plan.spec.scene.oncoming * (1 if kind == "street" else 2)
    for s in plan.spread(rng, density, speed * seconds + 200):
        style, lane = fleet.pick(), lanes[int(rng.integers(len(lanes)))]
        last[lane] = max(s + 20, last[lane] + 30)
        fleet.drive(style, Stand(last[lane], lane, -1), -speed * 0.97)


def _leading(fleet: _Fleet) -> None:
    """Vehicles ahead of the camera, a little faster."""
    plan, rng = fleet.plan, fleet.rng
    gap = 32.0
    for _ in range(plan.spec.scene.leading):
        style = fleet.pick()
        gap += rng.uniform(8, 30)
        aside = plan.spec.road.kind == "four_lane" and rng.random() < 0.5
        offset = _LEFT_LANE_M if aside else plan.road.travel_offset_m
        speed = plan.spec.path.speed_mps * rng.uniform(1.0, 1.06)
        fleet.drive(style, Stand(gap, offset, 1), speed)
        gap += 20


def _overtaking(fleet: _Fleet) -> None:
    """Vehicles that start behind the camera and pass it on the left."""
    rng, speed = fleet.rng, fleet.plan.spec.path.speed_mps
    for _ in range(fleet.plan.spec.scene.overtaking):
        style = fleet.styles[int(rng.integers(_QUICK_KINDS))]
        start = Stand(-rng.uniform(25, 70), _LEFT_LANE_M, 1)
        fleet.drive(style, start, speed * rng.uniform(1.25, 1.4))
