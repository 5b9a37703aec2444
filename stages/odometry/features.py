"""Corners that tie images together, and candidates' centres without lens distortion (report chapters 6 and 8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections, Features
from wayside.schemas.settings import FeatureSettings
from wayside.stages.geometry import ideal_points

LEVELS, LEVEL_SCALE = 3, 1.5
"""Pyramid of the corners, from half size: a thing 20 m away grows 1.7 times over 8 m."""
CONTRAST = 9
"""Grey levels by which a corner stands out: low enough for the texture of roads and verges."""
CELL_PX = 25
"""Side of a cell at each level, so 50 px of the picture at the finest."""


def extract_features(
    images: Iterator[Detections], settings: FeatureSettings
) -> Iterator[Detections]:
    """Find corners for tie points and undistort the candidates' centres; the end of what one image shows by itself.

    Grey stays for the registration of points, colours for the measuring of panels; the label images go.
    """
    for item in images:
        grey, camera, candidates = item.image.grey, item.frame.camera, item.candidates
        features = item.features
        if grey is not None:
            corners, descriptors = tie_corners(grey, settings.corners_per_cell)
            features = replace(features, corners=corners, descriptors=descriptors)
        if camera is not None:
            candidates = replace(candidates, ideal=ideal_points(camera, candidates.center))
        segmentation = replace(item.segmentation, labels=None)
        yield Detections(segmentation, candidates, features)


def tie_corners(
    grey: NDArray[np.uint8], per_cell: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Corners (n, 2) of a grey picture, recorded pixels, sorted by row, and descriptors (n, 32).

    FAST corners of a pyramid, the strongest of each cell, so that weak ones on road and verge stand beside strong
    ones against the sky; upright ORB descriptors, as cameras on the road hardly roll. From half size: the blur of lens
    and JPEG lies below that scale.
    """
    fast = cv2.FastFeatureDetector.create(CONTRAST)
    orb = cv2.ORB.create(100_000, nlevels=1)
    level = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    corners, descriptors = [_NONE.corners], [_NONE.descriptors]
    for index in range(LEVELS):
        if index > 0:
            shrink = 1 / LEVEL_SCALE
            level = cv2.resize(level, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        found = fast.detect(level)
        if not found:
            continue
        found, described = orb.compute(level, [found[i] for i in _strongest(found, per_cell)])
        if described is None:
            continue
        # Pixel centres at integers: the middle of a block of pixels lies half a block less half a pixel off its start.
        scale = np.array([grey.shape[1] / level.shape[1], grey.shape[0] / level.shape[0]])
        places = (np.asarray(cv2.KeyPoint.convert(found)) + 0.5) * scale - 0.5
        corners.append(places.astype(np.float32))
        descriptors.append(np.asarray(described, np.uint8))
    places, codes = np.concatenate(corners), np.concatenate(descriptors)
    order = np.lexsort((places[:, 0], places[:, 1]))
    return places[order], codes[order]


def _strongest(found: Sequence[cv2.KeyPoint], per_cell: int) -> NDArray[np.int64]:
    places = np.asarray(cv2.KeyPoint.convert(found), np.float32)
    response = np.fromiter((point.response for point in found), np.float32, len(found))
    cell = np.floor(places / CELL_PX).astype(np.int64)
    key = cell[:, 1] * 100_000 + cell[:, 0]
    order = np.lexsort((np.arange(len(found)), -response, key))
    rank = np.arange(len(order)) - np.searchsorted(key[order], key[order])
    chosen: NDArray[np.int64] = np.sort(order[rank < per_cell])
    return chosen


_NONE = Features.empty()
