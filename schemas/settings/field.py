"""One leaf of the settings: its default with unit, meaning, origin and limits beside it."""

from __future__ import annotations

from dataclasses import field
from typing import Any

SET = "set on the development drives"
"""Origin of many settings: chosen by trial."""


def setting(
    default: Any,
    unit: str,
    words: str,
    *,
    origin: str = "",
    expert: bool = False,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """A dataclass field that knows its unit, meaning and what it may hold (limits included).

    origin: where the default comes from (a chapter of the report, a paper, a measurement); expert: `wayside settings`
    prints it with --all only.
    """
    return field(
        default=default,
        metadata={
            "unit": unit,
            "words": words,
            "origin": origin,
            "expert": expert,
            "low": low,
            "high": high,
            "choices": choices,
        },
    )
