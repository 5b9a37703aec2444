"""Texts of files that others may have written: JSON, TOML, YAML and CSV. Other texts raise ValueError."""

import csv
import io
import json
import re
import tomllib
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from wayside.pipeline.files.input_files import read_input_text
from wayside.schemas.errors import UsageError, WaysideError

CONTENT_FAULTS = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Exceptions that values of an unexpected kind, size or structure raise where they are used."""
_BETWEEN = ",;\t"
_NOTHING = f' "{_BETWEEN}'
FORMULA = r"^'*[=+\-@\t\r]"
"""Texts of CSV that spreadsheets evaluate (OWASP, CSV injection), or such texts behind apostrophes."""


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds; raises ValueError for another text, or one nested too deeply."""
    return _parsed(json.loads, text)


def read_toml(
    file: Path, what: str, advice: str, refusal: type[WaysideError] = UsageError
) -> dict[str, Any]:
    """The content of a TOML file; raises a `refusal`, which says what to do, where it cannot be read or is not TOML."""
    try:
        content: dict[str, Any] = _parsed(tomllib.loads, read_input_text(file))
    except (OSError, ValueError) as error:
        fault = f"is not valid TOML: {error}"
        if isinstance(error, OSError):
            fault = f"cannot be read: {error.strerror}"
        raise refusal(f"{what} {file} {fault}. {advice}") from error
    return content


def _parsed(parse: Callable[[Any], Any], text: str | bytes) -> Any:
    """What a parser makes of a text; raises its errors, and ValueError for a text nested too deeply."""
    try:
        return parse(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


class YamlLoader(yaml.SafeLoader):
    """The safe loader without aliases, by which a short text can expand exponentially."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """The next node; an alias raises an error."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias (*name); write its value out")
        return super().compose_node(parent, index)


def parse_yaml(text: str, loader: type[YamlLoader] = YamlLoader) -> Any:
    """What a YAML text holds; raises ValueError for another text, an alias, or deep nesting."""
    try:
        return _parsed(partial(yaml.load, Loader=loader), text)
    except (yaml.YAMLError, *CONTENT_FAULTS) as error:  # its own classes for dates and numbers
        raise ValueError(f"not valid YAML: {' '.join(str(error).split())}") from error


def guarded(text: str) -> str:
    """The text with an apostrophe in front where a spreadsheet would evaluate it; it does not show the apostrophe."""
    return f"'{text}" if re.match(FORMULA, text) else text


def unguarded(text: str) -> str:
    """The inverse of `guarded`."""
    return text[1:] if text.startswith("'") and re.match(FORMULA, text) else text


def read_csv(path: Path, numbers: Collection[str] = ()) -> tuple[list[str], list[dict[str, str]]]:
    """Names of the columns and the rows of a CSV file, without blanks around values, empty values and empty rows.

    Columns are divided by commas, semicolons or tabs, whichever the first row has most of. Where that is no comma, the
    columns of `numbers` may have one for the decimal point.

    Raises OSError, ValueError, csv.Error where it cannot be read, or a row has more values than the first.
    """
    text = read_input_text(path)
    stated = re.match(r"sep=(.)\r?\n", text)  # for Excel
    text = text[stated.end() :] if stated else text
    first = next((line for line in text.splitlines() if line.strip(_NOTHING)), "")
    mark = stated[1] if stated else max(_BETWEEN, key=first.count)
    table = csv.reader(io.StringIO(text, newline=""), delimiter=mark, strict=True)
    rows = ([unguarded(cell.strip()) for cell in row] for row in table)
    names, *filled = [row for row in rows if any(row)] or [[]]
    found = []
    for number, row in enumerate(filled, 1):
        if any(row[len(names) :]):
            raise ValueError(f"row {number} has {len(row)} values, the first row {len(names)}")
        values = {name: value for name, value in zip(names, row, strict=False) if value}
        if mark != ",":
            values |= {n: values[n].replace(",", ".") for n in values.keys() & set(numbers)}
        found.append(values)
    return names, found
