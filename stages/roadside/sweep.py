"""Plane sweep over strips of ground along the road, two neighbouring images at a time.

The ground abreast of a station is measured once the vehicle has passed it, because the path there is known then. A
patch of ground at an assumed height is sampled in each image that shows it. An error dh of the height moves it by
b dh / H along the road from one image to the next, for cameras b apart and H above the patch. So the samples of two
images agree best at the right height (Collins 1996, space sweep).
"""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from wayside.schemas.frame import Pose
from wayside.schemas.motion import PosedDetections
from wayside.stages.kernels import Array, Floats, Numbers
from wayside.stages.mapping import USUAL_CAMERA_M
from wayside.stages.roadside.ground import ground_of
from wayside.stages.roadside.images import GroundImage, agreement, ground_image
from wayside.stages.roadside.lines import COLUMN_M, painted_lines

STATION_M = 8.0
"""Distance of two profiles along the route."""
OFFSETS_M = np.arange(-12.0, 12.5, 1.0)
"""Middles of the strips, to the right of the path."""
HEIGHTS_M = np.arange(-1.9, 1.05, 0.1)
"""Assumed heights above the road: they leave room for a camera of 0.8 to 3 m."""
ALONG_M = np.arange(-4.0, 4.05, 0.25)
"""Points of a line of a patch, along the road."""
ACROSS_M = np.linspace(-0.36, 0.36, 5)
"""Lines of a patch, across the road."""
SHORTEST_STEP_M = 4.0
"""Images nearer to the one before are not compared: their parallax is too small."""
NEAREST_M, FARTHEST_M = 3.0, 36.0
"""Distance of the middle of a patch ahead of a camera: farther off a pixel covers too much of the road."""
HELD_IMAGES = 4
"""Images in colour and full size that take as much memory as all those that are held at `SHORTEST_STEP_M`."""
SMALL_M = 0.4
"""Ground along the road that a pixel may cover in the size of the image that is taken."""
LINES_REACH_M = 8.0
"""Painted lines are searched up to this distance from the path."""


class Sweep(NamedTuple):
    """What the images show of the ground abreast of one station."""

    frame: int
    """Last frame before the station."""
    station_m: float
    """As first taken, like `Motion.station_m`."""
    place: Pose
    """In the camera frame of `frame`: the path at the station; axes along, right and up as columns."""
    road_m: float
    """Height of the camera above the road, as the heights were assumed."""
    score: Floats
    """Sum of the correlations of each strip at each height, (offsets, heights)."""
    pairs: Numbers
    """Pairs of images in that sum, by strip, (offsets,)."""
    lines: Array
    """Offset to the right, m, painted part of the length, and assumed height above the path, m, of each painted line,
    (k, 3)."""


def sweep_roadside(
    posed: Iterator[PosedDetections], sweeps: list[Sweep]
) -> Iterator[PosedDetections]:
    """Pass every frame on, and add to `sweeps` what the images show of the ground that the vehicle has passed."""
    held: deque[GroundImage] = deque()
    for item in posed:
        motion, camera, grey = item.motion, item.frame.camera, item.detections.image.grey
        if motion is not None and camera is not None and grey is not None:
            last = held[-1].motion.station_m if held else -np.inf
            if motion.station_m - last >= SHORTEST_STEP_M:
                held.append(ground_image(grey, camera, item.frame.index, motion))
                sweeps += _swept(held)
                while motion.station_m - held[0].motion.station_m > FARTHEST_M + STATION_M:
                    held.popleft()
        yield item


def _swept(held: deque[GroundImage]) -> Iterator[Sweep]:
    """Sweeps of the stations between the last two images."""
    if len(held) < 2:
        return
    before, after = held[-2], held[-1]
    known = after.motion.camera_height_m
    road_m = known if np.isfinite(known) else USUAL_CAMERA_M
    first, last = before.motion.station_m, after.motion.station_m
    for number in range(int(np.ceil(first / STATION_M)), int(np.ceil(last / STATION_M))):
        station = number * STATION_M
        place = _place(held, (station - first) / (last - first))
        score, pairs = _scores(held, place, road_m)
        lines = _lines(held, place, ground_of(score, pairs, HEIGHTS_M).height - road_m)
        near = place.relative_to(before.motion.pose)
        yield Sweep(before.frame, station, near, road_m, score, pairs, lines)


def _place(held: deque[GroundImage], share: float) -> Pose:
    """The path at a share of the way between the last two images, its axes along, right and up."""
    start, end = (image.motion.pose.centre for image in (held[-2], held[-1]))
    along = (end - start) / np.linalg.norm(end - start)
    up = -np.mean([image.motion.pose.rotation[:, 1] for image in held], axis=0)
    up -= (up @ along) * along
    up /= np.linalg.norm(up)
    return Pose(np.column_stack([along, np.cross(along, up), up]), start + share * (end - start))


def _scores(held: deque[GroundImage], place: Pose, road_m: float) -> tuple[Floats, Numbers]:
    """Sum of the correlations of all pairs at each strip and height, and the number of pairs of each strip."""
    shape = len(OFFSETS_M), len(HEIGHTS_M), len(ACROSS_M)
    right = np.broadcast_to((OFFSETS_M[:, None] + ACROSS_M)[:, None], shape).flatten()
    up = np.broadcast_to((HEIGHTS_M - road_m)[:, None], shape).flatten()
    score, pairs, former = np.zeros(shape[:2], np.float32), np.zeros(shape[0], np.int64), None
    for image in held:
        ahead, samples = image.ahead(place), None
        if NEAREST_M < ahead < FARTHEST_M:
            level = image.level(ahead**2 / road_m, SMALL_M)
            flat = image.samples(place, ALONG_M, right, up, level)
            samples = flat.reshape(-1, shape[2], len(ALONG_M))
        if former is not None and samples is not None:
            found = agreement(former, samples).reshape(shape[:2])
            seen = np.isfinite(found).all(axis=1)
            score[seen] += found[seen]
            pairs += seen
        former = samples
    return score, pairs


def _lines(held: deque[GroundImage], place: Pose, height: Array) -> Array:
    """As in `Sweep`, on ground of these heights (offsets,) above the path."""
    known = np.isfinite(height)
    if not known.any():
        return np.zeros((0, 3))
    columns = np.arange(-LINES_REACH_M, LINES_REACH_M, COLUMN_M)
    up = np.interp(columns, OFFSETS_M[known], height[known])
    strip = np.full((len(columns), len(ALONG_M)), np.nan, np.float32)
    for image in reversed(held):  # each column from the nearest image that shows it
        ahead = image.ahead(place)
        if NEAREST_M < ahead < FARTHEST_M:
            seen = image.samples(place, ALONG_M, columns, up, image.level(ahead, COLUMN_M))
            strip = np.where(np.isfinite(strip), strip, seen)
    lines = painted_lines(strip)
    offset = columns[0] + COLUMN_M * lines[:, 0]
    return np.column_stack([offset, lines[:, 1], np.interp(offset, columns, up)])
