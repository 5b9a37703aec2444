"""Assemblies: panels of one support get one number; a panel measured twice is reported once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.settings import AssemblySettings
from wayside.stages.mapping.verdicts import VerdictRevision, same_panel, same_station


def assemble(tracked: Iterator[TrackedFrame], settings: AssemblySettings) -> Iterator[TrackedFrame]:
    """Refuse later landmarks of one panel (`duplicate`) and number the supports from 0, in order of appearance.

    Parameters
    ----------
    tracked
        Frames with the landmarks seen first in them.
    settings
        Distances between panels of one support.
    """
    revision = VerdictRevision()
    recent: list[Landmark] = []
    count = 0
    for frame in tracked:
        landmarks = []
        for one in frame.landmarks:
            if one.verdict == "sign":
                if any(same_panel(one, other, settings) for other in recent):
                    one = replace(one, verdict="duplicate")
                else:
                    near = (p.assembly for p in recent if same_support(one, p, settings))
                    one = replace(one, assembly=next(near, count))
                    count += one.assembly == count
                    recent.append(one)
            landmarks.append(one)
        yield revision.apply(frame, landmarks)
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
