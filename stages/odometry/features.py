"""Corners that tie images together, and candidates' centres without lens distortion (report chapters 6 and 8)."""

from __future__ import annotations

from collections.abc import Iterator
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

BORDER_PX = 31
"""ORB describes no corner nearer to the border."""


def extract_features(
    images: Iterator[Detections], settings: FeatureSettings
) -> Iterator[Detections]:
    """Detect corners for tie points and undistort the candidates' centres: the last stage that uses one image alone.

    The grey image stays for the registration of ties, the colours for the measuring of panels; label images are
    dropped.
    """
    for item in images:
        grey, camera, candidates = item.image.grey, item.frame.camera, item.candidates
        features = item.features
        if grey is not None:
            corners, descriptors = tie_corners(grey, settings)
            features = replace(features, corners=corners, descriptors=descriptors)
        if camera is not None:
            candidates = replace(candidates, ideal=ideal_points(camera, candidates.center))
            features = replace(features, ideal_corners=ideal_points(camera, features.corners))
        segmentation = replace(item.segmentation, labels=None)
        yield Detections(segmentation, candidates, features)


def tie_corners(
    grey: NDArray[np.uint8], settings: FeatureSettings
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Corners (n, 2) of a grey image, recorded pixels, and descriptors (n, 32): the best of every cell come first.

    FAST corners of a pyramid (Rosten and Drummond 2006), the strongest of each cell: weak ones on road and verge are
    kept as well as strong ones against the sky. ORB descriptors (Rublee et al. 2011) are upright, because cameras on
    the road hardly roll. The pyramid starts at half size: the blur of lens and JPEG lies below that scale.
    """
    fast = cv2.FastFeatureDetector.create(CORNER_CONTRAST)
    orb = cv2.ORB.create(100_000, nlevels=1)
    level = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    corners, descriptors, ranks = [_NONE.corners], [_NONE.descriptors], [np.zeros(0, np.int64)]
    for index in range(PYRAMID_LEVELS):
        if index > 0:
            shrink = 1 / PYRAMID_SCALE
            level = cv2.resize(level, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_LINEAR)
        found = fast.detect(level)
        places = np.asarray(cv2.KeyPoint.convert(found), np.float64).reshape(-1, 2)
        # A response of FAST is the largest contrast at which the corner is still one: a grey level.
        response = np.fromiter(map(_response, found), np.float32, len(found)).astype(np.uint8)
        size = np.array(level.shape[::-1])
        inside = ((places >= BORDER_PX) & (places < size - BORDER_PX)).all(axis=1)
        order = np.flatnonzero(inside)[np.argsort(~response[inside], kind="stable")]
        rank = rank_in_cells(places[order], CORNER_CELL_PX)
        kept = rank < settings.corners_per_cell
        order, rank = order[kept], rank[kept]
        if not len(order):
            continue
        _, described = orb.compute(level, [found[i] for i in order])
        # Pixel centres are at integers: the centre of a block of s pixels lies (s - 1) / 2 from its first.
        scale = np.array(grey.shape[::-1]) / size
        corners.append(((places[order] + 0.5) * scale - 0.5).astype(np.float32))
        descriptors.append(np.asarray(described, np.uint8))
        ranks.append(256 * rank - response[order])
    order = np.argsort(np.concatenate(ranks), kind="stable")
    return np.concatenate(corners)[order], np.concatenate(descriptors)[order]


def rank_in_cells(places: NDArray[np.floating[Any]], side_px: float) -> NDArray[np.int64]:
    """How many places (n, 2) px that come before one lie in the same square cell of an image, (n,)."""
    cell = np.floor(places / side_px).astype(np.int64)
    key = cell[:, 1] * (cell[:, 0].max(initial=0) + 1) + cell[:, 0]
    key -= key.min(initial=0)
    rank = np.empty(len(key), np.int64)
    _rank_in_cells(key, np.zeros(key.max(initial=0) + 1, np.int64), rank)
    return rank


@compiled
def _rank_in_cells(
    key: NDArray[np.int64], count: NDArray[np.int64], rank: NDArray[np.int64]
) -> None:
    for i in range(key.shape[0]):
        rank[i] = count[key[i]]
        count[key[i]] += 1


_NONE = Features.empty()
_response = attrgetter("response")
