"""Settings in layers: defaults, preset, TOML file, `--set group.name=value`, named options; later ones win.

Every value keeps where it came from, so that a result can be defended and a surprise explained.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import Field, fields, replace
from pathlib import Path
from typing import Any

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.lengths import parse_length
from wayside.pipeline.files.parsing import parse_toml
from wayside.schemas.errors import UsageError, WaysideError
from wayside.schemas.settings import REPORT, REPORT_2D, REPORT_SHAPE, RouteSettings, Settings

PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    "report-shape": REPORT_SHAPE,
    "report-2d": REPORT_2D,
    "report": REPORT,
}
"""Values of each preset that differ from the defaults, by group and name."""

DEFAULT = "default"
_NO_RESULT = ("run", "merge", "changes")
"""Groups of how a run is carried out, and of what is made of its result afterwards."""
_SPOKEN_FLAGS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def load_settings(
    preset: str = DEFAULT,
    file: Path | None = None,
    assignments: Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
) -> tuple[Settings, dict[str, str]]:
    """Merge all layers and check every value.

    Parameters
    ----------
    preset
        A name of `PRESETS`.
    file
        TOML file with one table a group, as `format_settings` writes it.
    assignments
        `group.name=value`, in order.
    options
        Values of named options by full name (`read.spacing_m`); None means not given. Texts are converted like
        assignments.

    Returns
    -------
    settings, origins
        Origins by full name: `default`, `preset report`, the file's name, `--set` or `option`.

    Raises
    ------
    UsageError
        Unknown preset, group or name (with the nearest known one), a value of the wrong type or out of range, a file
        that cannot be read.
    """
    values: dict[str, Any] = {}
    leaves = _leaves()
    origins = dict.fromkeys(leaves, DEFAULT)
    for origin, name, value in _layers(preset, file, assignments, options or {}):
        values[name] = _convert(name, value, origin, leaves)
        origins[name] = origin
    settings = _assemble(values)
    _check_together(settings)
    return settings, origins


def format_settings(settings: Settings, origins: Mapping[str, str], *, full: bool = False) -> str:
    """Write settings as TOML that `load_settings` reads back to the same values.

    Parameters
    ----------
    settings, origins
        As `load_settings` gives them.
    full
        Of each also where its default comes from.

    Returns
    -------
    A table a group; unit, default, origin of the value and words in comments.
    """
    heads = ["value  # unit", "default", "where the value is from", "what it does"]
    if full:
        heads.append("where the default is from")
    lines = ["# Settings of wayside: " + " | ".join(heads)]
    for group in fields(settings):
        values = getattr(settings, group.name)
        rows = []
        for leaf in fields(values):
            value = getattr(values, leaf.name)
            about = [
                leaf.metadata["unit"] or "-",
                _toml(leaf.default),
                origins.get(f"{group.name}.{leaf.name}", DEFAULT),
                leaf.metadata["words"],
            ]
            if full:
                about.append(leaf.metadata["origin"] or "-")
            rows.append((f"{leaf.name} = {_toml(value)}", " | ".join(about)))
        lines += ["", f"# {type(values).__doc__}", f"[{group.name}]"]
        width = max(len(left) for left, _ in rows)
        lines += [f"{left:<{width}}  # {right}" for left, right in rows]
    return "\n".join(lines) + "\n"


def settings_values(settings: Settings) -> dict[str, dict[str, Any]]:
    """All values by group and name, ready for JSON."""
    return {
        group.name: {
            leaf.name: getattr(getattr(settings, group.name), leaf.name)
            for leaf in fields(getattr(settings, group.name))
        }
        for group in fields(settings)
    }


def settings_digest(settings: Settings) -> str:
    """SHA-256 of every setting that can change the result of a drive; those of `_NO_RESULT` cannot."""
    values = settings_values(settings)
    for group in _NO_RESULT:
        del values[group]
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
    yield from _tree(PRESETS[preset], f"preset {preset}")
    if file is not None:
        yield from _tree(_read(file), file.name)
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


def _tree(groups: Mapping[str, Any], origin: str) -> Iterator[tuple[str, str, Any]]:
    known = [group.name for group in fields(Settings)]
    for group, values in groups.items():
        if group not in known:
            raise UsageError(
                f"unknown group [{group}] in {origin}; there are: {', '.join(known)}"
                f"{_nearest(group, known)}"
            )
        if not isinstance(values, Mapping):
            raise UsageError(f"{origin}: {group} must be a table [{group}], but is {values!r}")
        for name, value in values.items():
            yield origin, f"{group}.{name}", value


def _read(file: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_input_text(file))
    except OSError as error:
        raise UsageError(f"settings file {file} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(
            f"settings file {file} is not valid TOML: {error}; "
            "`wayside settings` prints one that is"
        ) from error


def _leaves() -> dict[str, Field[Any]]:
    """All settings by full name."""
    defaults = Settings()
    return {
        f"{group.name}.{leaf.name}": leaf
        for group in fields(defaults)
        for leaf in fields(getattr(defaults, group.name))
    }


def _convert(name: str, value: Any, origin: str, leaves: Mapping[str, Field[Any]]) -> Any:
    """Value of a setting in its own type, within its limits."""
    if name not in leaves:
        raise UsageError(
            f"unknown setting {name} ({origin}){_nearest(name, leaves)}; "
            "`wayside settings` lists all"
        )
    leaf = leaves[name]
    kind: type[Any] = type(leaf.default)
    try:
        converted = _from_text(value, leaf) if isinstance(value, str) else value
    except (ValueError, WaysideError) as error:
        raise UsageError(_refusal(name, leaf, value, origin)) from error
    if kind is float and type(converted) is int:
        converted = float(converted)
    if type(converted) is not kind or not _within(converted, leaf):
        raise UsageError(_refusal(name, leaf, value, origin))
    return converted


def _from_text(text: str, leaf: Field[Any]) -> Any:
    kind: type[Any] = type(leaf.default)
    unit = leaf.metadata["unit"]
    if kind is bool:
        if text.lower() not in _SPOKEN_FLAGS:
            raise ValueError(text)
        return _SPOKEN_FLAGS[text.lower()]
    if kind is float and unit == "m" and not _is_number(text):
        return -parse_length(text[1:]) if text.startswith("-") else parse_length(text)
    if kind in (int, float):
        return kind(text.removesuffix(unit))
    return text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _within(value: Any, leaf: Field[Any]) -> bool:
    if leaf.metadata["choices"]:
        return value in leaf.metadata["choices"]
    if isinstance(value, (str, bool)):
        return True
    low, high = leaf.metadata["low"], leaf.metadata["high"]
    return (
        math.isfinite(value) and (low is None or value >= low) and (high is None or value <= high)
    )


def _refusal(name: str, leaf: Field[Any], value: Any, origin: str) -> str:
    """The error for a value outside the type, range or choices of its setting."""
    low, high, choices = (leaf.metadata[key] for key in ("low", "high", "choices"))
    kind = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
    wanted = " or ".join(choices) if choices else kind[type(leaf.default)]
    if leaf.metadata["unit"] and not choices:
        wanted += f" ({leaf.metadata['unit']})"
    if low is not None:
        wanted += f", at least {low:g}" if high is None else f", {low:g} to {high:g}"
    return f"setting {name} must be {wanted}, but is {value!r} ({origin})"


def _nearest(name: str, known: Mapping[str, Any] | Sequence[str]) -> str:
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    if not near:
        near = [full for full in known if full.rpartition(".")[2] == name.rpartition(".")[2]][:1]
    return f"; did you mean {near[0]}?" if near else ""


def _assemble(values: Mapping[str, Any]) -> Settings:
    settings = Settings()
    for name, value in values.items():
        group, _, leaf = name.partition(".")
        settings = replace(settings, **{group: replace(getattr(settings, group), **{leaf: value})})
    return settings


def _check_together(settings: Settings) -> None:
    """Refuse pairs of values that are fine alone and impossible together."""
    gate, read, track = settings.gate, settings.read, settings.track
    if gate.smallest_px > gate.largest_px:
        raise UsageError(
            f"gate.smallest_px ({gate.smallest_px}) is above gate.largest_px ({gate.largest_px}): "
            "no region could pass"
        )
    if read.until_s and read.until_s <= read.from_s:
        raise UsageError(
            f"read.until_s ({read.until_s:g}) must be after read.from_s ({read.from_s:g}); 0 means to the end"
        )
    given = [f"models.{n}" for n in ("detector", "detections") if getattr(settings.models, n)]
    if len(given) > 1:
        raise UsageError(f"boxes have one source, but {' and '.join(given)} are given. Give one.")
    report = settings.report
    if given and report.on:
        raise UsageError(
            f"{given[0]} replaces the detector of preset default; the presets of the report have no other than "
            "their own: leave one of them out"
        )
    if settings.models.classes and not given:
        raise UsageError(
            "models.classes says which classes of a detector are signs; give --detector or --detections as well"
        )
    if (report.shape or report.trajectory != "off") and not report.on:
        name = "shape" if report.shape else "trajectory"
        raise UsageError(
            f"report.{name} is a gate of the report's own chain; choose preset report, report-2d or report-shape for it"
        )
    _check_route(settings.route)
    if track.fewest_views > track.longest:
        raise UsageError(
            f"track.fewest_views ({track.fewest_views}) is above track.longest ({track.longest}): "
            "no sign could be reported"
        )


def _check_route(route: RouteSettings) -> None:
    by_milepost = route.milepost >= 0
    if by_milepost and route.file:
        raise UsageError(
            "a milepost (route.milepost) and lines with measures (route.file) are given. Give one."
        )
    if route.name and not by_milepost and not route.file:
        raise UsageError(
            f"route.name ({route.name}): the measure where the drive begins is missing. Add --milepost 12.35, or "
            "--routes FILE with its lines."
        )
    if by_milepost and not route.name:
        raise UsageError(
            f"route.milepost ({route.milepost:g}): its route is missing. Add --route 'US-36 EB'."
        )
    if route.decreasing and not by_milepost:
        raise UsageError(
            "route.decreasing: there is no milepost that this belongs to. Add --milepost 12.35; lines with measures "
            "need no direction."
        )


def _toml(value: Any) -> str:
    """A value as TOML; JSON texts are valid TOML basic strings."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)
