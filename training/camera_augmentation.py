"""Augmentation: the tones of an image altered as if another camera had taken it in another light."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

STOPS, CONTRAST, SATURATION, TINT = (-0.8, 0.8), (0.75, 1.9), (0.6, 1.5), 0.05
"""Ranges of exposure (powers of two), contrast about a middle grey, saturation; sigma of the log of channel gains."""


def retoned(rgb: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
    """An image (rows, columns, 3) with another exposure, tint, contrast and saturation."""
    exposure = 2.0 ** random.uniform(*STOPS) if random.random() < 0.7 else 1.0
    gains = np.exp(random.normal(0.0, TINT, 3)) * exposure
    contrast = random.uniform(*CONTRAST) if random.random() < 0.7 else 1.0
    middle = random.uniform(80.0, 130.0)
    levels = np.arange(256.0)
    curves = np.clip(
        (levels[:, None] * gains - middle * exposure) * contrast + middle * exposure, 0, 255
    )
    table = np.rint(curves).astype(np.uint8)
    shown = np.stack([table[rgb[..., k], k] for k in range(3)], axis=-1)
    if random.random() < 0.6:
        amount = float(random.uniform(*SATURATION))
        grey = cv2.cvtColor(cv2.cvtColor(shown, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        shown = np.asarray(cv2.addWeighted(shown, amount, grey, 1 - amount, 0), np.uint8)
    return np.ascontiguousarray(shown)
