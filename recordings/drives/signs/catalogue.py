"""Groups of signs that a specification can ask for."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from recordings.drives.signs import europe, guide, regulatory, routes, warning
from recordings.drives.signs.face import Face
from recordings.drives.signs.invented import invented

Assembly: TypeAlias = list[tuple[Face, float]]
"""Panels of one support, top to bottom, each with the gap (m) above it."""

_Maker: TypeAlias = Callable[[np.random.Generator], Face]
_Group: TypeAlias = Callable[[np.random.Generator], Assembly]


def _stack(*makers: _Maker, gap: float = 0.0) -> _Group:
    """Panels below each other with equal gaps."""
    return lambda rng: [(maker(rng), gap if i else 0.0) for i, maker in enumerate(makers)]


def _either(share: float, first: _Group, second: _Group) -> _Group:
    """The first group in a fraction of the cases, else the second."""
    return lambda rng: first(rng) if rng.random() < share else second(rng)


def _regulatory(rng: np.random.Generator) -> Assembly:
    makers = (regulatory.regulatory_text, regulatory.regulatory_text, regulatory.keep_right)
    return [(makers[int(rng.integers(3))](rng), 0.0)]


def _route(rng: np.random.Generator) -> Assembly:
    makers = (*(routes.us_route,) * 2, routes.state_route, routes.interstate, routes.county_route)
    shield = makers[int(rng.integers(5))](rng)
    panels = [(routes.route_plaque(rng), 0.0), (shield, 0.02)]
    if rng.random() < 0.6:
        panels.append((routes.route_arrow(rng), 0.02))
    return panels


GROUPS: dict[str, _Group] = {
    "stop": _stack(regulatory.stop),
    "stop_named": _stack(guide.street_name, regulatory.stop, gap=0.02),
    "yield": _stack(regulatory.yield_sign),
    "speed": _stack(regulatory.speed_limit),
    "regulatory": _regulatory,
    "no_parking": _stack(regulatory.no_parking),
    "do_not_enter": _either(
        0.5,
        _stack(regulatory.do_not_enter),
        _stack(regulatory.do_not_enter, regulatory.wrong_way, gap=0.05),
    ),
    "warning": _stack(warning.warning),
    "warning_speed": _stack(warning.warning, warning.advisory, gap=0.03),
    "large_arrow": _stack(warning.large_arrow),
    "pennant": _stack(warning.no_passing_pennant),
    "rail": _stack(warning.rail_advance),
    "crossbuck": _either(
        0.5, _stack(regulatory.crossbuck, regulatory.tracks_plaque), _stack(regulatory.crossbuck)
    ),
    "school": _stack(warning.school, warning.school_plaque, gap=0.02),
    "school_speed": _stack(warning.school_plaque, regulatory.speed_limit, gap=0.01),
    "pedestrian": _stack(warning.pedestrian),
    "work": _either(0.65, _stack(warning.work_diamond), _stack(warning.work_panel)),
    "distances": _stack(guide.guide_distances),
    "destination": _stack(guide.guide_destination),
    "guide_large": _stack(guide.guide_large),
    "street_name": _stack(guide.street_name),
    "city_limit": _stack(guide.city_limit),
    "mile_post": _stack(guide.mile_post),
    "service": _stack(guide.service),
    "service_large": _stack(guide.service_large),
    "recreation": _stack(guide.recreation),
    "route": _route,
    "object_marker": _stack(warning.object_marker),
    "eu_limit": _either(
        0.6, _stack(europe.eu_limit), _stack(europe.eu_no_overtaking, europe.eu_limit, gap=0.03)
    ),
    "eu_warning": _either(
        0.6, _stack(europe.eu_warning), _stack(europe.eu_warning, europe.eu_limit, gap=0.03)
    ),
    "eu_give_way": _stack(europe.eu_give_way),
    "eu_priority": _stack(europe.eu_priority),
    "eu_no_entry": _stack(europe.eu_no_entry),
    "eu_mandatory": _stack(europe.eu_mandatory),
    "eu_blue": _either(0.5, _stack(europe.eu_crossing), _stack(europe.eu_parking)),
    "eu_town": _stack(europe.eu_town),
    "eu_town_end": _stack(europe.eu_town_end),
    "eu_beacon": _either(
        0.6, _stack(europe.eu_beacon), _stack(europe.eu_warning, europe.eu_beacon, gap=0.4)
    ),
    "eu_board": _stack(europe.eu_board),
    "invented": _either(0.7, _stack(invented), _stack(invented, invented, gap=0.03)),
}
"""Name of a group -> the panels of one assembly."""
