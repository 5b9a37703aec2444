"""Settings in layers: defaults, preset, TOML file, `--set group.name=value`, named options; later ones win.

Every value keeps its origin, which explains a result.
"""

import difflib
import hashlib
import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import Field, asdict, fields, replace
from pathlib import Path
from typing import Any

from wayside.pipeline.files.lengths import parse_length
from wayside.pipeline.files.parsing import read_toml
from wayside.schemas.errors import UsageError
from wayside.schemas.settings import REPORT, REPORT_2D, REPORT_SHAPE, Settings

PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    "report-shape": REPORT_SHAPE,
    "report-2d": REPORT_2D,
    "report": REPORT,
}
"""Values of each preset that differ from the defaults, by group and name."""
DEFAULT = "default"
_NO_RESULT = ("run", "merge", "changes")
"""Groups that control how a run is carried out, and what happens to its result afterwards."""
_FLAGS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def load_settings(
    preset: str = DEFAULT,
    file: Path | None = None,
    assignments: Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
) -> tuple[Settings, dict[str, str]]:
    """Merge all layers and check every value; the settings, and where each value is from by its full name.

    `preset`: a name of `PRESETS`. `file`: TOML with one table a group, as `format_settings` writes it. `assignments`:
    `group.name=value`, in order. `options`: values of named options by full name (`read.spacing_m`); None means not
    given, and texts are converted like assignments. Origins: `default`, `preset report`, the file's name, `--set` or
    `option`.

    Raises UsageError for an unknown preset, group or name, and names the nearest known one. Raises it also for a value
    of the wrong type or out of range, and for a file that cannot be read.
    """
    settings = Settings()
    leaves = {
        f"{group.name}.{leaf.name}": leaf
        for group in fields(settings)
        for leaf in fields(getattr(settings, group.name))
    }
    origins = dict.fromkeys(leaves, DEFAULT)
    for origin, full, value in _layers(preset, file, assignments, options or {}):
        if full not in leaves:
            raise UsageError(
                f"unknown setting {full} ({origin}){_nearest(full, leaves)}; `wayside settings` lists all"
            )
        try:
            read = _value(value, leaves[full])
        except (ValueError, KeyError, UsageError) as error:
            raise UsageError(
                f"setting {full} must be {_limits(leaves[full])}, but is {value!r} ({origin})"
            ) from error
        group, _, name = full.partition(".")
        changed = replace(getattr(settings, group), **{name: read})
        settings = replace(settings, **{group: changed})
        origins[full] = origin
    for words in _contradictions(settings):
        raise UsageError(words)
    return settings, origins


def format_settings(settings: Settings, origins: Mapping[str, str], *, full: bool = False) -> str:
    """Settings as TOML that `load_settings` reads back to the same values: a table per group, with comments.

    `full`: comments state the origin of each default, too.
    """
    heads = ["value  # unit", "default", "where the value is from", "what it does"]
    more = ["where the default is from"] if full else []
    lines = [f"# Settings of wayside: {' | '.join(heads + more)}"]
    for group in fields(settings):
        values = getattr(settings, group.name)
        rows = []
        for leaf in fields(values):
            about = leaf.metadata
            origin = origins.get(f"{group.name}.{leaf.name}", DEFAULT)
            notes = [about["unit"] or "-", _toml(leaf.default), origin, about["words"]]
            notes += [about["origin"] or "-"] if full else []
            rows.append((f"{leaf.name} = {_toml(getattr(values, leaf.name))}", " | ".join(notes)))
        lines += ["", f"# {type(values).__doc__}", f"[{group.name}]"]
        width = max(len(left) for left, _ in rows)
        lines += [f"{left:<{width}}  # {right}" for left, right in rows]
    return "\n".join(lines) + "\n"


def by_full_name(settings: Settings) -> dict[str, Any]:
    """Every value by its full name: as options of `load_settings`, settings that were made in Python are checked."""
    groups = asdict(settings).items()
    return {f"{group}.{name}": value for group, held in groups for name, value in held.items()}


def settings_digest(settings: Settings) -> str:
    """SHA-256 of every setting that can change the result of a drive; those of `_NO_RESULT` cannot."""
    values = {group: held for group, held in asdict(settings).items() if group not in _NO_RESULT}
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _layers(
    preset: str, file: Path | None, assignments: Sequence[str], options: Mapping[str, Any]
) -> Iterator[tuple[str, str, Any]]:
    """Yield origin, full name and value, in the order in which later ones win."""
    if preset not in PRESETS:
        known = ", ".join(PRESETS)
        raise UsageError(
            f"unknown preset {preset!r}; there are: {known}{_nearest(preset, PRESETS)}"
        )
    yield from _tables(PRESETS[preset], f"preset {preset}")
    if file is not None:
        content = read_toml(file, "settings file", "`wayside settings` prints one.")
        yield from _tables(content, file.name)
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise UsageError(
                f"--set takes group.name=value, as in --set segment.clusters=8, but is {text!r}"
            )
        yield "--set", name.strip(), value.strip()
    for name, value in options.items():
        if value is not None:
            yield "option", name, value


