"""Values that come with times: kept for a while, and asked for at the times of images."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Generic, TypeVar

from wayside.pipeline.reading.contents import PoseContent, Quaternion
from wayside.schemas.frame import Fix, turn_deg
from wayside.schemas.settings import ReadSettings

V = TypeVar("V")

MOST_SAMPLES = 8192
"""Bounds the memory of a series."""


class TimeSeries(Generic[V]):
    """The latest samples of a value, sorted by time, with at most `MOST_SAMPLES` held."""

    def __init__(self) -> None:
        self.times: list[int] = []
        self.values: list[V] = []

    def add(self, time_ns: int, value: V) -> None:
        """Put a sample in its place; one at the same time replaces the older."""
        if not self.times or time_ns > self.times[-1]:
            self.times.append(time_ns)
            self.values.append(value)
        else:
            place = bisect_left(self.times, time_ns)
            if self.times[place] == time_ns:
                self.values[place] = value
            else:
                self.times.insert(place, time_ns)
                self.values.insert(place, value)
        if len(self.times) > 2 * MOST_SAMPLES:
            del self.times[:MOST_SAMPLES], self.values[:MOST_SAMPLES]

    def reaches(self, time_ns: int) -> bool:
        """Whether all has come that tells the value at this time: a sample at it or one behind it, of two at least."""
        times = self.times
        return bool(times) and (times[-1] == time_ns or (times[-1] > time_ns and len(times) > 1))

    def latest(self, time_ns: int) -> V | None:
        """The sample at or before this time, else the first one held."""
        if not self.times:
            return None
        return self.values[max(bisect_right(self.times, time_ns) - 1, 0)]

    def span_ns(self, time_ns: int) -> int:
        """Time between the two samples round this one, or the nearest two; 0 at a sample, or with fewer than two."""
        times = self.times
        place = bisect_left(times, time_ns)
        if len(times) < 2 or (place < len(times) and times[place] == time_ns):
            return 0
        before = min(max(place - 1, 0), len(times) - 2)
        return times[before + 1] - times[before]

    def at(
        self, time_ns: int, blend: Callable[[V, V, float], V], settings: ReadSettings
    ) -> V | None:
        """The value at a time: `blend(before, after, fraction)` of its two neighbours.

        None where no samples are near: in a gap wider than `widest_gap_s`, or more than `carried_s` outside.
        """
        times = self.times
        place = bisect_left(times, time_ns)
        if place < len(times) and times[place] == time_ns:
            return self.values[place]
        if len(times) < 2:
            return None
        outside = max(times[0] - time_ns, time_ns - times[-1])
        before = min(max(place - 1, 0), len(times) - 2)
        gap = self.span_ns(time_ns)
        farthest = min(settings.carried_s * 1e9, settings.carried_gaps * gap)
        if outside > farthest or gap > settings.widest_gap_s * 1e9:
            return None
        fraction = (time_ns - times[before]) / gap
        return blend(self.values[before], self.values[before + 1], fraction)


def slerp(first: Quaternion, second: Quaternion, fraction: float) -> Quaternion:
    """Rotation between two unit quaternions at constant rate, the short way (Shoemake 1985); x, y, z, w."""
    cosine = sum(a * b for a, b in zip(first, second, strict=True))
    sign = -1.0 if cosine < 0 else 1.0
    angle = math.acos(min(abs(cosine), 1.0))
    if angle < 1e-6:
        a, b = 1.0 - fraction, fraction * sign
    else:
        a = math.sin((1.0 - fraction) * angle) / math.sin(angle)
        b = math.sin(fraction * angle) / math.sin(angle) * sign
    x, y, z, w = (a * p + b * q for p, q in zip(first, second, strict=True))
    length = math.hypot(x, y, z, w)
    return (x / length, y / length, z / length, w / length)


def blend_poses(first: PoseContent, second: PoseContent, fraction: float) -> PoseContent:
    """Pose between two: translation linear, rotation by slerp; sigmas of the nearer one."""
    near = first if fraction < 0.5 else second
    x, y, z = (
        a + (b - a) * fraction for a, b in zip(first.translation, second.translation, strict=True)
    )
    return PoseContent(
        None,
        first.parent,
        first.child,
        slerp(unit(first.rotation), unit(second.rotation), fraction),
        (x, y, z),
        near.sigma_m,
        near.sigma_rad,
    )


def unit(q: Quaternion) -> Quaternion:
    """A quaternion of length one."""
    length = math.hypot(*q)
    return (q[0] / length, q[1] / length, q[2] / length, q[3] / length)


def blend_fixes(first: Fix, second: Fix, fraction: float) -> Fix:
    """Fix between two, the short way around the earth; sigmas of the nearer one."""
    turn = turn_deg(first.longitude_deg, second.longitude_deg)
    longitude = turn_deg(0.0, first.longitude_deg + turn * fraction)
    rise = second.latitude_deg - first.latitude_deg
    climb = second.altitude_m - first.altitude_m
    return Fix(
        first.latitude_deg + rise * fraction,
        longitude,
        first.altitude_m + climb * fraction,
        (first if fraction < 0.5 else second).sigma_m,
    )
