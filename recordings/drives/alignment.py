"""Road geometry: centre line by curvature along station, hill profile, cross-section.

Station s (m) runs along the centre line, t (m) is the offset to the right of it.
World: x east, y north, z up, metres.
"""

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from recordings.drives.arrays import Floats
from recordings.drives.spec import RoadSpec

STEP_M = 0.5
BEHIND_M = 60.0
TRANSITION_M = 40.0

_Side: TypeAlias = tuple[tuple[float, float], ...]


def _section(right: _Side, left: _Side | None = None) -> Floats:
    """Cross-section (n, 2): offset t and height above the centre line, from pairs going outwards."""
    mirrored = [(-t, height) for t, height in reversed(right if left is None else left)]
    return np.array([*mirrored, (0.0, 0.0), *right], np.float64)


_SECTIONS = {
    "two_lane": _section(((5.8, -0.12), (9.5, -1.0), (14, -0.5), (40, -0.3), (400, -0.6))),
    "forest": _section(((5.2, -0.1), (7.5, -0.5), (12, 0.3), (40, 1.0), (400, 2.0))),
    "four_lane": _section(
        ((7.2, -0.15), (12.5, -1.3), (18, -0.6), (45, -0.5), (400, -0.6)),
        (
            (5.6, -0.15),
            (12, -0.9),
            (19, -0.2),
            (25, 0),
            (32, -0.2),
            (37, -0.9),
            (60, -0.5),
            (400, -0.6),
        ),
    ),
    "street": _section(((6.0, -0.08), (6.15, 0.08), (9, 0.12), (40, 0.3), (400, 0.2))),
}
_TRAVEL_OFFSET_M = {"two_lane": 1.8, "forest": 1.75, "four_lane": 1.8, "street": 1.9}


@dataclass(frozen=True, slots=True)
class RoadAlignment:
    """Sampled centre line, queried at stations and offsets; the arrays of one sample have shape (n,)."""

    station: Floats  # m
    x: Floats
    y: Floats
    heading: Floats  # rad, counter-clockwise from east
    curvature: Floats  # 1/m, right turn positive
    z: Floats
    section_t: Floats  # offsets of the cross-section, m
    section_dz: Floats  # its heights above the centre line, m
    travel_offset_m: float

    def at(self, values: Floats, s: Floats | float) -> Floats:
        """A sampled quantity at station s."""
        return np.asarray(np.interp(s, self.station, values))

    def surface(self, s: Floats | float, t: Floats | float) -> Floats:
        """World points (..., 3) on the ground."""
        stations, offsets = np.broadcast_arrays(np.asarray(s, float), np.asarray(t, float))
        heading = self.at(self.heading, stations)
        east = self.at(self.x, stations) + offsets * np.sin(heading)
        north = self.at(self.y, stations) - offsets * np.cos(heading)
        rise = np.interp(offsets, self.section_t, self.section_dz)
        return np.stack([east, north, self.at(self.z, stations) + rise], axis=-1)

    def axes(self, s: float) -> tuple[Floats, Floats, Floats]:
        """Unit vectors (forward along the grade, right, up) in the world at station s."""
        heading = float(self.at(self.heading, s))
        ahead, behind = s + 2.0, s - 2.0
        grade = float(self.at(self.z, ahead) - self.at(self.z, behind)) / 4.0
        forward = np.array([np.cos(heading), np.sin(heading), grade])
        forward /= np.linalg.norm(forward)
        right = np.array([np.sin(heading), -np.cos(heading), 0.0])
        return forward, right, np.cross(right, forward)

    def level_forward(self, s: float) -> Floats:
        """Unit vector along the road at station s, without its grade."""
        forward, _, _ = self.axes(s)
        level = np.array([forward[0], forward[1], 0.0])
        level /= np.hypot(forward[0], forward[1])
        return level


def _curvature(road: RoadSpec, station: Floats) -> Floats:
    """Curvature of the segments at the stations, eased over the length of a transition."""
    starts = np.cumsum([0.0] + [length for length, _ in road.segments])
    raw = np.zeros_like(station)
    for start, (length, radius) in zip(starts, road.segments, strict=False):
        inside = (station >= start) & (station < start + length)
        raw[inside] = 1.0 / radius if radius else 0.0
    window = np.ones(int(TRANSITION_M / STEP_M)) / int(TRANSITION_M / STEP_M)
    padded = np.pad(raw, len(window), mode="edge")
    return np.convolve(padded, window, mode="same")[len(window) : -len(window)]


def build_alignment(road: RoadSpec, heading_deg: float) -> RoadAlignment:
    """The road of a spec, with the travelled lane at station 0 in the world origin."""
    total = sum(length for length, _ in road.segments)
    station = np.arange(-BEHIND_M, total + STEP_M, STEP_M)
    curvature = _curvature(road, station)
    turn = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * STEP_M)])
    heading = np.radians(90.0 - heading_deg) - turn
    middle = (heading[1:] + heading[:-1]) / 2
    x = np.concatenate([[0.0], np.cumsum(np.cos(middle) * STEP_M)])
    y = np.concatenate([[0.0], np.cumsum(np.sin(middle) * STEP_M)])
    z = np.zeros_like(station)
    for amplitude, wavelength, phase in road.hills:
        z += amplitude * np.sin(2 * np.pi * station / wavelength + phase)
    section_t, section_dz = _SECTIONS[road.kind].T
    lane = _TRAVEL_OFFSET_M[road.kind]
    raised = RoadAlignment(station, x, y, heading, curvature, z, section_t, section_dz, lane)
    origin = raised.surface(0.0, lane)
    return replace(raised, x=x - origin[0], y=y - origin[1], z=z - origin[2])
