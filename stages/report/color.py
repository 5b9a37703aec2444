"""Colour class of every candidate (report chapter 3.2)."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, Candidates, Detections, Segmentation
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import nearest_class
from wayside.stages.imaging import log_chromaticity

COLOR_SPACES = {"rgb": 3, "chromaticity": 2, "log_chromaticity": 2, "log_rgb": 3, "lab": 3}
"""Names and dimensions. `rgb`: levels from 0 to 255 (report chapter 3.2); `chromaticity`: shares of red and green in
the sum of the channels; `log_chromaticity`: logarithms of R/G and B/G; `log_rgb`: these and the logarithm of the
brightness; `lab`: CIE 1976 L*a*b* of sRGB under D65. Exposure changes neither the second nor the third."""


def classify_color(
    segmentations: Iterator[Segmentation], *, model: GaussianModel
) -> Iterator[Detections]:
    """Make all regions candidates with the colour class of their mean colour, by Mahalanobis distance (eq. 3.1).

    The verdict is `color` where no class is likely enough against the colours of what is no sign (eq. 9.3).
    """
    for one in segmentations:
        candidates = Candidates.of(one.regions)
        color, distance, ratio = nearest_class(
            color_features(one.regions.rgb, model.space), model, COLORS
        )
        if one.frame.grey:  # the gate goes by brightness, and names nothing
            color, distance = candidates.color, candidates.color_distance
        named = replace(candidates, color=color, color_distance=distance)
        named = replace(named, score=ratio.astype(np.float32))
        yield Detections(one, named.with_verdict(np.flatnonzero(ratio < model.threshold), "color"))


def color_features(rgb: NDArray[np.floating[Any]], space: str) -> NDArray[np.float64]:
    """Mean colours (n, 3), R, G, B from 0 to 255, in a space of `COLOR_SPACES`: (n, d); KeyError for another one."""
    return _FEATURES[space](np.asarray(rgb, np.float64))


def _lab(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    if not len(rgb):
        return np.zeros((0, 3))
    scaled = (rgb / 255.0).astype(np.float32)[None]
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2Lab)[0], np.float64)


_FEATURES: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "rgb": lambda rgb: rgb,
    "chromaticity": lambda rgb: (rgb[:, :2] + 1.0) / (rgb.sum(axis=1, keepdims=True) + 3.0),
    "log_chromaticity": lambda rgb: log_chromaticity(rgb)[:, 1:],
    "log_rgb": log_chromaticity,
    "lab": _lab,
}
