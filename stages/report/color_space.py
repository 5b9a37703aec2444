"""Spaces in which the mean colour of a region can be classified: the report's is "rgb"."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.imaging import log_chromaticity

COLOR_SPACES = {"rgb": 3, "chromaticity": 2, "log_chromaticity": 2, "log_rgb": 3, "lab": 3}
"""Names and dimensions. `rgb`: levels from 0 to 255 (report chapter 3.2); `chromaticity`: shares of red and green in
the sum of the channels; `log_chromaticity`: logarithms of R/G and B/G; `log_rgb`: these and the logarithm of the
brightness; `lab`: CIE 1976 L*a*b* of sRGB under D65. A change of exposure leaves the second and third as they are and
moves a colour along one axis of the fourth."""


def color_features(rgb: NDArray[np.floating[Any]], space: str) -> NDArray[np.float64]:
    """Mean colours (n, 3), R, G, B from 0 to 255, in a space of `COLOR_SPACES`: (n, d); KeyError for another one."""
    return _FEATURES[space](np.asarray(rgb, np.float64))


def _chromaticity(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((rgb[:, :2] + 1.0) / (rgb.sum(axis=1, keepdims=True) + 3.0))


def _lab(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    if not len(rgb):
        return np.zeros((0, 3))
    scaled = (rgb / 255.0).astype(np.float32)[None]
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2Lab)[0], np.float64)


_FEATURES: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "rgb": lambda rgb: rgb,
    "chromaticity": _chromaticity,
    "log_chromaticity": lambda rgb: log_chromaticity(rgb)[:, 1:],
    "log_rgb": log_chromaticity,
    "lab": _lab,
}
