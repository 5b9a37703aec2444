"""Placement rules, read from TOML: a table a rule."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.checking.quantities import KNOWN_QUANTITIES
from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.lengths import METRES_IN_FOOT
from wayside.pipeline.files.parsing import parse_toml
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import UsageError
from wayside.schemas.sign_catalogue import INCH_M, SYSTEMS

SHIPPED = {file.stem: file for file in Path(__file__).parent.glob("*.toml")}
"""Rules that wayside has, by name."""
ROADS = ("rural", "urban", "freeway")
UNITS = {"m": 1.0, "ft": METRES_IN_FOOT, "in": INCH_M, "deg": 1.0, "": 1.0}
"""Units that limits are written in, in metres, degrees, or the unit of the quantity."""
_LIMIT = re.compile(r"([+-]?\d+\.?\d*)\s*(m|ft|in|deg|)")
Limits = tuple[tuple[float, float], ...]
"""Up to which value of `by` a limit holds, and the limit; the last one holds beyond."""


@dataclass(frozen=True, slots=True)
class Rule:
    """What a quantity of certain signs must be; limits in metres, degrees or the unit of the quantity."""

    id: str
    words: str
    """What must be so, for a person."""
    quantity: str
    """One of `KNOWN_QUANTITIES`."""
    unit: str = ""
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
    """Codes or series that it holds for; `W1-*` are all that begin so. Empty: all."""
    not_codes: tuple[str, ...] = ()
    """Those that it does not hold for."""
    colors: tuple[str, ...] = ()
    shapes: tuple[str, ...] = ()
    sides: tuple[str, ...] = ()
    """`left` or `right` of the path."""
    roads: tuple[str, ...] = ()
    """Of `ROADS`."""
    below_another: bool | None = None
    """Whether a panel of the same support stands above it. None: either."""
    next_within: float = math.inf
    """It holds only for signs whose next one of the same type is so near, metres."""


def read_rules(names: Sequence[str]) -> list[Rule]:
    """Rules of files, or of those that wayside has by name; a later one replaces an earlier one of the same id.

    Raises UsageError where a file or rule cannot be used: it names the file, the rule and what is wrong.
    """
    rules: dict[str, Rule] = {}
    for name in names:
        shipped = SHIPPED.get(name.removesuffix(".toml"))
        file = shipped if shipped is not None and not Path(name).exists() else Path(name)
        try:
            content = parse_toml(read_input_text(file))
        except OSError as error:
            raise UsageError(
                f"rules {name} cannot be read: {error.strerror}. Name a file, or one of {', '.join(SHIPPED)}."
            ) from error
        except ValueError as error:
            raise UsageError(f"rules {name}: this is no valid TOML: {error}") from error
        shared = {key: value for key, value in content.items() if not isinstance(value, dict)}
        for key, values in content.items():
            try:
                if key not in shared:
                    rules[key] = _rule(key, shared | values)
            except ValueError as error:
                raise UsageError(f"rules {name}, rule [{key}]: {error}") from error
    return list(rules.values())


def _rule(name: str, values: Mapping[str, Any]) -> Rule:
    """One rule; raises ValueError with what is wrong."""
    made: dict[str, Any] = {}
    units = set()
    for key, value in values.items():
        if key in ("least", "most"):
            made[key], unit = _limits(key, value)
            units.add(unit)
        elif key in _READERS:
            made[key] = _READERS[key](key, value)
        else:
            known = ", ".join((*_READERS, "least", "most"))
            raise ValueError(f"there is no key {key}; the keys are {known}")
    if lacking := {"words", "quantity"} - made.keys():
        raise ValueError(f"the key {min(lacking)} is missing")
    if not units:
        raise ValueError("it has no limit: give least, most or both")
    if len(units) > 1:
        raise ValueError("least and most have different units")
    unit = units.pop()
    wanted = next(
        (
            u
            for end, u in (("_m", ("m", "ft", "in")), ("_deg", ("deg",)))
            if made["quantity"].endswith(end)
        ),
        ("",),
    )
    if unit not in wanted:
        raise ValueError(
            f"a limit of {made['quantity']} is in {' or '.join(wanted) or 'no unit'}, not {unit!r}"
        )
    if any(len(made.get(key, ())) > 1 for key in ("least", "most")) and "by" not in made:
        raise ValueError("limits that are a list depend on a quantity: name it with the key by")
    return Rule(id=name, unit=unit, **made)


def _limits(key: str, value: Any) -> tuple[Limits, str]:
    """A limit, or pairs of a limit and up to which value of `by` it holds; and their unit."""
    if not isinstance(value, list):
        limit, unit = _measure(key, value)
        return ((math.inf, limit),), unit
    pairs, units = [], set()
    for pair in value:
        if not isinstance(pair, list) or len(pair) != 2:
            raise ValueError(f'{key}: {pair!r} is no pair ["up to", "limit"]')
        limit, unit = _measure(key, pair[1])
        pairs.append((math.inf if pair[0] == "" else _measure(key, pair[0])[0], limit))
        units.add(unit)
    ends = [end for end, _ in pairs]
    if len(units) != 1 or ends != sorted(ends) or ends[-1] != math.inf:
        raise ValueError(f'{key}: pairs rise, are in one unit and end with ["", "limit"]')
    return tuple(pairs), units.pop()


def _measure(key: str, value: Any) -> tuple[float, str]:
    """A number with its unit, in metres or degrees."""
    match = _LIMIT.fullmatch(value.strip()) if isinstance(value, str) else None
    if match is None:
        raise ValueError(f'{key}: {value!r} is no number with a unit, such as "5 ft" or "15 deg"')
    return float(match[1]) * UNITS[match[2]], match[2]


def _length(key: str, value: Any) -> float:
    return _measure(key, value)[0]


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{key} must be a text, but is {value!r}")
    return value


def _flag(key: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{key} must be true or false, but is {value!r}")
    return value


def _one_of(known: Collection[str]) -> Callable[[str, Any], str]:
    def read(key: str, value: Any) -> str:
        if value not in known:
            raise ValueError(f"{key}: {value!r} is none of: {', '.join(known)}")
        return str(value)

    return read


def _each(reader: Callable[[str, Any], str]) -> Callable[[str, Any], tuple[str, ...]]:
    def read(key: str, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or not value:
            raise ValueError(f"{key} must be a list of texts, but is {value!r}")
        return tuple(reader(key, one) for one in value)

    return read


_READERS: dict[str, Callable[[str, Any], Any]] = {
    **dict.fromkeys(("words", "edition", "section"), _text),
    **dict.fromkeys(("quantity", "by"), _one_of(KNOWN_QUANTITIES)),
    "level": _one_of(("shall", "should", "own")),
    "system": _one_of(SYSTEMS),
    **dict.fromkeys(("tolerance", "next_within"), _length),
    **dict.fromkeys(("codes", "not_codes"), _each(_text)),
    "colors": _each(_one_of(COLORS)),
    "shapes": _each(_one_of(SHAPES)),
    "sides": _each(_one_of(("left", "right"))),
    "roads": _each(_one_of(ROADS)),
    "below_another": _flag,
}
