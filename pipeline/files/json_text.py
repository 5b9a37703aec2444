"""JSON of files that others may have written, and the faults of what they hold."""

from __future__ import annotations

import json
from typing import Any

CONTENT_FAULTS = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What a value of another kind, size or structure than expected raises where it is used."""


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds.

    Raises
    ------
    ValueError
        It is none, or nested deeper than can be read.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
