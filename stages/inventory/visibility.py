"""Whether a panel would have shown in the images of a drive, or something nearer hides its place.

A plane sweep (Collins 1996) decides the second.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from wayside.schemas.frame import Camera
from wayside.schemas.settings.merging import ChangeSettings
from wayside.schemas.sightings import Floats, Ints
from wayside.stages.geometry import distort_points, ideal_of_rays

NEAREST_M = 1.0
"""A place nearer to the camera, along its axis, is not in view: no panel is measured from so near."""
OBLIQUE_DEG = 60.0
"""A face seen at a larger angle from its normal is not in view, as in the truth of rendered drives."""
LEAST_CORRELATION = 0.7
"""Correlation of a window with the images before and after for its distance to count (two rendered roads)."""
CORRELATION_MARGIN = 0.1
"""The better of two answers must correlate this much more: level edges correlate at any distance."""
BESIDE = 0.1
"""Fraction of the distance within which an object in front of or behind a place counts as being at it."""

_FORBIDDEN = 1e9
_SAMPLES = 24
"""Samples of a window, each way."""
_DEPTHS = 96
"""Number of depths that are tried, evenly by their inverse."""
_NEAREST = 0.25
"""Nearest depth, as a fraction of the distance of the place."""


@dataclass(frozen=True, slots=True)
class PanelPlaces:
    """Where panels are: n rows, metres and radians, nan where unknown.

    `position` (n, 3): east, north, up. `bearing_rad` (n,): compass direction that the face looks in. `size_m` (n, 2):
    width and height.
    """

    position: Floats
    bearing_rad: Floats
    size_m: Floats


def views_of(
    places: PanelPlaces, centre: Floats, rotation: Floats, camera: Camera, smallest_px: float
) -> tuple[Floats, Floats]:
    """Images in which a panel would show whole, at least so high, and from the front.

    Returns heights (n, k) of n panels in k images, pixels, and boxes (n, k, 4). The height is 0 where one does not
    show. Objects in front of the place (see `measure_occlusion`) and the distortion of the lens are left out.
    `centre` (k, 3): of cameras, metres east, north, up. `rotation` (k, 3, 3): from the camera to these axes.
    `smallest_px`: height of the face.
    """
    n, k = len(places.position), len(centre)
    if not n or not k:
        return np.zeros((n, k)), np.zeros((n, k, 4))
    ray = places.position[:, None] - centre[None]
    right, down, ahead = np.moveaxis(np.einsum("nki,kij->nkj", ray, rotation), 2, 0)
    far = np.maximum(ahead, NEAREST_M)
    u, v = camera.cx + camera.fx * right / far, camera.cy + camera.fy * down / far
    wide, high = camera.fx * places.size_m[:, :1] / far, camera.fy * places.size_m[:, 1:] / far
    box = np.stack([u - wide / 2, v - high / 2, u + wide / 2, v + high / 2], axis=2)
    whole = (box[..., 0] >= 0) & (box[..., 1] >= 0)
    whole &= (box[..., 2] <= camera.width) & (box[..., 3] <= camera.height)
    normal = np.stack([np.sin(places.bearing_rad), np.cos(places.bearing_rad)], axis=1)
    facing = -np.einsum("nki,ni->nk", ray[..., :2], normal) / np.linalg.norm(ray[..., :2], axis=2)
    turned = facing < cos(radians(OBLIQUE_DEG))  # false where the bearing is unknown
    shown = (ahead > NEAREST_M) & whole & (high >= smallest_px) & ~turned
    return np.where(shown, high, 0.0), box


def match_moved(pairs: Ints, distance_m: Floats) -> Ints:
    """Which of the pairs (m, 2) of gone and new panels hold, one to one.

    As many as can, then those of least total distance_m (m,).
    """
    if not len(pairs):
        return np.zeros(0, np.int64)
    gone, new = (np.unique(side, return_inverse=True)[1].ravel() for side in pairs.T)
    count = int(gone.max()) + 1
    # each can stay alone, at a cost that is only paid if it cannot be paired
    alone = np.arange(count)
    cost = np.concatenate([distance_m + 1, np.full(count, _FORBIDDEN)])
    rows, columns = np.append(gone, alone), np.append(new, int(new.max()) + 1 + alone)
    matched = min_weight_full_bipartite_matching(csr_array((cost, (rows, columns))))
    chosen = set(zip(*(side.tolist() for side in matched), strict=True))
    pair = zip(gone.tolist(), new.tolist(), strict=True)
    return np.array([k for k, one in enumerate(pair) if one in chosen], np.int64)


@dataclass(frozen=True, slots=True)
class PlaceImage:
    """An image with its camera relative to a place.

    `grey` (height, width). `rotation` (3, 3): camera to level axes. `centre` (3,): of the camera in these axes, metres,
    the place being their origin.
    """

    grey: NDArray[np.uint8]
    rotation: Floats
    centre: Floats


def measure_occlusion(
    images: Sequence[PlaceImage],
    camera: Camera,
    size_m: tuple[float, float],
    settings: ChangeSettings,
) -> tuple[int, int]:
    """How many images show something beyond the place of a panel, and how many something in front of it.

    What shows there is measured in distance by the images before and after each. Some images tell neither.

    A window of the panel's size is compared with the other images as if it lay at each of many distances. Larger
    windows follow as long as the result is undecided. Objects next to a place count only in the smallest window,
    because they hide nothing. Something that moves with the camera looks farther away than it is: a vehicle ahead hides
    a place unnoticed. `images`: in order of time, with the place in view. `size_m`: width and height of the panel.
    """
    past = hidden = 0
    for k, image in enumerate(images):
        others = [images[i] for i in (k - 1, k + 1) if 0 <= i < len(images)]
        for scale in (1.0, 2.0, 4.0):
            told = _tell(image, others, camera, (scale * size_m[0], scale * size_m[1]), settings)
            if told is None:
                continue
            nearer, beside, beyond = told
            if scale == 1.0:
                nearer = max(nearer, beside)
            else:
                beyond = max(beside, beyond)
            if abs(nearer - beyond) > CORRELATION_MARGIN:
                past, hidden = past + (beyond > nearer), hidden + (nearer > beyond)
                break
    return past, hidden


def _tell(
    image: PlaceImage,
    others: Sequence[PlaceImage],
    camera: Camera,
    size_m: tuple[float, float],
    settings: ChangeSettings,
) -> tuple[float, float, float] | None:
    """Best correlations of a window at distances nearer than the place, at it, and beyond; None: it tells nothing."""
    right, down, ahead = -image.centre @ image.rotation
    across, sides = np.linspace(-0.5, 0.5, _SAMPLES), ((right, size_m[0]), (down, size_m[1]))
    x, y = np.meshgrid(*((middle + across * side) / ahead for middle, side in sides))
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    window = _sampled(image, rays[None], camera)[0]
    if not np.isfinite(window).all():
        return None
    inverse = np.linspace(1 / settings.farthest_m, 1 / (_NEAREST * ahead), _DEPTHS)
    points = (rays @ image.rotation.T) / inverse[:, None, None] + image.centre
    scores = [_correlations(window, other, points, camera) for other in others]
    told = np.array([score for score in scores if np.isfinite(score).any()])
    if not len(told):
        return None
    known = np.isfinite(told)
    score = np.where(known.any(axis=0), np.where(known, told, 0.0).sum(axis=0), -1.0)
    score /= np.maximum(known.sum(axis=0), 1)
    if score.max() < LEAST_CORRELATION:
        return None
    relative = 1 / (inverse * ahead)
    nearer, beyond = relative < 1 - BESIDE, relative > 1 + BESIDE
    parts = (nearer, ~nearer & ~beyond, beyond)
    low, middle, high = (float(score[part].max(initial=-1.0)) for part in parts)
    return low, middle, high


def _correlations(window: Floats, other: PlaceImage, points: Floats, camera: Camera) -> Floats:
    """Normalised correlation (d,) of a window (n,) with points (d, n, 3) in another image; nan: outside of it."""
    seen = (points - other.centre) @ other.rotation
    ahead = (seen[..., 2] > NEAREST_M).all(axis=1)
    patches = _sampled(other, seen / np.maximum(seen[..., 2:], NEAREST_M), camera)
    a, b = window - window.mean(), patches - patches.mean(axis=1, keepdims=True)
    norm = np.sqrt((a @ a) * np.einsum("dn,dn->d", b, b))
    return np.where(ahead, (b @ a) / np.maximum(norm, 1e-9), np.nan)


def _sampled(image: PlaceImage, rays: Floats, camera: Camera) -> Floats:
    """Grey values (d, n) at rays (d, n, 3) with z = 1; nan outside the image."""
    places = distort_points(camera, ideal_of_rays(camera, rays[..., :2].reshape(-1, 2)))
    maps = places.reshape(*rays.shape[:2], 2).astype(np.float32)
    u, v = np.ascontiguousarray(np.moveaxis(maps, 2, 0))
    values = cv2.remap(image.grey, u, v, cv2.INTER_LINEAR).astype(np.float64)
    height, width = image.grey.shape
    inside = (maps >= 0).all(axis=2) & (u <= width - 1) & (v <= height - 1)
    return np.where(inside, values, np.nan)
