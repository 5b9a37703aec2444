"""One leaf of the settings: its default, unit, meaning, origin and limits."""

from dataclasses import field
from typing import Any


def setting(
    default: Any,
    unit: str,
    words: str,
    *,
    origin: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """A dataclass field that knows its unit, meaning and what it may hold (limits included).

    `origin`: where the default comes from (a chapter of the report, a paper, a measurement).
    """
    return field(
        default=default,
        metadata={
            "unit": unit,
            "words": words,
            "origin": origin,
            "low": low,
            "high": high,
            "choices": choices,
        },
    )
