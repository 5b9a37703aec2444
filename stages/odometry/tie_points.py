"""Tie points of two pictures: match corners in bands, register them to a hundredth of a pixel.

Prediction needs no depth: from where a point at infinity would stand, nearer ones lie further out on the line from
the focus of expansion. So a step that is longer than thought cannot confirm the wrong length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections
from wayside.schemas.frame import Camera
from wayside.stages.geometry import distort_points, ideal_of_rays, ideal_points, rays_of_ideal
from wayside.stages.kernels import Array
from wayside.stages.odometry.descriptor_matching import match_in_bands
from wayside.stages.odometry.patch_registration import register_patches

GUIDED_BITS, GUIDED_RATIO = 80, 0.92
"""Descriptor distance of a match in narrow bands, and its share of the next best's."""
LARGEST_GROWTH = 2.6
"""Nothing that grows more than this between two pictures is matched."""
LONGEST_PX = 500.0
GUIDED_WIDTH_PX = 4.0
CELL_PX, PER_CELL = 100.0, 6
"""Matches that are registered: at most so many of the best in each cell of the picture."""
NEAR_EPIPOLE_PX = 20.0
ROAD_GAP_PX, ROAD_GAP_SHARE = 3.0, 0.1
"""A match this near to where a road point would be, or this share of its way, is taken to lie on the road."""
NEAREST_ROAD_M, FARTHEST_ROAD_M, ROAD_HALF_WIDTH_M, ROAD_SEARCH_PX = 4.0, 35.0, 5.0, 3
ALIKE = 0.85
"""Smallest correlation of a registered patch."""
REGISTERED_SIGMA_PX = 0.08


@dataclass(frozen=True, slots=True)
class KeypointImage:
    """What ties need of one picture."""

    camera: Camera
    grey: NDArray[np.uint8]
    corners: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    ideal: Array

    @staticmethod
    def of(detections: Detections) -> KeypointImage | None:
        """The view of an image, None where it has no pixels or no camera."""
        camera, grey = detections.frame.camera, detections.image.grey
        if camera is None or grey is None:
            return None
        features = detections.features
        ideal = ideal_points(camera, features.corners)
        return KeypointImage(camera, grey, features.corners, features.descriptors, ideal)

    @property
    def focal_px(self) -> float:
        """Mean of both focal lengths."""
        return 0.5 * (self.camera.fx + self.camera.fy)


class GroundPlane(NamedTuple):
    """The road in the axes of the first camera of a pair: down (3,), unit; height_m of the camera; baseline_m."""

    down: Array
    height_m: float
    baseline_m: float


class RegisteredTies(NamedTuple):
    """Registered tie points of a pair.

    previous, current (n, 2): ideal pixels; rows (n, 2): corners of both pictures they stem from; warp (n, 3): how the
    patch lies in the second picture, and sigma (n,): how far it may slide there, as of `numerics.register`; tried: all
    rows that were registered, with where they were found, warp and sigma (n, 6) (nan: nowhere).
    """

    previous: Array
    current: Array
    rows: NDArray[np.int64]
    warp: Array
    sigma: Array
    tried: tuple[NDArray[np.int64], Array]


def register_ties(
    before: KeypointImage,
    now: KeypointImage,
    rotation: Array,
    direction: Array,
    ground: GroundPlane | None = None,
    last: RegisteredTies | None = None,
) -> RegisteredTies:
    """Match again in narrow bands along the epipolar lines and register every match to sub-pixel.

    Matches that `last` has tried already keep their result: it does not depend on the motion.
    """
    pairs = match_corners(
        before, now, rotation, direction, GUIDED_WIDTH_PX, GUIDED_BITS, GUIDED_RATIO
    )
    pairs = _spread(pairs, before.corners)
    found = np.full((len(pairs), 6), np.nan)
    fresh = np.ones(len(pairs), np.bool_)
    if last is not None:
        keys, known = _keys(pairs, now), _keys(last.tried[0], now)
        _, here, there = np.intersect1d(keys, known, assume_unique=True, return_indices=True)
        found[here] = last.tried[1][there]
        fresh[here] = False
    found[fresh] = _register(before, now, rotation, direction, ground, pairs[fresh])
    good = np.isfinite(found[:, 0])
    corners = np.rint(before.corners[pairs[good, 0]]).astype(np.float64)
    return RegisteredTies(
        ideal_points(before.camera, corners),
        ideal_points(now.camera, np.ascontiguousarray(found[good, :2])),
        pairs[good],
        found[good, 2:5],
        found[good, 5],
        (pairs, found),
    )


