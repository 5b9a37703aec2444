"""Texts in CSV that a spreadsheet must not take for formulas.

A cell that begins with `=`, `+`, `-`, `@`, a tab or a carriage return is evaluated where CSV is opened in a
spreadsheet (OWASP, CSV injection), and texts may be a stranger's: names of logs, topics, remarks. Such a text gets an
apostrophe in front, which spreadsheets do not show; numbers stay as they are.
"""

from __future__ import annotations

import re

FORMULA = r"^'*[=+\-@\t\r]"
"""Texts that get the apostrophe: those of one with apostrophes already too, so that it can be taken off again."""


def guarded(text: str) -> str:
    """The text with an apostrophe in front where a spreadsheet would evaluate it."""
    return f"'{text}" if re.match(FORMULA, text) else text


def unguarded(text: str) -> str:
    """What `guarded` was given."""
    return text[1:] if text.startswith("'") and re.match(FORMULA, text) else text
