"""After the last frame: the cross-sections of the road, from the sweeps and the path of the whole drive."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import rank_filter

from wayside.schemas.frame import Pose
from wayside.schemas.roadside import CrossSection, Roadside
from wayside.stages.georeference import DrivePath, scale_near
from wayside.stages.kernels import Array, Flags
from wayside.stages.roadside.breaks import breaks_of
from wayside.stages.roadside.ground import NEIGHBOUR_WEIGHTS, Ground, ground_of, pooled
from wayside.stages.roadside.sweep import HEIGHTS_M, OFFSETS_M, Sweep

LEAST_MARGIN = 0.12
"""Correlation by which the best height must exceed all others (set on rendered drives)."""
UPRIGHT_AGREEMENT = 0.45
"""Images that agree so well on several heights show a rail, a wall or a vehicle (set on rendered drives)."""
STEADY_M, STEADY_OVER = 0.15, 3
"""Ground is this near to the median of so many stations before and behind, of which as many measure it."""
SIGMA_M, SIGMA_FACTOR = 0.018, 0.55
"""Scatter of a height that the correlation does not show, and the factor on what it does (rendered drives)."""
ROLL_SIGMA_DEG = 0.5
"""Scatter of the camera's roll, which tilts the ground if no poses give the vertical."""
ROAD_M = 1.0
"""Half width of the road under the camera, whose height is 0."""
NEAREST_LINE_M = 0.5
"""No line of the own lane is nearer to the path."""
SOLID = 0.5
"""Painted part of the length of a solid line, at least; a usual dash is a quarter of its period."""
SAME_LINE_M = 0.3
"""A line farther from its place at the stations around is another line."""
STEEPEST_PAVED = 0.12
"""Slope of pavement across the road, at most: the greatest superelevation that AASHTO's Green Book allows."""
EDGE_SPAN = 13
"""Stations around, of which three show a solid line farther out: no line is the edge then, as traffic hides it."""


class _Placed(NamedTuple):
    """A sweep on the final path."""

    sweep: Sweep
    world: Pose
    """The path at the station; axes along, right and up, level where the world's up is known."""
    offset: Array
    """To the right of the path, (n,), metres."""
    above: Array
    """Height of the ground above the camera's path, (n,), metres."""
    ground: Ground
    pairs: Array
    lines: Array
    """Offset, m, and painted part, (k, 2)."""


def place_sections(sweeps: Iterator[Sweep], path: DrivePath) -> Iterator[CrossSection]:
    """The cross-sections of a drive in the order of the route."""
    every = list(sweeps)
    scores, pairs = [one.score for one in every], [one.pairs for one in every]
    sums = ((pooled(scores, k), pooled(pairs, k)) for k in range(len(every)))
    placed = [_placed(one, *own, path) for one, own in zip(every, sums, strict=True)]
    camera_m = _camera_height(placed)
    sides = [[_lines(placed, sign, solid=solid) for solid in (False, True)] for sign in (-1, 1)]
    for k, (one, measured) in enumerate(zip(placed, _measured(placed), strict=True)):
        sigma = _sigma(one)
        height = one.above + camera_m
        left, right = (
            _side(one.offset * sign, np.where(measured, height, np.nan), sigma, near[k], edge[k])
            for sign, (near, edge) in zip((-1, 1), sides, strict=True)
        )
        tilt = 0.0 if path.world == "log" else np.radians(ROLL_SIGMA_DEG)
        seen = np.where(measured, "ground", "hidden")
        yield CrossSection(
            station_m=path.station_of(one.sweep.station_m),
            frame=one.sweep.frame,
            camera_m=camera_m,
            offset_m=one.offset,
            height_m=height,
            sigma_m=np.hypot(sigma, tilt * one.offset),
            pairs=one.sweep.pairs,
            status=tuple(np.where(np.isfinite(height), seen, "unseen").tolist()),
            points=one.world.to_world(np.stack([0 * height, one.offset, one.above], axis=-1)),
            sides=(left, right),
        )


def on_road(path: DrivePath, sections: Sequence[CrossSection]) -> DrivePath:
    """The path with the camera's height above the road as measured by the cross-sections, where there are any."""
    known = [one.camera_m for one in sections if np.isfinite(one.camera_m)]
    return replace(path, camera_height_m=known[0]) if known else path


def _placed(sweep: Sweep, score: Array, pairs: Array, path: DrivePath) -> _Placed:
    """A sweep on the final path, its ground by the pooled scores."""
    ground = ground_of(score, pairs, HEIGHTS_M)
    scale = scale_near(path, sweep.frame).factor
    raw = path.poses[sweep.frame].compose(Pose(sweep.place.rotation, scale * sweep.place.centre))
    along, up = raw.rotation[:, 0], raw.rotation[:, 2]
    if path.world == "log":
        up = np.array([0.0, 0.0, 1.0])
    right = np.cross(along, up)
    right /= np.linalg.norm(right)
    level = Pose(np.column_stack([along, right, np.cross(right, along)]), raw.centre)
    turn = level.rotation.T @ raw.rotation
    height = scale * (ground.height - sweep.road_m)
    local = np.stack([0 * height, scale * OFFSETS_M, height], axis=-1) @ turn.T
    offsets = np.where(np.isfinite(height), local[:, 1], scale * OFFSETS_M)
    known = np.where(ground.margin >= LEAST_MARGIN, ground.height - sweep.road_m, np.nan)
    lines = _settled(sweep.lines, known, turn) * (scale, 1.0)
    return _Placed(sweep, level, offsets, local[:, 2], ground, pairs, lines)


