"""Corners that tie images together, and candidates' centres without lens distortion (report chapters 6 and 8)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections, Features
from wayside.schemas.settings import FeatureSettings
from wayside.stages.geometry import ideal_points
from wayside.stages.kernels import compiled

PYRAMID_LEVELS = 3
"""Levels of the corners' image pyramid, from half size."""
PYRAMID_SCALE = 1.5
"""From level to level: an object 20 m away grows 1.7 times over 8 m."""
CORNER_CONTRAST = 9
"""FAST threshold, grey levels: low enough for the texture of roads and verges."""
CORNER_CELL_PX = 25
"""Side of a cell, in pixels of its level."""


def extract_features(
    images: Iterator[Detections], settings: FeatureSettings
) -> Iterator[Detections]:
    """Detect corners for tie points and undistort the candidates' centres: the last stage that uses one image alone.

    The grey image stays for the registration of ties, the colours for the measuring of panels; label images and
    smaller sizes are dropped.
    """
    for item in images:
        grey, camera, candidates = item.image.grey, item.frame.camera, item.candidates
        features = item.features
        if grey is not None:
            corners, descriptors = tie_corners(grey, settings)
            features = replace(features, corners=corners, descriptors=descriptors)
        if camera is not None:
            candidates = replace(candidates, ideal=ideal_points(camera, candidates.center))
        image = replace(item.image, levels=None)
        segmentation = replace(item.segmentation, image=image, labels=None)
        yield Detections(segmentation, candidates, features)


def tie_corners(
    grey: NDArray[np.uint8], settings: FeatureSettings
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Corners (n, 2) of a grey image, recorded pixels, sorted by row, and descriptors (n, 32).

    FAST corners of a pyramid (Rosten and Drummond 2006), the strongest of each cell: weak ones on road and verge are
    kept as well as strong ones against the sky. ORB descriptors (Rublee et al. 2011) are upright, because cameras on
    the road hardly roll. The pyramid starts at half size: the blur of lens and JPEG lies below that scale.
    """
    fast = cv2.FastFeatureDetector.create(CORNER_CONTRAST)
    orb = cv2.ORB.create(100_000, nlevels=1)
    level = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    corners, descriptors = [_NONE.corners], [_NONE.descriptors]
    for index in range(PYRAMID_LEVELS):
        if index > 0:
            shrink = 1 / PYRAMID_SCALE
            level = cv2.resize(level, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        found = fast.detect(level)
        if not found:
            continue
        found, described = orb.compute(level, [found[i] for i in _strongest(found, settings)])
        if described is None:
            continue
        # Pixel centres are at integers: the centre of a block of s pixels lies (s - 1) / 2 from its first.
        scale = np.array([grey.shape[1] / level.shape[1], grey.shape[0] / level.shape[0]])
        places = (np.asarray(cv2.KeyPoint.convert(found)) + 0.5) * scale - 0.5
        corners.append(places.astype(np.float32))
        descriptors.append(np.asarray(described, np.uint8))
    places, codes = np.concatenate(corners), np.concatenate(descriptors)
    order = np.lexsort((places[:, 0], places[:, 1]))
    return places[order], codes[order]


def _strongest(found: Sequence[cv2.KeyPoint], settings: FeatureSettings) -> NDArray[np.int64]:
    # A response of FAST is the largest contrast at which the corner is still one: a grey level.
    response = np.fromiter(map(_response, found), np.float32, len(found)).astype(np.uint8)
    order = np.argsort(~response, kind="stable")
    places = np.asarray(cv2.KeyPoint.convert(found), np.float64)[order]
    kept = first_of_cells(places, CORNER_CELL_PX, settings.corners_per_cell)
    return np.sort(order[kept])


def first_of_cells(
    places: NDArray[np.floating[Any]], side_px: float, most: int
) -> NDArray[np.bool_]:
    """Which places (n, 2) px are among the first `most` of their square cell of an image."""
    cell = np.floor(places / side_px).astype(np.int64)
    key = cell[:, 1] * (cell[:, 0].max(initial=0) + 1) + cell[:, 0]
    key -= key.min(initial=0)
    kept = np.empty(len(key), np.bool_)
    _first_of_cells(key, np.zeros(key.max(initial=0) + 1, np.int64), most, kept)
    return kept


@compiled
def _first_of_cells(
    key: NDArray[np.int64], count: NDArray[np.int64], most: int, kept: NDArray[np.bool_]
) -> None:
    for i in range(key.shape[0]):
        count[key[i]] += 1
        kept[i] = count[key[i]] <= most


_NONE = Features.empty()
_response = attrgetter("response")
