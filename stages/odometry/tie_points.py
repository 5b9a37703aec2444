"""Tie points of two images: corners are matched in bands along epipolar lines and registered to sub-pixel.

The prediction needs no depth: nearer points lie further out than a point at infinity, on the line from the epipole. So
matches do not depend on the assumed length of the step.
"""

from dataclasses import dataclass
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections
from wayside.schemas.frame import Camera
from wayside.stages.geometry import distort_points, ideal_points, rays_of_ideal
from wayside.stages.kernels import Array, compiled, compiled_within
from wayside.stages.odometry.descriptor_matching import match_in_bands
from wayside.stages.odometry.patch_registration import register_patches

COARSE_BITS, COARSE_RATIO = 64, 0.85
"""Largest distance of the descriptors of a coarse match, bits, and its largest ratio to the second best."""
COARSE_CORNERS = 400
"""Corners of an image that are searched for at most for a start, or to see whether the camera stands."""
GUIDED_BITS, GUIDED_RATIO = 80, 0.92
"""The same along an epipolar line."""
GUIDED_WIDTH_PX = 4.0
"""Half width of the band along an epipolar line."""
SMALLEST_GROWTH, LARGEST_GROWTH = 0.8, 2.6
"""Growth of an object from image to image."""
LONGEST_PX = 500.0
"""Longest displacement by travel."""
NEAR_EPIPOLE_PX, NEAR_EPIPOLE_GROWTH = 20.0, 1.1
"""Nearer to the epipole the growth cannot be measured; what is assumed there."""
CELL_PX, PER_CELL = 100.0, 6
"""Side of a cell of the image, and the matches registered in each cell at most."""
SEARCH_PX, ROAD_SEARCH_PX = 2, 3
"""Whole-pixel search round the expected position, and on the road."""
ROAD_GAP_PX, ROAD_GAP_FRACTION = 3.0, 0.1
"""A match so near to the road's prediction lies on it; a fraction of the displacement is added."""
NEAREST_ROAD_M, FARTHEST_ROAD_M, ROAD_HALF_WIDTH_M = 4.0, 35.0, 5.0
"""Nearest road point, after the step; farthest one ahead, and to the side."""


@dataclass(frozen=True, slots=True)
class KeypointImage:
    """What matching and registration need of one image: corners (n, 2) as recorded and ideal, descriptors (n, 32)."""

    camera: Camera
    grey: NDArray[np.uint8]
    corners: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    ideal: Array

    @staticmethod
    def of(detections: Detections) -> "KeypointImage | None":
        """Of the detections of an image; None where it has no pixels or no camera."""
        camera, grey, features = detections.frame.camera, detections.image.grey, detections.features
        if camera is None or grey is None:
            return None
        return KeypointImage.of_corners(camera, grey, features.corners, features.descriptors)

    @staticmethod
    def of_corners(
        camera: Camera,
        grey: NDArray[np.uint8],
        corners: NDArray[np.float32],
        descriptors: NDArray[np.uint8],
    ) -> "KeypointImage":
        """Of the corners of a grey image."""
        return KeypointImage(camera, grey, corners, descriptors, ideal_points(camera, corners))

    @property
    def stride(self) -> int:
        """One in so many of its corners leaves `COARSE_CORNERS` at most."""
        return len(self.corners) // COARSE_CORNERS + 1

    @property
    def focal_px(self) -> float:
        """Mean of both focal lengths."""
        return 0.5 * (self.camera.fx + self.camera.fy)


class GroundPlane(NamedTuple):
    """The road plane in the axes of the first camera of a pair: down (3,), height of the camera, baseline."""

    down: Array
    height_m: float
    baseline_m: float


@dataclass(frozen=True, slots=True)
class PairMotion:
    """A motion between two images that is to be tried: rotation (3, 3), direction (3,), and the road under them."""

    before: KeypointImage
    now: KeypointImage
    rotation: Array
    direction: Array
    ground: GroundPlane | None = None

    @property
    def view(self) -> "_View":
        """The same for kernels: rotation, direction, both lenses (2, 4) as fx, fy, cx, cy; the road, nan if unknown."""
        lenses = [(c.fx, c.fy, c.cx, c.cy) for c in (self.before.camera, self.now.camera)]
        rotation = np.ascontiguousarray(self.rotation)
        return rotation, self.direction, np.array(lenses), *(self.ground or _NO_GROUND)

    def matches(
        self, slack_px: float, bits: int, ratio: float, every: int = 1
    ) -> NDArray[np.int64]:
        """Rows (n, 2) of matched corners of both images, searched in bands along the epipolar lines; closest first.

        `slack_px`: half width of the bands. `bits`, `ratio`: largest descriptor distance, and its largest ratio to the
        second best. `every`: one in so many corners of the first image is searched for.
        """
        now, codes = self.now, np.ascontiguousarray(self.before.descriptors[::every])
        bands = np.full((len(codes), 6), slack_px)
        _fill_bands(self.view, self.before.ideal, every, bands)
        return match_in_bands(bands, codes, now.ideal, now.descriptors, bits, ratio) * (every, 1)


