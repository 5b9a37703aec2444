"""Key points of each picture: corners that tie pictures together, SIFT on candidates, points without distortion.

Report chapters 5 and 6. The corners carry motion (chapter 8); the report matched SIFT points on the signs alone, which
cover a tenth of the picture and cannot hold a rotation. SIFT on the candidates is there for the report's own matching.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.regions import Candidates, Features, Judged, Look
from wayside.schemas.settings import FeatureSettings
from wayside.stages.numerics.undistort import ideal_points

LEVELS, LEVEL_SCALE = 3, 1.5
"""Pyramid of the corners, from half size: a thing 20 m away grows 1.7 times over 8 m."""
CONTRAST = 9
"""Grey levels by which a corner stands out: low enough for the texture of roads and verges."""
CELL_PX = 25
"""Side of a cell at each level, so 50 px of the picture at the finest."""
MARGIN_PX = 3
"""A face's own corners lie on its border."""


def extract_features(judged: Iterator[Judged], settings: FeatureSettings) -> Iterator[Look]:
    """Find key points and undistort the candidates' centres; the end of what one picture shows by itself.

    Grey stays for the registration of points, colours for the measuring of panels.
    """
    sift = cv2.SIFT.create()
    for item in judged:
        picture, candidates = item.segmented.picture, item.candidates
        features, grey = _EMPTY, picture.grey
        if grey is not None:
            corners, descriptors = tie_corners(grey, settings.corners_per_cell)
            signs = sign_features(grey, candidates, sift) if settings.sift else _NO_SIGNS
            features = Features(corners, descriptors, *signs)
        if picture.frame.camera is not None:
            ideal = ideal_points(picture.frame.camera, candidates.center)
            candidates = replace(candidates, ideal=ideal)
        yield Look(
            picture,
            candidates,
            features,
            item.segmented.region_count,
            item.segmented.rows,
            item.segmented.left_out,
        )


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
    corners, descriptors = [_EMPTY.corners], [_EMPTY.descriptors]
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


def sign_features(
    grey: NDArray[np.uint8], candidates: Candidates, sift: cv2.SIFT
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """SIFT points on open candidates: points (m, 2) in recorded pixels, descriptors (m, 128), candidate rows (m,).

    Each point belongs to one candidate only, the smallest around it: regions of both passes lie on the same face, and a
    point that stood in the list twice would be its own rival in the ratio test.
    """
    rows = candidates.open_rows()
    found, described = sift.detectAndCompute(grey, None) if len(rows) else ((), None)
    if described is None:
        return _NO_SIGNS
    points = np.asarray(cv2.KeyPoint.convert(found), np.float32).reshape(-1, 2)
    box = candidates.regions.box[rows]
    low, high = box[:, :2] - MARGIN_PX, box[:, 2:] - 1 + MARGIN_PX
    around = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=2)
    size = (box[:, 2:] - box[:, :2]).prod(axis=1)
    owner = np.where(around, size, np.inf).argmin(axis=1)
    kept: NDArray[np.bool_] = np.any(around, axis=1)
    return points[kept], np.asarray(described, np.float32)[kept], rows[owner[kept]].astype(np.int32)


_NO_SIGNS = (
    np.zeros((0, 2), np.float32),
    np.zeros((0, 128), np.float32),
    np.zeros(0, np.int32),
)
_EMPTY = Features(np.zeros((0, 2), np.float32), np.zeros((0, 32), np.uint8), *_NO_SIGNS)
