"""Placement rules, read from TOML: a table a rule."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from wayside.pipeline.checking.quantities import KNOWN_QUANTITIES
from wayside.pipeline.files.lengths import METRES_IN_FOOT
from wayside.pipeline.files.parsing import read_toml
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import UsageError
from wayside.schemas.sign_catalogue import INCH_M, SYSTEMS

SHIPPED = {file.stem: file for file in Path(__file__).parent.glob("*.toml")}
"""Rules that wayside has, by name."""
ROADS = ("rural", "urban", "freeway")
UNITS = {"m": 1.0, "ft": METRES_IN_FOOT, "in": INCH_M, "deg": 1.0, "": 1.0}
"""Units that limits are written in, in metres, degrees, or the unit of the quantity."""
_LIMIT = re.compile(r"([+-]?\d+\.?\d*)\s*(m|ft|in|deg|)")
_UNITS_OF = {"m": ("m", "ft", "in"), "deg": ("deg",)}
"""Those of a quantity, by the end of its name."""
Limits = tuple[tuple[float, float], ...]
"""Up to which value of `by` a limit holds, and the limit; the last one holds beyond."""


@dataclass(frozen=True, slots=True)
class Rule:
    """What a quantity of certain signs must be; limits in metres, degrees or the unit of the quantity."""

    id: str
    words: str
    """What must be so, for a person."""
    quantity: str
    unit: str
    """That its limits are written in."""
    level: str = "own"
    """shall: a standard of the manual; should: a guidance; own: of neither."""
    edition: str = ""
    section: str = ""
    system: str = ""
    """Of the signs that it holds for. Empty: any."""
    least: Limits = ()
    most: Limits = ()
    by: str = ""
    """Quantity that the limits depend on."""
    tolerance: float = 0.0
    """How far a value may lie beyond the limit."""
    codes: tuple[str, ...] = ()
    """Codes or series that it holds for; `W1-*` are all that begin so. Empty, as below: all."""
    not_codes: tuple[str, ...] = ()
    colors: tuple[str, ...] = ()
    shapes: tuple[str, ...] = ()
    sides: tuple[str, ...] = ()
    roads: tuple[str, ...] = ()
    below_another: bool | None = None
    """Whether a panel of the same support stands above it. None: either."""
    next_within: float = math.inf
    """It holds only for signs whose next one of the same type is so near, metres."""


_KEYS = [field.name for field in fields(Rule) if field.name not in ("id", "unit")]
_LISTS = ("codes", "not_codes", "colors", "shapes", "sides", "roads")
_CHOICES = {
    "quantity": KNOWN_QUANTITIES,
    "by": KNOWN_QUANTITIES,
    "level": ("shall", "should", "own"),
    "system": SYSTEMS,
    "colors": COLORS,
    "shapes": SHAPES,
    "sides": ("left", "right"),
    "roads": ROADS,
}


def read_rules(names: Sequence[str]) -> list[Rule]:
    """Rules of files, or of those that wayside has by name; a later one replaces an earlier one of the same id.

    Raises UsageError where a file or rule cannot be used: it names the file, the rule and what is wrong.
    """
    rules: dict[str, Rule] = {}
    for name in names:
        shipped = SHIPPED.get(name.removesuffix(".toml"))
        file = shipped if shipped is not None and not Path(name).exists() else Path(name)
        advice = f"Correct it, or name another file, or one of {', '.join(SHIPPED)}."
        content = read_toml(file, "rules", advice)
        shared = {key: value for key, value in content.items() if not isinstance(value, dict)}
        for key in [key for key in content if key not in shared]:
            try:
                rules[key] = _rule(key, shared | content[key])
            except ValueError as error:
                raise UsageError(f"rules {name}, rule [{key}]: {error}") from error
    return list(rules.values())


def _rule(name: str, values: Mapping[str, Any]) -> Rule:
    """One rule; raises ValueError with what is wrong."""
    if alien := [key for key in values if key not in _KEYS]:
        raise ValueError(f"there is no key {alien[0]}; the keys are {', '.join(_KEYS)}")
    if lacking := [key for key in ("words", "quantity") if key not in values]:
        raise ValueError(f"the key {lacking[0]} is missing")
    made = {key: _value(key, value) for key, value in values.items()}
    limits = {key: _limits(key, made[key]) for key in ("least", "most") if key in made}
    units = {unit for _, unit in limits.values()}
    if len(units) != 1:
        raise ValueError("it has no limit, or limits in different units: give least, most or both")
    wanted = _UNITS_OF.get(made["quantity"].rpartition("_")[2], ("",))
    if not units <= {*wanted}:
        named = " or ".join(wanted)
        raise ValueError(
            f"a limit of {made['quantity']} is in {named or 'no unit'}, not {min(units)}"
        )
    if any(len(pairs) > 1 for pairs, _ in limits.values()) and "by" not in made:
        raise ValueError("limits that are a list depend on a quantity: name it with the key by")
    made |= {key: pairs for key, (pairs, _) in limits.items()}
    return Rule(id=name, unit=units.pop(), **made)


def _value(key: str, value: Any) -> Any:
    """The value of a key, limits as they are; raises ValueError where it is of another kind, or none of the choices."""
    if key in ("least", "most"):
        return value
    if key == "below_another":
        if not isinstance(value, bool):
            raise ValueError(f"{key} must be true or false, but is {value!r}")
        return value
    listed = value if key in _LISTS else [value]
    if not isinstance(listed, list) or not all(isinstance(one, str) for one in listed):
        kind = "a list of texts" if key in _LISTS else "a text"
        raise ValueError(f"{key} must be {kind}, but is {value!r}")
    if wrong := [one for one in listed if one not in _CHOICES.get(key, listed)]:
        raise ValueError(f"{key}: {wrong[0]!r} is not one of: {', '.join(_CHOICES[key])}")
    if key in ("tolerance", "next_within"):
        return _measure(key, value)[0]
    return tuple(listed) if key in _LISTS else value


def _limits(key: str, value: Any) -> tuple[Limits, str]:
    """A limit, or pairs of up to which value of `by` one holds and the limit, in order; and their unit."""
    pairs = value if isinstance(value, list) else [["", value]]
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        raise ValueError(f'{key}: {value!r} is not a list of pairs ["up to", "limit"]')
    read = [_measure(key, limit) for _, limit in pairs]
    ends = [math.inf if end == "" else _measure(key, end)[0] for end, _ in pairs]
    units = {unit for _, unit in read}
    if len(units) != 1 or ends != sorted(ends) or ends[-1] != math.inf:
        raise ValueError(f'{key}: pairs rise, have one unit and end with ["", "limit"]')
    return tuple(zip(ends, (limit for limit, _ in read), strict=True)), units.pop()


def _measure(key: str, value: Any) -> tuple[float, str]:
    """A number in metres or degrees, and the unit that it is written in."""
    match = _LIMIT.fullmatch(value.strip()) if isinstance(value, str) else None
    if match is None:
        raise ValueError(f'{key}: {value!r} is not a number with a unit, as "5 ft" or "15 deg"')
    return float(match[1]) * UNITS[match[2]], match[2]