_View = tuple[Array, Array, Array, Array, float, float]
_NO_GROUND = GroundPlane(np.zeros(3), nan, nan)


@compiled_within
def _seen(view: _View, u: float, v: float, depth: float, travel: float) -> tuple[float, float]:
    # Ideal pixel in the second image, so far along the direction, of the point at a pixel of the first and a depth.
    r, t, (fu, fv, cu, cv) = view[0], view[1], view[2][0]
    x, z = (u - cu) / fu * depth - travel * t[0], depth - travel * t[2]
    y = (v - cv) / fv * depth - travel * t[1]
    ahead = max(r[0, 2] * x + r[1, 2] * y + r[2, 2] * z, 1e-6)
    across, below = r[0, 0] * x + r[1, 0] * y + r[2, 0] * z, r[0, 1] * x + r[1, 1] * y + r[2, 1] * z
    fu, fv, cu, cv = view[2][1]
    return across / ahead * fu + cu, below / ahead * fv + cv


@compiled_within
def _epipole(view: _View) -> tuple[float, float]:
    r, t = view[0], view[1]
    ahead = r[0, 2] * t[0] + r[1, 2] * t[1] + r[2, 2] * t[2]
    return _seen(view, 0.0, 0.0, 0.0, -np.sign(ahead))


@compiled_within
def _on_road(view: _View, u: float, v: float) -> tuple[float, float]:
    # The same of the point of the road.
    (fu, fv, cu, cv), down, height_m, baseline_m = view[2][0], view[3], view[4], view[5]
    depth = height_m / max((u - cu) / fu * down[0] + (v - cv) / fv * down[1] + down[2], 1e-6)
    return _seen(view, u, v, depth, baseline_m)


@compiled
def _fill_bands(view: _View, ideal: Array, every: int, bands: Array) -> None:
    end_u, end_v = _epipole(view)
    for n in range(len(bands)):
        u, v = _seen(view, ideal[n * every, 0], ideal[n * every, 1], 1.0, 0.0)
        reach = np.sqrt((u - end_u) ** 2 + (v - end_v) ** 2)
        bands[n, 0], bands[n, 1], scale = u, v, max(reach, 1e-9)
        bands[n, 2], bands[n, 3] = (u - end_u) / scale, (v - end_v) / scale
        bands[n, 4] = min(reach * (LARGEST_GROWTH - 1), LONGEST_PX)


@compiled
def _fill_starts(
    view: _View, ideal: Array, matched: Array, shifts: Array, starts: Array, warps: Array
) -> None:
    # From the place of a match, ideal and recorded, or, where that is nan, from the ideal one that the road predicts.
    end_u, end_v = _epipole(view)
    for n in range(len(ideal)):
        x, y = ideal[n]
        u, v = _seen(view, x, y, 1.0, 0.0)
        at_u, at_v = matched[n]
        reach, growth = np.sqrt((u - end_u) ** 2 + (v - end_v) ** 2), NEAR_EPIPOLE_GROWTH
        # Growth is the ratio of distances from the epipole; near it the ratio is undefined, and growth is small.
        if reach > NEAR_EPIPOLE_PX:
            growth = np.sqrt((at_u - end_u) ** 2 + (at_v - end_v) ** 2) / reach
            growth = min(max(growth, SMALLEST_GROWTH), LARGEST_GROWTH)
        place = _on_road(view, x, y)
        by_u, by_v = _on_road(view, x + 1.0, y), _on_road(view, x, y + 1.0)
        gap = np.sqrt((place[0] - at_u) ** 2 + (place[1] - at_v) ** 2)
        flow = np.sqrt((place[0] - u) ** 2 + (place[1] - v) ** 2)
        warp, warps[n, 0], warps[n, 1], warps[n, 2] = warps[n], growth, 0.0, growth
        if gap < ROAD_GAP_PX + ROAD_GAP_FRACTION * flow or np.isnan(at_u):
            warp[0], warp[1], warp[2] = by_u[0] - place[0], by_v[0] - place[0], by_v[1] - place[1]
        for k in range(2):
            starts[n, k] = place[k] if np.isnan(at_u) else starts[n, k] + shifts[n, k] * growth


class RegisteredTies(NamedTuple):
    """Registered tie points of a pair.

    `previous`, `current` (n, 2): ideal pixels. `rows` (n, 2): rows of their corners in both images (-1: no match).
    `warp` (n, 3) and `sigma` (n,) of the patch in the second image, as of `register_patches`. `tried`: all rows that
    were registered, with position, warp and sigma (n, 6) (nan: failed).
    """

    previous: Array
    current: Array
    rows: NDArray[np.int64]
    warp: Array
    sigma: Array
    tried: tuple[NDArray[np.int64], Array]


