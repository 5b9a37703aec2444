"""Reads a drive specification and refuses impossible ones."""

import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from recordings.drives.signs.catalogue import GROUPS
from recordings.drives.spec import DriveSpec
from wayside.schemas.errors import UsageError

SPECS = Path(__file__).parent / "specs"


def find_spec(name: str) -> Path:
    """Path of a specification, a TOML file or the name of one in `specs/`; raises UsageError if it is neither."""
    for path in (Path(name), SPECS / f"{name}.toml"):
        if path.is_file():
            return path
    known = ", ".join(sorted(path.stem for path in SPECS.glob("*.toml")))
    raise UsageError(f"{name} is neither a TOML file nor a specification here; there are {known}")


def load_spec(path: Path) -> DriveSpec:
    """Drive specification of a TOML file.

    Raises UsageError if it is not TOML, or a setting is unknown, missing, or of another type or range.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be read as TOML: {error}") from error
    spec: DriveSpec = _table(DriveSpec, table, path.name)
    _known("sign group", spec.signs.groups, GROUPS, f"{path.name}.signs.groups")
    if spec.frames < 1:
        raise UsageError(f"{path.name}.frames: must be at least 1, but is {spec.frames}")
    if not spec.path.spacing_m > 0:
        raise UsageError(
            f"{path.name}.path.spacing_m: must be more than 0, but is {spec.path.spacing_m:g}"
        )
    if not any(weight > 0 for weight in spec.signs.groups.values()):
        raise UsageError(f"{path.name}.signs.groups: no group has a weight")
    if spec.name in ("", ".", "..") or set(spec.name) & set("/\\:"):
        raise UsageError(f"{path.name}.name: {spec.name!r} cannot name files")
    return spec


def _known(
    what: str, found: Mapping[str, object], wanted: Mapping[str, object], where: str
) -> None:
    """Refuse keys outside `wanted`, naming the nearest one."""
    for name in found:
        if name not in wanted:
            near = get_close_matches(name, wanted, 1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(wanted)}"
            raise UsageError(f"{where}: unknown {what} {name}; {hint}")


def _table(kind: Any, table: object, where: str) -> Any:
    """Dataclass `kind` from a TOML table."""
    if not isinstance(table, dict):
        raise UsageError(f"{where}: must be a table, but is {table!r}")
    hints = get_type_hints(kind)
    _known("setting", table, hints, where)
    for setting in fields(kind):
        needed = setting.default is MISSING and setting.default_factory is MISSING
        if needed and setting.name not in table:
            raise UsageError(f"{where}: {setting.name} is missing, and it has no default")
    return kind(**{name: _value(hints[name], v, f"{where}.{name}") for name, v in table.items()})


def _value(kind: Any, value: object, where: str) -> Any:
    """One setting as its declared type; whole numbers may stand for floats."""
    if is_dataclass(kind):
        return _table(kind, value, where)
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Literal:
        if value not in parts:
            raise UsageError(f"{where}: must be one of {', '.join(parts)}, but is {value!r}")
        return value
    if origin is dict and isinstance(value, dict):
        return {name: _value(parts[1], item, f"{where}.{name}") for name, item in value.items()}
    if origin is tuple and isinstance(value, list):
        kinds = [parts[0]] * len(value) if parts[-1] is Ellipsis else list(parts)
        if len(kinds) == len(value):
            return tuple(_value(k, item, where) for k, item in zip(kinds, value, strict=True))
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        name = str(kind) if origin else kind.__name__
        raise UsageError(f"{where}: must be {name}, but is {value!r}")
    return value
