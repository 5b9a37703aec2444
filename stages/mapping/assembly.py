"""Assemblies: panels of one support get one number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.settings import AssemblySettings


def assemble(tracked: Iterator[TrackedFrame], settings: AssemblySettings) -> Iterator[TrackedFrame]:
    """Number the supports of signs from 0, in order of appearance.

    Parameters
    ----------
    tracked
        Frames with the landmarks seen first in them.
    settings
        Distances between panels of one support.
    """
    recent: list[Landmark] = []
    count = 0
    for frame in tracked:
        landmarks = []
        for one in frame.landmarks:
            if one.verdict == "sign":
                near = (p.assembly for p in recent if same_support(one, p, settings))
                one = replace(one, assembly=next(near, count))
                count += one.assembly == count
                recent.append(one)
            landmarks.append(one)
        yield replace(frame, landmarks=tuple(landmarks))
        if frame.motion is not None:
            passed_m = frame.motion.station_m - settings.remember_m
            recent = [p for p in recent if p.station_m > passed_m]


def same_support(one: Landmark, other: Landmark, settings: AssemblySettings) -> bool:
    """Whether two panels hang on one support: above or beside each other without much between."""
    right, above = abs(one.right_m - other.right_m), abs(one.above_m - other.above_m)
    between = max(
        right - (one.width_m + other.width_m) / 2, above - (one.height_m + other.height_m) / 2
    )
    return bool(
        min(right, above) < settings.support_m
        and between < settings.support_m
        and same_station(one, other, settings)
    )


def same_station(one: Landmark, other: Landmark, settings: AssemblySettings) -> bool:
    """Whether two landmarks may stand at one station, by the scatter of both along the path."""
    variance = one.covariance[2, 2] + other.covariance[2, 2]
    scatter = min(settings.along_most_m, settings.along_sigmas * float(np.sqrt(variance)))
    return abs(one.station_m - other.station_m) < max(settings.support_m, scatter)
