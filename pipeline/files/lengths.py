"""Lengths, times and sizes as people write them on a command line."""

import math
import re

from wayside.schemas.errors import UsageError

METRES_IN_FOOT = 0.3048

_UNITS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "'"), METRES_IN_FOOT),
    **{"cm": 0.01, "mm": 0.001, "in": METRES_IN_FOOT / 12},
}
_MEGABYTES = {"mb": 1.0, "gb": 1e3, "tb": 1e6, "mib": 2**20 / 1e6, "gib": 2**30 / 1e6}
_LENGTH = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*([a-z']*)")
_CLOCK = re.compile(r"(?:(\d+):)?(\d+):(\d{1,2}(?:\.\d*)?)")
_SECONDS = re.compile(r"(\d+\.?\d*|\.\d+)\s*(?:s|sec|seconds)?")


def parse_length(text: str, option: str) -> float:
    """Metres of a length with its unit: "26.4ft", "8 m", "26.4'", "10cm", "30in"; raises UsageError for another text.

    `option`: named in the error.
    """
    match = _LENGTH.fullmatch(text.strip().lower())
    if match is None or match[2] not in _UNITS:
        raise UsageError(
            f"{option}: {text!r} is not a length with its unit. Write feet or metres, as in 26.4ft or 8.05m."
        )
    metres = float(match[1]) * _UNITS[match[2]]
    if metres < 0 or not math.isfinite(metres):
        raise UsageError(f"{option}: {text!r} is negative. Write a length such as 8m.")
    return metres


def parse_memory(text: str, option: str) -> float:
    """Megabytes of a size: "2GB", "500 MB", "1.5 GiB"; raises UsageError for another text. option: as above."""
    match = _LENGTH.fullmatch(text.strip().lower())
    megabytes = 0.0 if match is None else float(match[1]) * _MEGABYTES.get(match[2], 0.0)
    if not 0 < megabytes < math.inf:
        raise UsageError(f"{option}: {text!r} is not a size with its unit. Write 2GB or 500MB.")
    return megabytes


def parse_time(text: str, option: str) -> float:
    """Seconds of a time: "90", "90s", "1:30", "1:02:03.5"; raises UsageError for another text."""
    bare = text.strip().lower()
    if clock := _CLOCK.fullmatch(bare):
        hours, minutes, seconds = int(clock[1] or 0), int(clock[2]), float(clock[3])
        if seconds < 60 and (clock[1] is None or minutes < 60):
            return 3600.0 * hours + 60.0 * minutes + seconds
    elif plain := _SECONDS.fullmatch(bare):
        return float(plain[1])
    raise UsageError(
        f"{option}: {text!r} is not a time after the first image. Write seconds or minutes:seconds, as in 90s or "
        "1:30."
    )
