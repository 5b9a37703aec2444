"""Groups of signs that a specification can ask for."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from recordings.drives.signs.europe import (
    eu_beacon,
    eu_board,
    eu_crossing,
    eu_give_way,
    eu_limit,
    eu_mandatory,
    eu_no_entry,
    eu_no_overtaking,
    eu_parking,
    eu_priority,
    eu_town,
    eu_town_end,
    eu_warning,
)
from recordings.drives.signs.face import Face
from recordings.drives.signs.guide import (
    city_limit,
    guide_destination,
    guide_distances,
    guide_large,
    mile_post,
    recreation,
    service,
    service_large,
    street_name,
)
from recordings.drives.signs.invented import invented
from recordings.drives.signs.regulatory import (
    crossbuck,
    do_not_enter,
    keep_right,
    no_parking,
    regulatory_text,
    speed_limit,
    stop,
    tracks_plaque,
    wrong_way,
    yield_sign,
)
from recordings.drives.signs.routes import (
    county_route,
    interstate,
    route_arrow,
    route_plaque,
    state_route,
    us_route,
)
from recordings.drives.signs.warning import (
    advisory,
    large_arrow,
    no_passing_pennant,
    object_marker,
    pedestrian,
    rail_advance,
    school,
    school_plaque,
    warning,
    work_diamond,
    work_panel,
)

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
    makers = (regulatory_text, regulatory_text, keep_right)
    return [(makers[int(rng.integers(3))](rng), 0.0)]


def _route(rng: np.random.Generator) -> Assembly:
    makers = (us_route, us_route, state_route, interstate, county_route)
    shield = makers[int(rng.integers(5))](rng)
    panels = [(route_plaque(rng), 0.0), (shield, 0.02)]
    if rng.random() < 0.6:
        panels.append((route_arrow(rng), 0.02))
    return panels


GROUPS: dict[str, _Group] = {
    "stop": _stack(stop),
    "stop_named": _stack(street_name, stop, gap=0.02),
    "yield": _stack(yield_sign),
    "speed": _stack(speed_limit),
    "regulatory": _regulatory,
    "no_parking": _stack(no_parking),
    "do_not_enter": _either(0.5, _stack(do_not_enter), _stack(do_not_enter, wrong_way, gap=0.05)),
    "warning": _stack(warning),
    "warning_speed": _stack(warning, advisory, gap=0.03),
    "large_arrow": _stack(large_arrow),
    "pennant": _stack(no_passing_pennant),
    "rail": _stack(rail_advance),
    "crossbuck": _either(0.5, _stack(crossbuck, tracks_plaque), _stack(crossbuck)),
    "school": _stack(school, school_plaque, gap=0.02),
    "school_speed": _stack(school_plaque, speed_limit, gap=0.01),
    "pedestrian": _stack(pedestrian),
    "work": _either(0.65, _stack(work_diamond), _stack(work_panel)),
    "distances": _stack(guide_distances),
    "destination": _stack(guide_destination),
    "guide_large": _stack(guide_large),
    "street_name": _stack(street_name),
    "city_limit": _stack(city_limit),
    "mile_post": _stack(mile_post),
    "service": _stack(service),
    "service_large": _stack(service_large),
    "recreation": _stack(recreation),
    "route": _route,
    "object_marker": _stack(object_marker),
    "eu_limit": _either(0.6, _stack(eu_limit), _stack(eu_no_overtaking, eu_limit, gap=0.03)),
    "eu_warning": _either(0.6, _stack(eu_warning), _stack(eu_warning, eu_limit, gap=0.03)),
    "eu_give_way": _stack(eu_give_way),
    "eu_priority": _stack(eu_priority),
    "eu_no_entry": _stack(eu_no_entry),
    "eu_mandatory": _stack(eu_mandatory),
    "eu_blue": _either(0.5, _stack(eu_crossing), _stack(eu_parking)),
    "eu_town": _stack(eu_town),
    "eu_town_end": _stack(eu_town_end),
    "eu_beacon": _either(0.6, _stack(eu_beacon), _stack(eu_warning, eu_beacon, gap=0.4)),
    "eu_board": _stack(eu_board),
    "invented": _either(0.7, _stack(invented), _stack(invented, invented, gap=0.03)),
}
"""Name of a group -> the panels of one assembly."""
