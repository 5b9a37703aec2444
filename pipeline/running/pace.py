"""Frames at the speed at which they were recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from wayside.schemas.frame import Frame


def paced(
    frames: Iterator[Frame],
    rate: float,
    *,
    now: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Frame]:
    """Hold each frame back until its time has come, counted from the first, at `rate` times the recorded speed.

    A frame that comes late goes on at once, and the later ones keep to the same clock.
    """
    start: float | None = None
    first_ns = 0
    for frame in frames:
        if start is None:
            start, first_ns = now(), frame.time_ns
        wait = start + (frame.time_ns - first_ns) / 1e9 / rate - now()
        if wait > 0:
            sleep(wait)
        yield frame
