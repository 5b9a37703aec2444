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
"""A face's own corners lie on its border."""


def extract_sift(images: Iterator[Detections]) -> Iterator[Detections]:
    """Find SIFT points on the open candidates of each image; other key points stay as they are."""
    sift = cv2.SIFT.create()
    for item in images:
        if item.image.grey is None:
            yield item
            continue
        points, descriptors, rows = sign_features(item.image.grey, item.candidates, sift)
        features = replace(
            item.features, sign_points=points, sign_descriptors=descriptors, sign_rows=rows
        )
        yield replace(item, features=features)


def sign_features(
    grey: NDArray[np.uint8], candidates: Candidates, sift: cv2.SIFT
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """SIFT points on open candidates: points (m, 2) in recorded pixels, descriptors (m, 128), candidate rows (m,).

    Each point belongs to one candidate only, the smallest around it: regions of both passes lie on the same face, and a
    point that stood in the list twice would be its own rival in the ratio test.
    """
    none, rows = Features.empty(), candidates.open_rows()
    found, described = sift.detectAndCompute(grey, None) if len(rows) else ((), None)
    if described is None:
        return (none.sign_points, none.sign_descriptors, none.sign_rows)
    points = np.asarray(cv2.KeyPoint.convert(found), np.float32).reshape(-1, 2)
    box = candidates.regions.box[rows]
    low, high = box[:, :2] - MARGIN_PX, box[:, 2:] - 1 + MARGIN_PX
    around = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=2)
    size = (box[:, 2:] - box[:, :2]).prod(axis=1)
    owner = np.where(around, size, np.inf).argmin(axis=1)
    kept: NDArray[np.bool_] = np.any(around, axis=1)
    return points[kept], np.asarray(described, np.float32)[kept], rows[owner[kept]].astype(np.int32)
