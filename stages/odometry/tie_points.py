"""Tie points of two images: corners are matched in bands along epipolar lines and registered to sub-pixel.

The prediction needs no depth: nearer points lie further out than a point at infinity, on the line from the epipole. So
matches do not depend on the assumed length of the step.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections
from wayside.schemas.frame import Camera
from wayside.stages.geometry import distort_points, ideal_of_rays, ideal_points, rays_of_ideal
from wayside.stages.kernels import Array, compiled
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

    def far_points(self, rows: NDArray[np.int64] | slice) -> tuple[Array, Array]:
        """Ideal pixels (n, 2) of the first image's corners in the second one, if at infinity, and its epipole (2,)."""
        rays = rays_of_ideal(self.before.camera, self.before.ideal[rows])
        turned = rays @ self.rotation[:2] + self.rotation[2]
        far = ideal_of_rays(self.now.camera, turned[:, :2] / np.maximum(turned[:, 2:], 1e-6))
        toward = self.rotation.T @ self.direction
        epipole = ideal_of_rays(self.now.camera, (toward[:2] / toward[2])[None])[0]
        return far, epipole

    def on_road(self, ideal: Array, ground: GroundPlane) -> tuple[Array, Array]:
        """Ideal pixels (n, 2) of road points in the second image, and the warp (n, 3) of their surroundings."""
        steps = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        rays = rays_of_ideal(self.before.camera, (ideal + steps[:, None]).reshape(-1, 2))
        solid = np.hstack([rays, np.ones((len(rays), 1))])
        depth = ground.height_m / np.maximum(solid @ ground.down, 1e-6)
        local = (solid * depth[:, None] - ground.baseline_m * self.direction) @ self.rotation
        seen = ideal_of_rays(self.now.camera, local[:, :2] / np.maximum(local[:, 2:], 1e-6))
        place, along_u, along_v = seen.reshape(3, -1, 2)
        by_u, by_v = along_u - place, along_v - place
        return place, np.column_stack([by_u[:, 0], by_v[:, 0], by_v[:, 1]])

    def matches(
        self, slack_px: float, bits: int, ratio: float, every: int = 1
    ) -> NDArray[np.int64]:
        """Rows (n, 2) of matched corners of both images, searched in bands along the epipolar lines; closest first.

        `slack_px`: half width of the bands. `bits`, `ratio`: largest descriptor distance, and its largest ratio to the
        second best. `every`: one in so many corners of the first image is searched for.
        """
        some = slice(None, None, every)
        far, epipole = self.far_points(some)
        outward = far - epipole
        reach = np.sqrt(outward[:, 0] ** 2 + outward[:, 1] ** 2)
        outward /= np.maximum(reach, 1e-9)[:, None]
        length = np.minimum(reach * (LARGEST_GROWTH - 1), LONGEST_PX)
        bands = np.column_stack([far, outward, length, np.full(len(far), slack_px)])
        now, codes = self.now, np.ascontiguousarray(self.before.descriptors[some])
        return match_in_bands(bands, codes, now.ideal, now.descriptors, bits, ratio) * (every, 1)


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
    rows = rows[first_of_cells(before.corners[rows[:, 0]], CELL_PX, PER_CELL)]
    found = np.full((len(rows), 6), np.nan)
    fresh = np.ones(len(rows), np.bool_)
    if last is not None:
        keys, known = (one @ [len(now.corners), 1] for one in (rows, last.tried[0]))
        _, here, there = np.intersect1d(keys, known, assume_unique=True, return_indices=True)
        found[here] = last.tried[1][there]
        fresh[here] = False
    found[fresh] = _register(pair, rows[fresh])
    good = np.isfinite(found[:, 0])
    corners = np.rint(before.corners[rows[good, 0]]).astype(np.float64)
    return RegisteredTies(
        ideal_points(before.camera, corners),
        ideal_points(now.camera, np.ascontiguousarray(found[good, :2])),
        rows[good],
        found[good, 2:5],
        found[good, 5],
        (rows, found),
    )