def _keys(pairs: NDArray[np.int64], now: KeypointImage) -> NDArray[np.int64]:
    keys: NDArray[np.int64] = pairs[:, 0] * len(now.corners) + pairs[:, 1]
    return keys


def _register(
    before: KeypointImage,
    now: KeypointImage,
    rotation: Array,
    direction: Array,
    ground: GroundPlane | None,
    pairs: NDArray[np.int64],
) -> Array:
    """Where the first picture's corners are in the second one, recorded pixels, with warp and sigma: (n, 6).

    nan where they do not look alike.
    """
    far, epipole = _far_points(before, now, rotation, direction, pairs[:, 0])
    corners = np.rint(before.corners[pairs[:, 0]]).astype(np.int64)
    # Growth from the distances to the epipole; near it they say nothing, and growth is small there.
    reach = np.linalg.norm(far - epipole, axis=1)
    growth = np.linalg.norm(now.ideal[pairs[:, 1]] - epipole, axis=1) / np.maximum(reach, 1e-9)
    growth = np.where(reach > NEAR_EPIPOLE_PX, np.clip(growth, 0.8, LARGEST_GROWTH), 1.1)
    shift = corners - before.corners[pairs[:, 0]].astype(np.float64)
    starts = np.ascontiguousarray(now.corners[pairs[:, 1]] + shift * growth[:, None])
    warps = np.column_stack([growth, np.zeros(len(growth)), growth])
    if ground is not None:
        place, on_road = _on_road(
            before, now, rotation, direction, ground, before.ideal[pairs[:, 0]]
        )
        gap = np.linalg.norm(place - now.ideal[pairs[:, 1]], axis=1)
        flow = np.linalg.norm(place - far, axis=1)
        flat = gap < ROAD_GAP_PX + ROAD_GAP_SHARE * flow
        warps[flat] = on_road[flat]
    registered = register_patches(before.grey, now.grey, corners, starts, warps)
    found = np.column_stack([registered.point, warps * registered.scale[:, None], registered.sigma])
    return np.where(registered.zncc[:, None] >= ALIKE, found, np.nan)


def register_road(
    before: KeypointImage,
    now: KeypointImage,
    rotation: Array,
    direction: Array,
    ground: GroundPlane,
    tied: RegisteredTies,
) -> RegisteredTies:
    """The ties with more on the road: corners whose texture no descriptor holds, sought where the road says.

    Their rows are -1: they take part in no comparison of lengths, which they would confirm.
    """
    free = np.ones(len(before.corners), np.bool_)
    free[tied.tried[0][:, 0]] = False
    rows = np.flatnonzero(free)
    rays = rays_of_ideal(before.camera, before.ideal[rows])
    depth = ground.height_m / np.maximum(rays @ ground.down[:2] + ground.down[2], 1e-6)
    near = (depth > ground.baseline_m + NEAREST_ROAD_M) & (depth < FARTHEST_ROAD_M)
    rows = rows[near & (np.abs(rays[:, 0] * depth) < ROAD_HALF_WIDTH_M)]
    rows = _spread(np.stack([rows, rows], axis=1), before.corners)[:, 0]
    corners = np.rint(before.corners[rows]).astype(np.int64)
    ideal = ideal_points(before.camera, corners.astype(np.float64))
    place, warps = _on_road(before, now, rotation, direction, ground, ideal)
    starts = distort_points(now.camera, place)
    found = register_patches(
        before.grey, now.grey, corners, starts, warps, search_px=ROAD_SEARCH_PX
    )
    good = found.zncc >= ALIKE
    return RegisteredTies(
        np.vstack([tied.previous, ideal[good]]),
        np.vstack([tied.current, ideal_points(now.camera, found.point[good])]),
        np.vstack([tied.rows, np.full((int(good.sum()), 2), -1)]),
        np.vstack([tied.warp, (warps * found.scale[:, None])[good]]),
        np.concatenate([tied.sigma, found.sigma[good]]),
        tied.tried,
    )