def _tables(groups: Mapping[str, Any], origin: str) -> Iterator[tuple[str, str, Any]]:
    known = [group.name for group in fields(Settings)]
    for group, values in groups.items():
        if group not in known:
            raise UsageError(
                f"unknown group [{group}] in {origin}; there are: {', '.join(known)}{_nearest(group, known)}"
            )
        if not isinstance(values, Mapping):
            raise UsageError(f"{origin}: {group} must be a table [{group}], but is {values!r}")
        for name, value in values.items():
            yield origin, f"{group}.{name}", value


def _value(value: Any, leaf: Field[Any]) -> Any:
    """A value in the type of its setting; raises ValueError, KeyError or UsageError otherwise."""
    kind: type[Any] = type(leaf.default)
    if isinstance(value, str) and kind is bool:
        value = _FLAGS[value.lower()]
    elif isinstance(value, str) and kind is not str:
        value = _number(value, kind, leaf.metadata["unit"])
    elif type(value) is int and kind is float:
        value = float(value)
    choices, low, high = (leaf.metadata[key] for key in ("choices", "low", "high"))
    if type(value) is not kind or (choices and value not in choices):
        raise ValueError(value)
    if kind in (int, float) and not (
        math.isfinite(value) and (low is None or low <= value) and (high is None or value <= high)
    ):
        raise ValueError(value)
    return value


def _number(text: str, kind: type[Any], unit: str) -> Any:
    """A number, alone or with its unit; a length with any unit."""
    try:
        return kind(text.removesuffix(unit))
    except ValueError:
        if unit != "m":
            raise
        return parse_length(text.removeprefix("-"), unit) * (-1 if text.startswith("-") else 1)


def _limits(leaf: Field[Any]) -> str:
    """What a setting can be, in words."""
    unit, low, high, choices = (leaf.metadata[key] for key in ("unit", "low", "high", "choices"))
    words = _KINDS[type(leaf.default)] + (f" ({unit})" if unit else "")
    if choices:
        return " or ".join(choices)
    if low is None:
        return words
    return words + (f", at least {low:g}" if high is None else f", {low:g} to {high:g}")


def _nearest(name: str, known: Collection[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else ""


def _contradictions(settings: Settings) -> Iterator[str]:
    """Which values are impossible together, in words."""
    gate, read, track, report = settings.gate, settings.read, settings.track, settings.report
    route, models = settings.route, settings.models
    if gate.smallest_px > gate.largest_px:
        yield (
            f"gate.smallest_px ({gate.smallest_px}) is above gate.largest_px ({gate.largest_px}): "
            "no region could pass"
        )
    if 0 < read.until_s <= read.from_s:
        yield f"read.until_s ({read.until_s:g}) must be after read.from_s ({read.from_s:g}); 0 means to the end"
    if models.detector and models.detections:
        yield "boxes have one source, but models.detector and models.detections are given. Give one."
    if report.on and (models.detector or models.detections):
        yield (
            f"models.{'detector' if models.detector else 'detections'} replaces the detector of preset default; the "
            "presets of the report have no other than their own: leave one of them out"
        )
    if models.classes and not (models.detector or models.detections):
        yield "models.classes says which classes of a detector are signs; give --detector or --detections as well"
    if not report.on and (report.shape or report.trajectory != "off"):
        yield (
            f"report.{'shape' if report.shape else 'trajectory'} is a gate of the report's own chain; choose preset "
            "report, report-2d or report-shape for it"
        )
    by_milepost = route.milepost >= 0
    if by_milepost and route.file:
        yield "a milepost (route.milepost) and lines with measures (route.file) are given. Give one."
    if route.name and not (by_milepost or route.file):
        yield (
            f"route.name ({route.name}): the measure where the drive begins is missing. Add --milepost 12.35, or "
            "--routes FILE with its lines."
        )
    if by_milepost and not route.name:
        yield f"route.milepost ({route.milepost:g}): its route is missing. Add --route 'US-36 EB'."
    if route.decreasing and not by_milepost:
        yield (
            "route.decreasing: there is no milepost that this belongs to. Add --milepost 12.35; lines with measures "
            "need no direction."
        )
    if track.fewest_views > track.longest:
        yield (
            f"track.fewest_views ({track.fewest_views}) is above track.longest ({track.longest}): "
            "no sign could be reported"
        )


def _toml(value: Any) -> str:
    """A value as TOML; JSON texts are valid TOML basic strings."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)