def _register(pair: PairMotion, rows: NDArray[np.int64]) -> Array:
    """Positions of the first image's corners in the second one, recorded pixels, with warp and sigma: (n, 6).

    The position is nan where they are not found.
    """
    before, now = pair.before, pair.now
    far, epipole = pair.far_points(rows[:, 0])
    matched = now.ideal[rows[:, 1]]
    corners = np.rint(before.corners[rows[:, 0]]).astype(np.int64)
    # Growth is the ratio of distances from the epipole; near it the ratio is undefined, and growth is small.
    reach = np.linalg.norm(far - epipole, axis=1)
    growth = np.linalg.norm(matched - epipole, axis=1) / np.maximum(reach, 1e-9)
    growth = np.clip(growth, SMALLEST_GROWTH, LARGEST_GROWTH)
    growth = np.where(reach > NEAR_EPIPOLE_PX, growth, NEAR_EPIPOLE_GROWTH)
    shift = corners - before.corners[rows[:, 0]].astype(np.float64)
    starts = np.ascontiguousarray(now.corners[rows[:, 1]] + shift * growth[:, None])
    warps = np.column_stack([growth, np.zeros(len(growth)), growth])
    if pair.ground is not None:
        place, on_road = pair.on_road(before.ideal[rows[:, 0]], pair.ground)
        gap = np.linalg.norm(place - matched, axis=1)
        flow = np.linalg.norm(place - far, axis=1)
        flat = gap < ROAD_GAP_PX + ROAD_GAP_FRACTION * flow
        warps[flat] = on_road[flat]
    registered = register_patches(before.grey, now.grey, corners, starts, warps, SEARCH_PX)
    return np.column_stack([registered.point, warps * registered.scale[:, None], registered.sigma])


def register_road(pair: PairMotion, ground: GroundPlane, tied: RegisteredTies) -> RegisteredTies:
    """The ties with more on the road: unmatched corners, registered at the position that the ground plane predicts.

    Their rows are -1: they take part in no comparison of lengths, which the ground plane would bias.
    """
    before, now = pair.before, pair.now
    free = np.ones(len(before.corners), np.bool_)
    free[tied.tried[0][:, 0]] = False
    rows = np.flatnonzero(free)
    rays = rays_of_ideal(before.camera, before.ideal[rows])
    depth = ground.height_m / np.maximum(rays @ ground.down[:2] + ground.down[2], 1e-6)
    near = (depth > ground.baseline_m + NEAREST_ROAD_M) & (depth < FARTHEST_ROAD_M)
    rows = rows[near & (np.abs(rays[:, 0] * depth) < ROAD_HALF_WIDTH_M)]
    rows = rows[first_of_cells(before.corners[rows], CELL_PX, PER_CELL)]
    corners = np.rint(before.corners[rows]).astype(np.int64)
    ideal = ideal_points(before.camera, corners.astype(np.float64))
    place, warps = pair.on_road(ideal, ground)
    starts = distort_points(now.camera, place)
    found = register_patches(before.grey, now.grey, corners, starts, warps, ROAD_SEARCH_PX)
    good = found.zncc > 0
    return RegisteredTies(
        np.vstack([tied.previous, ideal[good]]),
        np.vstack([tied.current, ideal_points(now.camera, found.point[good])]),
        np.vstack([tied.rows, np.full((int(good.sum()), 2), -1)]),
        np.vstack([tied.warp, (warps * found.scale[:, None])[good]]),
        np.concatenate([tied.sigma, found.sigma[good]]),
        tied.tried,
    )


def first_of_cells(places: NDArray[np.float32], side_px: float, most: int) -> NDArray[np.bool_]:
    """Which places (n, 2) px are among the first `most` of their square cell of an image."""
    cell = np.floor(places / side_px).astype(np.int64)
    kept = np.empty(len(cell), np.bool_)
    _keep_first(cell, most, np.zeros(cell.max(axis=0, initial=0) + 1, np.int64), kept)
    return kept


@compiled
def _keep_first(
    cell: NDArray[np.int64], most: int, count: NDArray[np.int64], kept: NDArray[np.bool_]
) -> None:
    for i in range(len(kept)):
        kept[i] = count[cell[i, 0], cell[i, 1]] < most
        count[cell[i, 0], cell[i, 1]] += 1