def _on_road(
    before: KeypointImage,
    now: KeypointImage,
    rotation: Array,
    direction: Array,
    ground: GroundPlane,
    ideal: Array,
) -> tuple[Array, Array]:
    """Ideal pixels (n, 2) of road points in the second picture, and how their surroundings are warped (n, 3)."""
    centre = ground.baseline_m * direction

    def seen(points: Array) -> Array:
        rays = rays_of_ideal(before.camera, points)
        solid = np.hstack([rays, np.ones((len(rays), 1))])
        depth = ground.height_m / np.maximum(solid @ ground.down, 1e-6)
        local = (solid * depth[:, None] - centre) @ rotation
        return ideal_of_rays(now.camera, local[:, :2] / np.maximum(local[:, 2:], 1e-6))

    place = seen(ideal)
    by_u = seen(ideal + np.array([1.0, 0.0])) - place
    by_v = seen(ideal + np.array([0.0, 1.0])) - place
    return place, np.column_stack([by_u[:, 0], by_v[:, 0], by_v[:, 1]])


def match_corners(
    before: KeypointImage,
    now: KeypointImage,
    rotation: Array,
    direction: Array,
    slack_px: float,
    farthest: int,
    ratio: float,
) -> NDArray[np.int64]:
    """Rows (n, 2) of corners of both views that look alike in bands along the epipolar lines, `slack_px` wide.

    farthest and ratio: descriptor distance of a match, and its share of the next best's.
    """
    far, epipole = _far_points(before, now, rotation, direction, slice(None))
    outward = far - epipole
    reach = np.linalg.norm(outward, axis=1)
    outward /= np.maximum(reach, 1e-9)[:, None]
    length = np.minimum(reach * (LARGEST_GROWTH - 1), LONGEST_PX)
    width = np.full(len(far), slack_px)
    bands = np.column_stack([far, outward, length, width])
    return match_in_bands(
        bands,
        before.descriptors,
        now.ideal,
        now.descriptors,
        farthest=farthest,
        ratio=ratio,
    )


def _far_points(
    before: KeypointImage,
    now: KeypointImage,
    rotation: Array,
    direction: Array,
    rows: NDArray[np.int64] | slice,
) -> tuple[Array, Array]:
    """Ideal pixels (n, 2) in the second picture of the first one's corners at infinity, and its epipole (2,)."""
    rays = rays_of_ideal(before.camera, before.ideal[rows])
    turned = rays @ rotation[:2] + rotation[2]
    ahead = np.maximum(turned[:, 2:], 1e-6)
    far = ideal_of_rays(now.camera, turned[:, :2] / ahead)
    toward = rotation.T @ direction
    epipole = ideal_of_rays(now.camera, (toward[:2] / toward[2])[None])[0]
    return far, epipole


def _spread(pairs: NDArray[np.int64], corners: NDArray[np.float32]) -> NDArray[np.int64]:
    # The first few of each cell; corners come sorted by row, so this takes no part of the cell on purpose.
    cell = np.floor(corners[pairs[:, 0]] / CELL_PX).astype(np.int64)
    key = cell[:, 1] * 10_000 + cell[:, 0]
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    rank = np.arange(len(order)) - np.searchsorted(ordered, ordered)
    kept: NDArray[np.int64] = pairs[np.sort(order[rank < PER_CELL])]
    return kept
