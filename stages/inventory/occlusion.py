"""Whether images see past the place of a panel, or something nearer hides it: plane sweep (Collins 1996)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera
from wayside.schemas.settings.merging import ChangeSettings
from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.inventory.visibility import NEAREST_M

LEAST_CORRELATION = 0.7
"""Correlation of a window with the images before and after for its distance to count (two rendered roads)."""
CORRELATION_MARGIN = 0.1
"""So much more correlates the better of two answers: level edges correlate at any distance."""
BESIDE = 0.1
"""What is so much of its distance before or behind a place stands at it."""

Floats = NDArray[np.float64]
_SAMPLES = 24
"""Of a window, each way."""
_DEPTHS = 96
"""That are tried, evenly by their inverse."""
_NEAREST = 0.25
"""Of the distance of the place."""


@dataclass(frozen=True, slots=True)
class PlaceImage:
    """An image with its camera relative to a place.

    `grey` (height, width). `rotation` (3, 3): camera to level axes. `centre` (3,): of the camera in these axes, metres,
    the place being their origin.
    """

    grey: NDArray[np.uint8]
    rotation: Floats
    centre: Floats


class OcclusionCounts(NamedTuple):
    """How many images show something beyond a place, and how many something in front of it; others tell neither."""

    past: int
    hidden: int


def measure_occlusion(
    images: Sequence[PlaceImage],
    camera: Camera,
    size_m: tuple[float, float],
    settings: ChangeSettings,
) -> OcclusionCounts:
    """Measure the distance of what shows where a panel stood, by the images before and after each.

    A window of the panel's size is compared with the other images as if it lay at each of many distances. Larger
    windows follow as long as the result is undecided. Objects next to a place count only in the smallest window,
    because they hide nothing. Something that moves with the camera looks farther away than it is: a vehicle ahead hides
    a place unnoticed.

    Parameters
    ----------
    images
        In order of time, with the place in view.
    camera
        Calibration of all.
    size_m
        Width and height of the panel.
    settings
        Correlation that is needed, and by how much the better answer has it.
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
    return OcclusionCounts(past, hidden)


def _tell(
    image: PlaceImage,
    others: Sequence[PlaceImage],
    camera: Camera,
    size_m: tuple[float, float],
    settings: ChangeSettings,
) -> tuple[float, float, float] | None:
    """Best correlations of a window at distances nearer than the place, at it, and beyond; None: it tells nothing."""
    right, down, ahead = -image.centre @ image.rotation
    across = np.linspace(-0.5, 0.5, _SAMPLES)
    x, y = np.meshgrid(
        (right + across * size_m[0]) / ahead, (down + across * size_m[1]) / ahead
    )  # of rays with z = 1
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    window = _sampled(image, rays[None], camera)[0]
    if not np.isfinite(window).all():
        return None
    inverse = np.linspace(1 / settings.farthest_m, 1 / (_NEAREST * ahead), _DEPTHS)
    points = (rays @ image.rotation.T) / inverse[:, None, None] + image.centre
    scores = [_correlations(window, other, points, camera, NEAREST_M) for other in others]
    told = np.array([score for score in scores if np.isfinite(score).any()])
    if not len(told):
        return None
    known = np.isfinite(told)
    score = np.where(known.any(axis=0), np.where(known, told, 0.0).sum(axis=0), -1.0)
    score /= np.maximum(known.sum(axis=0), 1)
    if score.max() < LEAST_CORRELATION:
        return None
    relative = 1 / (inverse * ahead)
    nearer = relative < 1 - BESIDE
    beyond = relative > 1 + BESIDE
    parts = (nearer, ~nearer & ~beyond, beyond)
    low, middle, high = (float(score[part].max(initial=-1.0)) for part in parts)
    return low, middle, high


def _correlations(
    window: Floats, other: PlaceImage, points: Floats, camera: Camera, nearest_m: float
) -> NDArray[np.float64]:
    """Normalised correlation (d,) of a window (n,) with points (d, n, 3) in another image; nan: outside of it."""
    seen = (points - other.centre) @ other.rotation
    ahead = (seen[..., 2] > nearest_m).all(axis=1)
    rays = seen / np.maximum(seen[..., 2:], nearest_m)
    patches = _sampled(other, rays, camera)
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
