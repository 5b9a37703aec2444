"""SIFT key points on the candidates (report chapter 5).

The report matched points on the signs alone; they cover a tenth of the image and cannot hold a rotation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Candidates, Detections, Features

MARGIN_PX = 3
"""Points so far outside the box of a candidate belong to it: a face's own corners lie on its border."""


def extract_sift(images: Iterator[Detections]) -> Iterator[Detections]:
    """Find SIFT points on the open candidates of each image; other key points stay as they are."""
    sift = cv2.SIFT.create()
    for item in images:
        if item.image.grey is None:
            yield item
            continue
        points, descriptors, rows = sign_features(item.image.grey, item.candidates, MARGIN_PX, sift)
        features = replace(
            item.features, sign_points=points, sign_descriptors=descriptors, sign_rows=rows
        )
        yield replace(item, features=features)


def sign_features(
    grey: NDArray[np.uint8], candidates: Candidates, margin_px: int, sift: cv2.SIFT
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """SIFT points on open candidates: points (m, 2) in recorded pixels, descriptors (m, 128), candidate rows (m,).

    Each point belongs to one candidate only, the smallest whose box contains it. Regions of both passes overlap the
    same face, and a point listed twice would fail the ratio test against itself.
    """
    none, rows = Features.empty(), candidates.open_rows()
    found, described = sift.detectAndCompute(grey, None) if len(rows) else ((), None)
    if described is None:
        return (none.sign_points, none.sign_descriptors, none.sign_rows)
    points = np.asarray(cv2.KeyPoint.convert(found), np.float32).reshape(-1, 2)
    owner = _smallest_around(points, candidates.regions.box[rows], margin_px)
    kept = owner >= 0
    return points[kept], np.asarray(described, np.float32)[kept], rows[owner[kept]].astype(np.int32)


def _smallest_around(
    points: NDArray[np.float32], box: NDArray[np.float32], margin_px: int
) -> NDArray[np.int64]:
    """Number (m,) of the smallest box (n, 4) that contains each point with a margin, the first of equals; -1: none."""
    low, high = box[:, :2] - margin_px, box[:, 2:] - 1 + margin_px
    down = np.argsort(points[:, 1], kind="stable")
    x, y = points[down].T
    first, last = np.searchsorted(y, low[:, 1]), np.searchsorted(y, high[:, 1], side="right")
    owner = np.full(len(points), -1)
    # the largest box first: smaller ones overwrite it
    for k in np.argsort((box[:, 2:] - box[:, :2]).prod(axis=1), kind="stable")[::-1]:
        beside = x[first[k] : last[k]]
        inside = (beside >= low[k, 0]) & (beside <= high[k, 0])
        owner[down[first[k] : last[k]][inside]] = k
    return owner
