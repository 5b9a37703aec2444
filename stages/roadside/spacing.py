"""The stage that finds the next sign of the same type ahead of each sign, how far it is, and how the road curves.

The distance runs along the travelled path. Its error is the error of the path between the best images of both signs,
and of each sign relative to its own image. An error that both signs share, as an offset of the fixes, is left out.
"""

import math
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from wayside.schemas.sign_catalogue import SERIES
from wayside.schemas.signs import Sign
from wayside.stages.geometry import frenet_offsets, turn_deg
from wayside.stages.georeference import DrivePath
from wayside.stages.kernels import Array

SAME_WAY_DEG = 45.0
"""Signs that face the same way differ by less: those of a side road face it at right angles."""
RADIUS_REACH_M = 40.0
"""The radius follows from the turn over this distance before and after a sign: less than most curves with signs."""
IN_LANE_RAD = 0.005
"""Scatter of half that turn, as vehicles do not keep to the middle of their lane (estimate)."""
STRAIGHT_SIGMAS = 2.0
"""A road whose curvature is below this many standard deviations is straight: it has no radius."""

LINE_STEP_M = 1.0
"""Longest step of the line through the cameras."""
SHORTEST_M = 1e-3
"""A camera that has moved less stands still."""
NEAR_M = -25.0, 160.0
"""Where the path is abreast of a sign, from the camera of its best image on."""
UNSEEN_CURVATURE = 1 / 400
"""Scatter of the curvature of a road ahead of the last image, 1/m: that of curves which signs warn of (estimate)."""


def measure_spacing(signs: Iterator[Sign], *, path: DrivePath) -> Iterator[Sign]:
    """Signs with the next of the same type ahead, and the radius of the path abreast of them.

    Two signs are of the same type if they have one code, or one colour and shape where the code is not certain. They
    must be on the same side of the path and face the same way, but not share a support. Backs and uncertain signs take
    no part.

    Yields the signs, in order, after the last one came.
    """
    listed = list(signs)
    if not listed:
        return
    row = {frame: row for row, frame in enumerate(path.poses)}
    best = [row[sign.landmark.best_frame] for sign in listed]
    line = PathLine.of(path)
    station = np.array([line.station(s.centre, at) for s, at in zip(listed, best, strict=True)])
    curves = line.radii(station)
    after = _next_of_type(listed, station)
    for k, sign in enumerate(listed):
        curved = replace(sign, radius_m=float(curves[0, k]), sigma_radius_m=float(curves[1, k]))
        if (n := after.get(k)) is None:
            yield curved
            continue
        between = path.length_variance(best[k], best[n])
        own = sum(_own_variance(listed[i], station[i] - line.stations[-1]) for i in (k, n))
        yield replace(
            curved,
            next_number=listed[n].number,
            spacing_m=float(station[n] - station[k]),
            sigma_spacing_m=math.sqrt(between + own),
        )


