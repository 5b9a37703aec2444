"""Surveys: the drives of a span of time."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from wayside.schemas.errors import UsageError


@dataclass(frozen=True, slots=True)
class Survey:
    """Drives of a span of time, nanoseconds since 1970, the end not included; `words`: as it was asked for."""

    words: str
    from_ns: int
    until_ns: int

    def __contains__(self, time_ns: int) -> bool:
        """Whether a time lies in it."""
        return self.from_ns <= time_ns < self.until_ns


def parse_survey(text: str) -> Survey:
    """`2024`, `2024-05`, `2024-05-17`, or two of these with `..` between, the last one included; UTC.

    Raises
    ------
    UsageError
        For anything else, and where the end lies before the start.
    """
    first, _, last = text.partition("..")
    (start, _), (_, end) = _span(first, text), _span(last or first, text)
    if end <= start:
        raise UsageError(f"the survey {text} ends before it starts")
    return Survey(text, start, end)


def _span(text: str, whole: str) -> tuple[int, int]:
    """Start and end, nanoseconds, of a year, month or day."""
    try:
        if not re.fullmatch(r"\d{4}(-\d\d){0,2}", text):
            raise ValueError
        start = np.datetime64(text)
    except ValueError as error:
        raise UsageError(
            f"{whole} is not a survey. Write it as 2024, 2024-05, 2024-05-17 or 2024-03..2024-06."
        ) from error
    first, end = (time.astype("datetime64[s]").astype(int) for time in (start, start + 1))
    return int(first) * 10**9, int(end) * 10**9