def match_around(
    before: KeypointImage, now: KeypointImage, reach_px: float, ratio: float, every: int = 1
) -> NDArray[np.int64]:
    """Pairs (k, 2) of corners that lie within a distance of each other in two images, whatever the motion.

    `ratio`, `every`: as of `PairMotion.matches`.
    """
    place = before.corners[::every].astype(np.float64)
    around = np.column_stack([place, np.tile([1.0, 0.0, 0.0, reach_px], (len(place), 1))])
    codes = np.ascontiguousarray(before.descriptors[::every])
    others = now.corners.astype(np.float64)
    found = match_in_bands(around, codes, others, now.descriptors, COARSE_BITS, ratio)
    return found * (every, 1)


def register_ties(pair: PairMotion, last: RegisteredTies | None = None) -> RegisteredTies:
    """Match in narrow bands along the epipolar lines of a motion and register every match to sub-pixel.

    Matches that `last` has tried already keep their result: it does not depend on the motion.
    """
    before, now = pair.before, pair.now
    rows = pair.matches(GUIDED_WIDTH_PX, GUIDED_BITS, GUIDED_RATIO)
    rows = rows[_first_of_cells(before.corners[rows[:, 0]], before.grey.shape)]
    found = np.full((len(rows), 6), np.nan)
    fresh = np.ones(len(rows), np.bool_)
    if last is not None:
        keys, known = (one @ [len(now.corners), 1] for one in (rows, last.tried[0]))
        _, here, there = np.intersect1d(keys, known, assume_unique=True, return_indices=True)
        found[here] = last.tried[1][there]
        fresh[here] = False
    found[fresh] = _register(pair, rows[fresh])
    return _registered(pair, rows, found)


def _register(pair: PairMotion, rows: NDArray[np.int64]) -> Array:
    """Positions of the first image's corners in the second one, recorded pixels, with warp and sigma: (n, 6).

    The position is nan where they are not found. Corners without a match are searched for on the road.
    """
    before, now = pair.before, pair.now
    start = before.corners[rows[:, 0]].astype(np.float64)
    corners = np.rint(start)
    starts, warps = now.corners[rows[:, 1]].astype(np.float64), np.empty((len(rows), 3))
    ideal, matched, search = before.ideal[rows[:, 0]], now.ideal[rows[:, 1]], SEARCH_PX
    road = len(rows) > 0 and rows[0, 1] < 0
    if road:
        ideal, search = ideal_points(before.camera, corners), ROAD_SEARCH_PX
        matched[:] = nan
    _fill_starts(pair.view, ideal, matched, corners - start, starts, warps)
    if road:
        starts = distort_points(now.camera, starts)
    whole = corners.astype(np.int64)
    registered = register_patches(before.grey, now.grey, whole, starts, warps, search)
    return np.column_stack([registered.point, warps * registered.scale[:, None], registered.sigma])


def _registered(pair: PairMotion, rows: NDArray[np.int64], found: Array) -> RegisteredTies:
    good = np.isfinite(found[:, 0])
    return RegisteredTies(
        ideal_points(pair.before.camera, np.rint(pair.before.corners[rows[good, 0]])),
        ideal_points(pair.now.camera, found[good, :2]),
        rows[good],
        found[good, 2:5],
        found[good, 5],
        (rows, found),
    )


def register_road(pair: PairMotion, ground: GroundPlane, tied: RegisteredTies) -> RegisteredTies:
    """The ties with more on the road: unmatched corners, registered at the position that the ground plane predicts.

    Their rows are -1: they take part in no comparison of lengths, which the ground plane would bias.
    """
    before = pair.before
    rays = rays_of_ideal(before.camera, before.ideal)
    depth = ground.height_m / np.maximum(rays @ ground.down[:2] + ground.down[2], 1e-6)
    free = (depth > ground.baseline_m + NEAREST_ROAD_M) & (depth < FARTHEST_ROAD_M)
    free &= np.abs(rays[:, 0] * depth) < ROAD_HALF_WIDTH_M
    free[tied.tried[0][:, 0]] = False
    near = np.flatnonzero(free)
    near = near[_first_of_cells(before.corners[near], before.grey.shape)]
    rows = np.column_stack([near, np.full(len(near), -1)])
    added = _registered(pair, rows, _register(pair, rows))
    added.rows[:] = -1
    columns = zip(tied[:5], added[:5], strict=True)
    return RegisteredTies._make([*map(np.concatenate, columns), tied.tried])


@compiled
def _first_of_cells(places: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    # Which places (n, 2) px are among the first of their square cell of an image.
    count = np.zeros((int(shape[1] / CELL_PX) + 1, int(shape[0] / CELL_PX) + 1), np.int64)
    kept = np.empty(len(places), np.bool_)
    for i in range(len(places)):
        column, row = int(places[i, 0] / CELL_PX), int(places[i, 1] / CELL_PX)
        kept[i] = count[column, row] < PER_CELL
        count[column, row] += 1
    return kept
