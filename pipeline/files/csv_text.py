"""CSV as spreadsheets write it, and texts in CSV that a spreadsheet must not take for formulas.

Spreadsheets evaluate a cell that begins with `=`, `+`, `-`, `@`, a tab or a carriage return (OWASP, CSV injection).
Texts can come from strangers: names of logs, topics, remarks. Such a text gets an apostrophe in front, which
spreadsheets do not show; numbers stay as they are.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection
from pathlib import Path

from wayside.pipeline.files.input_files import read_input_text

_BETWEEN = ",;\t"
_NOTHING = f' "{_BETWEEN}'
FORMULA = r"^'*[=+\-@\t\r]"
"""Texts that get the apostrophe: those of one with apostrophes already too, so that it can be taken off again."""


def guarded(text: str) -> str:
    """The text with an apostrophe in front where a spreadsheet would evaluate it."""
    return f"'{text}" if re.match(FORMULA, text) else text


def unguarded(text: str) -> str:
    """What `guarded` was given."""
    return text[1:] if text.startswith("'") and re.match(FORMULA, text) else text


def read_csv(path: Path, numbers: Collection[str] = ()) -> tuple[list[str], list[dict[str, str]]]:
    """Names of the columns and the rows of a CSV file, without blanks around values, empty values and empty rows.

    Columns are divided by commas, semicolons or tabs, whichever the first row has most of. Where that is no comma, the
    columns of `numbers` may have one for the decimal point.

    Raises
    ------
    OSError, ValueError, csv.Error
        It cannot be read, or a row has more values than the first.
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