def _settled(lines: Array, height: Array, turn: Array) -> Array:
    """Offset and painted part (k, 2) of the lines of a sweep, on ground of these heights (offsets,) above the path.

    `turn` (3, 3): from the axes of the sweep to those of the final path. A ray meets ground farther down farther off,
    so lines on ground of unknown height (nan) are left out. So are those on ground too steep for pavement: rails.
    """
    nearest = np.abs(lines[:, :1] - OFFSETS_M).argmin(axis=1)
    lines, known = lines[np.isfinite(height[nearest])], np.isfinite(height)
    if not len(lines):
        return lines[:, :2]
    aside = lines[:, 0] + np.array([[-0.5], [0.0], [0.5]])
    inner, above, outer = np.interp(aside, OFFSETS_M[known], height[known])
    right = lines[:, 0] * above / lines[:, 2]
    settled = np.column_stack([turn[1, 1] * right + turn[1, 2] * above, lines[:, 1]])
    return np.asarray(settled[np.abs(outer - inner) < STEEPEST_PAVED])


def _camera_height(placed: Sequence[_Placed]) -> float:
    """Height of the camera above the road, the same all the drive; nan where the road is nowhere measured."""
    known = [(abs(p.offset) <= ROAD_M) & (p.ground.margin >= LEAST_MARGIN) for p in placed]
    heights = np.concatenate([*(-p.above[k] for p, k in zip(placed, known, strict=True)), []])
    return float(np.median(heights)) if len(heights) else np.nan


def _measured(placed: Sequence[_Placed]) -> Flags:
    """Whether heights (stations, n) are of ground: sure, in sight, and much the same along the road."""
    sure = [(one.ground.margin >= LEAST_MARGIN) & ~_behind(one.ground) for one in placed]
    heights = [np.where(own, one.above, np.nan) for own, one in zip(sure, placed, strict=True)]
    above = np.array(heights).reshape(-1, len(OFFSETS_M))
    return np.abs(above - _usual(above, STEADY_OVER, STEADY_OVER)) < STEADY_M


def _usual(values: Array, reach: int, least: int) -> Array:
    """Median of values (stations, ...) over so many stations before and behind; nan: fewer than `least` are known."""
    padded = np.pad(values, [(reach, reach)] + [(0, 0)] * (values.ndim - 1), constant_values=np.nan)
    near = np.stack([padded[k : k + len(values)] for k in range(2 * reach + 1)])
    often = np.isfinite(near).sum(axis=0) >= least
    return np.where(often, np.nanmedian(np.where(often, near, 0.0), axis=0), np.nan)


def _behind(ground: Ground) -> Flags:
    """Whether each strip (n,) is upright, or lies behind an upright one as seen from the road."""
    upright = (ground.greatest >= UPRIGHT_AGREEMENT) & (ground.margin <= 0)
    middle = len(OFFSETS_M) // 2
    upright[np.abs(OFFSETS_M) <= ROAD_M] = False
    left = np.logical_or.accumulate(upright[middle::-1])[::-1]
    return np.concatenate([left, np.logical_or.accumulate(upright[middle + 1 :])])


def _sigma(one: _Placed) -> Array:
    """Standard deviation of the heights (n,), metres, by how sharply the images agree on them."""
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = np.sqrt((1 - one.ground.agreement) / (one.ground.curvature * one.pairs))
    return np.hypot(SIGMA_M, SIGMA_FACTOR * spread)


def _lines(placed: Sequence[_Placed], sign: int, *, solid: bool) -> Array:
    """Distance from the path, by station, of the nearest line on one side, or of the outermost solid one; nan: none.

    `sign`: 1 for the right side, -1 for the left. A dashed line is not at every station: those around tell where it is.
    """
    found = np.full(len(placed), np.nan)
    for k, one in enumerate(placed):
        distance, painted = sign * one.lines[:, 0], one.lines[:, 1]
        own = distance[(distance > NEAREST_LINE_M) & (painted >= (SOLID if solid else 0))]
        if len(own):
            found[k] = own.max() if solid else own.min()
    reach = len(NEIGHBOUR_WEIGHTS) - 1
    if solid:
        outermost = rank_filter(np.nan_to_num(found), -reach - 1, EDGE_SPAN, mode="constant")
        found[found < outermost - SAME_LINE_M] = np.nan
    usual = _usual(found, reach, reach + 1)
    return np.where(np.abs(found - usual) < SAME_LINE_M, found, usual)


def _side(distance: Array, height: Array, sigma: Array, line: float, edge: float) -> Roadside:
    """One side of the road; distance (n,): from the path outwards, negative on the other side."""
    own = distance > -ROAD_M
    return replace(breaks_of(distance[own], height[own], sigma[own]), line_m=line, edge_m=edge)
