"""The pixels of a face as the face classifier takes them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PATCH_SIDE, PATCH_MARGIN = 32, 0.08
"""Samples of a patch each way; what it shows around the face, as a fraction of its sides. Part of the input format."""

OTHER_FACE = "other"
"""Class of the face classifier of all faces that are none of its codes."""

_DARK_LEVEL, _FLAT = 16.0, 0.1
"""Added to a grey value before its logarithm, and to the scatter of the logarithms: noise of dark pixels or of a face
without contrast is no legend. Part of the input format."""


def face_patch(rgb: NDArray[Any], box: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The face in a box [x0, y0, x1, y1] of an image (h, w, 3) with its margin, resampled: (32, 32, 3).

    What lies beyond the image is its edge repeated; a box without area is one pixel.
    """
    size = np.maximum(box[2:] - box[:2], 1.0)
    low = np.floor(box[:2] - PATCH_MARGIN * size).astype(int)
    high = np.maximum(np.ceil(box[2:] + PATCH_MARGIN * size).astype(int), low + 1)
    rows, columns = (np.clip(np.arange(low[k], high[k]), 0, rgb.shape[1 - k] - 1) for k in (1, 0))
    part = np.clip(rgb[np.ix_(rows, columns)], 0, 255).astype(np.uint8)
    shrinks = min(part.shape[:2]) > PATCH_SIDE
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(part, (PATCH_SIDE, PATCH_SIDE), interpolation=how), np.uint8)


def face_samples(patches: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Patches (n, 32, 32, 3) as samples (n, 3, 32, 32): brightness of mean 0 and scatter 1, log R/G, log B/G."""
    logarithm = np.log(patches.astype(np.float32) + np.float32(_DARK_LEVEL))
    bright = logarithm.mean(axis=-1)
    middle = bright.mean(axis=(1, 2), keepdims=True)
    scatter = bright.std(axis=(1, 2), keepdims=True)
    bright = (bright - middle) / (scatter + np.float32(_FLAT))
    red, green, blue = (logarithm[..., k] for k in range(3))
    return np.stack([bright, red - green, blue - green], axis=1)