@dataclass(frozen=True, slots=True)
class PathLine:
    """A smooth line through the cameras of a path: a chord of it turns the foot of a sign in a curve by decimetres.

    `axes` (3,): 1 of those that the line lies in, else 0: it is level where the world is. `points` (m, 3): metres.
    `stations` (m,): distance along it, metres. `rows` (n,): stations of the poses. `ahead` (3,): where the first looks.
    """

    axes: Array
    points: Array
    stations: Array
    rows: Array
    ahead: Array

    @classmethod
    def of(cls, path: DrivePath) -> "PathLine":
        """Cubics through the poses, with the slopes of parabolas there, as points a metre apart at most."""
        poses = list(path.poses.values())
        axes = np.array([1.0, 1.0, 0.0 if path.is_level else 1.0])
        centres = np.array([pose.centre for pose in poses]) * axes
        chords = np.linalg.norm(np.diff(centres, axis=0), axis=1)
        knots = np.concatenate([[0.0], np.cumsum(chords)])
        moved = np.concatenate([[True], chords > SHORTEST_M])
        points, at, own = centres[:1], knots[:1], knots[moved]
        if len(own) > 1:
            ends = np.cumsum([0.0, *np.ceil(np.diff(own) / LINE_STEP_M)])
            at = np.interp(np.arange(ends[-1] + 1), ends, own)
            points = _cubics(at, own, centres[moved])
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        stations = np.concatenate([[0.0], np.cumsum(steps)])
        return cls(axes, points, stations, np.interp(knots, at, stations), poses[0].rotation[:, 2])

    def station(self, point: Array, row: int) -> float:
        """Station of a world point (3,) that the camera of a row sees; the line goes on straight past its ends."""
        near = slice(*np.searchsorted(self.stations, self.rows[row] + np.array(NEAR_M)))
        ups = np.tile([0.0, 0.0, 1.0], (len(self.points[near]), 1))
        along = self.points[near], ups, self.stations[near]
        return frenet_offsets((point * self.axes)[None], *along, self.ahead)[0].station

    def radii(self, stations: Array) -> Array:
        """Radius at stations (k,) by the turn over the reach, and its standard deviation, (2, k), metres.

        Positive in a right turn; nan where the line is straight, or ends within the reach.
        """
        ends = np.stack([stations - RADIUS_REACH_M, stations + RADIUS_REACH_M])
        step = np.diff(self.points[:, :2], axis=0)
        middle = (self.stations[1:] + self.stations[:-1]) / 2
        inside = (ends[0] >= 0) & (ends[1] <= self.stations[-1])
        if not inside.any():
            return np.full((2, len(stations)), math.nan)
        left, right = np.interp(ends, middle, np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
        curvature, sigma = (left - right) / (2 * RADIUS_REACH_M), IN_LANE_RAD / RADIUS_REACH_M
        curved = inside & (np.abs(curvature) > STRAIGHT_SIGMAS * sigma)
        radius = 1 / np.where(curved, curvature, math.nan)
        return np.stack([radius, radius**2 * sigma])


def _cubics(at: Array, knots: Array, points: Array) -> Array:
    """Points (m, 3) at places (m,) of cubics between knots (n,) through points (n, 3), two at least."""
    slopes = np.gradient(points, knots, axis=0, edge_order=2 if len(knots) > 2 else 1)
    k = np.searchsorted(knots[1:-1], at, side="right")
    length = (knots[k + 1] - knots[k])[:, None]
    t = (at - knots[k])[:, None] / length
    chord, first, last = points[k + 1] - points[k], slopes[k] * length, slopes[k + 1] * length
    bend = 3 * chord - 2 * first - last + t * (first + last - 2 * chord)
    return np.asarray(points[k] + t * (first + t * bend))


def _own_variance(sign: Sign, beyond_m: float) -> float:
    """Variance, m^2, of the station of a sign against its camera; beyond the end of the path, it may turn there."""
    turn = UNSEEN_CURVATURE * max(beyond_m, 0.0)
    return float(sign.covariance[2, 2]) + (turn * sign.lateral_m) ** 2


def _next_of_type(signs: list[Sign], station: Array) -> dict[int, int | None]:
    """Rows of the next sign of the same type ahead, by those of signs; station (k,)."""
    ahead: dict[Hashable, list[int]] = {}
    after = {}
    for row in np.argsort(station, kind="stable")[::-1].tolist():
        if (kind := _type_of(signs[row])) is not None:
            same = ahead.setdefault(kind, [])  # the nearest is the last
            after[row] = next((n for n in reversed(same) if _follows(signs[row], signs[n])), None)
            same.append(row)
    return after


def _type_of(sign: Sign) -> Hashable:
    """What signs of one type have in common; None where that is not known."""
    landmark, code = sign.landmark, sign.code
    if sign.status != "sign":
        return None
    if code is not None and code.code not in SERIES[code.system]:
        return code.system, code.code, sign.lateral_m > 0
    if landmark.color is None or landmark.shape is None:
        return None
    return landmark.color, landmark.shape, sign.lateral_m > 0


def _follows(sign: Sign, other: Sign) -> bool:
    """Whether the other is on a support of its own and faces the same way, as far as that is known."""
    turn = turn_deg(sign.landmark.facing_deg, other.landmark.facing_deg)
    return sign.assembly != other.assembly and not abs(turn) > SAME_WAY_DEG
