"""Places signs: forward, opposite and special assemblies along the drive."""

from collections.abc import Mapping

import numpy as np

from recordings.drives.layout.assembly import Assembler, Place, widest
from recordings.drives.layout.placing import LayoutPlan
from recordings.drives.paint.roadside import rod, truss
from recordings.drives.parts import UP, Part, Quad, Sprite
from recordings.drives.signs.catalogue import GROUPS, Assembly
from recordings.drives.signs.guide import gantry_panel
from recordings.drives.signs.warning import chevron

_EDGE_M = {"street": 6.7, "forest": 5.8, "four_lane": 7.4, "two_lane": 5.6}
_FAR_EDGE_M = {**_EDGE_M, "four_lane": 23.0}
_VERGE_M = {"street": 1.6, "forest": 2.0, "four_lane": 5.0, "two_lane": 5.0}
_MEDIAN_M = -7.5
_SIGNS_BEYOND_M = 45.0
_CHEVRON_SPACING_M = 26.0
_GANTRY_LEVEL_M = 7.2
_GANTRY_STEEL = (150, 154, 156)
_REPEAT = 0.12
"""Weight of a group is multiplied by this for every time it was placed before."""


class _Deck:
    """Draws groups of signs by weight, seldom the same one twice."""

    def __init__(self, weights: Mapping[str, float]) -> None:
        self._weights = {name: weight for name, weight in weights.items() if weight > 0}
        self._used = dict.fromkeys(self._weights, 0)

    def draw(self, rng: np.random.Generator) -> Assembly:
        """Panels of the group that is drawn."""
        names = list(self._weights)
        weights = np.array([self._weights[n] * _REPEAT ** self._used[n] for n in names])
        name = names[int(rng.choice(len(names), p=weights / weights.sum()))]
        self._used[name] += 1
        return GROUPS[name](rng)


def place_signs(plan: LayoutPlan, assembler: Assembler) -> None:
    """Place every sign of a drive."""
    rng, road = plan.rng(0), plan.spec.road
    _along_the_road(plan, assembler, rng)
    if plan.spec.signs.chevrons:
        _chevrons(plan, assembler)
    for where in road.side_roads:
        _, right, _ = plan.road.axes(where)
        panels = GROUPS["stop"](rng)
        place = Place(where - 6.0, _EDGE_M[road.kind] + 2.5, right, forward=False)
        assembler.put_up(plan.rng(10), panels, place)
    for where in road.gantries:
        _gantry(plan, assembler, where)


def _along_the_road(plan: LayoutPlan, assembler: Assembler, rng: np.random.Generator) -> None:
    """Signs for the travelled direction on the right, some on the left, and the backs of the other direction."""
    mix, kind = plan.spec.signs, plan.spec.road.kind
    forward_deck, backward_deck = _Deck(mix.groups), _Deck(mix.groups)
    blocked = [*plan.spec.road.bridges, *plan.spec.road.gantries]
    station = mix.first_m
    while station < plan.end + _SIGNS_BEYOND_M:
        panels = forward_deck.draw(rng)
        wide = widest(panels)
        on_left = rng.random() < mix.left_share and wide < 1.3
        offset = _EDGE_M[kind] + rng.uniform(0, _VERGE_M[kind]) + wide / 2
        if on_left:
            offset = _MEDIAN_M if kind == "four_lane" else -offset
        elif mix.setback_m > 0:
            offset += mix.setback_m * rng.random() ** 2
        if all(abs(station - b) > 6 for b in blocked):
            normal = -plan.road.level_forward(station)
            assembler.put_up(rng, panels, Place(station, offset, normal, forward=True))
        if rng.random() < mix.back_share:
            panels = backward_deck.draw(rng)
            where = station + rng.uniform(6, max(7.0, mix.spacing_m - 6))
            offset = _FAR_EDGE_M[kind] + rng.uniform(0, _VERGE_M[kind]) + widest(panels) / 2
            normal = plan.road.level_forward(where)
            assembler.put_up(rng, panels, Place(where, -offset, normal, forward=False))
        station += mix.spacing_m * rng.uniform(0.65, 1.35)


def _chevrons(plan: LayoutPlan, assembler: Assembler) -> None:
    """Chevrons on the outside of sharp curves."""
    road, rng = plan.road, plan.rng(11)
    for station in np.arange(30.0, plan.end + 40, _CHEVRON_SPACING_M):
        curvature = float(road.at(road.curvature, station))
        if abs(curvature) > 1 / 420:
            turns_right = curvature > 0
            normal = -road.level_forward(station - 14)
            place = Place(station, -6.3 if turns_right else 6.3, normal, forward=True)
            assembler.put_up(rng, [(chevron(turns_right), 0.0)], place)


def _gantry(plan: LayoutPlan, assembler: Assembler, station: float) -> None:
    """Overhead truss with one or two panels."""
    rng, road = plan.rng(int(station) + 1000), plan.road
    left, right = (-8.5, 9.0) if plan.spec.road.kind == "four_lane" else (-8.0, 8.0)
    ends = [road.surface(station + 0.35, t) for t in (left, right)]
    level = float(road.surface(station, road.travel_offset_m)[2]) + _GANTRY_LEVEL_M
    span = ends[1] - ends[0]
    parts: list[Part] = [
        Sprite(end, UP * (level - end[2]), 0.4, rod(_GANTRY_STEEL)) for end in ends
    ]
    corner, across = np.array([*ends[0][:2], level]), np.array([span[0], span[1], 0])
    parts.append(Quad(corner, across, -UP * 1.2, truss(), two_sided=True))
    plan.add("gantry", road.surface(station + 0.35, 0.0), parts)
    normal = -road.level_forward(station)
    for offset in (-2.3, 2.3) if rng.random() < 0.7 else (2.0,):
        panels = [(gantry_panel(rng), 0.0)]
        overhead = float(rng.uniform(5.2, 5.5))
        place = Place(station, offset, normal, forward=True, overhead_m=overhead)
        assembler.put_up(rng, panels, place)
