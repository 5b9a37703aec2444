"""Brings together what belongs together: one panel reported once, panels of one support under one number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.stages.mapping.revision import Revision

SUPPORT_M = 0.6
"""Panels whose centres lie nearer than this beside and along the path, with less between them, share a support."""
SAME_SHARE = 0.4
"""Centres nearer than this share of the mean width and height are one panel's."""
REMEMBER_M = 60.0
"""Stretch of path over which earlier places are compared with new ones."""


def assemble(settled: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Drop second places of one panel (`duplicate`) and number the supports.

    A place given earlier stays; a later one of the same panel gives way. Numbers of supports count
    from 0 in the order of appearance.

    Parameters
    ----------
    settled
        Frames with the places seen first in them.
    """
    revision = Revision()
    recent: list[Landmark] = []
    count = 0
    for item in settled:
        places = []
        for place in item.places:
            if place.verdict != "sign":
                places.append(place)
                continue
            if any(same_panel(place, other) for other in recent):
                places.append(replace(place, verdict="duplicate"))
                continue
            support = next((p.assembly for p in recent if same_support(place, p)), count)
            count += support == count
            placed = replace(place, assembly=support)
            recent.append(placed)
            places.append(placed)
        yield revision.apply(item, places)
        if item.motion is not None:
            recent = _still_near(recent, item.motion.station_m)


def same_panel(one: Landmark, other: Landmark) -> bool:
    """Whether two places are one panel: centres close in its plane, and along the path as sure as they are."""
    wide, tall = (one.width_m + other.width_m) / 2, (one.height_m + other.height_m) / 2
    right, above = np.abs(one.offset[:2] - other.offset[:2])
    return bool(
        right < SAME_SHARE * wide
        and above < SAME_SHARE * tall
        and abs(one.station_m - other.station_m) < _reach(one, other)
    )


def same_support(one: Landmark, other: Landmark) -> bool:
    """Whether two panels hang on one support: above or beside each other without much between."""
    right, above = np.abs(one.offset[:2] - other.offset[:2])
    between = max(
        right - (one.width_m + other.width_m) / 2, above - (one.height_m + other.height_m) / 2
    )
    stacked = right < SUPPORT_M or above < SUPPORT_M
    return bool(
        stacked
        and between < SUPPORT_M
        and abs(one.station_m - other.station_m) < _reach(one, other)
    )


def _reach(one: Landmark, other: Landmark) -> float:
    """How far apart along the path two measurements of one station may lie, metres."""
    variance = one.covariance[2, 2] + other.covariance[2, 2]
    return max(SUPPORT_M, min(2.0, 2.5 * float(np.sqrt(variance))))


def _still_near(places: Sequence[Landmark], station: float) -> list[Landmark]:
    return [p for p in places if p.station_m > station - REMEMBER_M]
