"""The colour space of the features."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

DARK_LEVEL = 4.0
"""Added to every channel before a logarithm, about the noise of a dark pixel: keeps ratios of near-black colours small.
The models were learned with it."""


def log_chromaticity(rgb: NDArray[Any]) -> NDArray[np.float64]:
    """Natural logarithms of brightness (R+G+B)/3, of R/G and of B/G, (n, 3), finite for every input.

    rgb: colours (n, 3), R, G, B from 0 to 255. Each channel is raised by `DARK_LEVEL`; a change of exposure moves a
    colour along the first axis only. Raises ValueError if the colours are not (n, 3).
    """
    if rgb.ndim != 2 or rgb.shape[1] != 3:
        raise ValueError(f"colours: shape {rgb.shape} instead of (n, 3). Pass one colour a row.")
    colors = np.asarray(rgb, np.float64)
    raised = np.log(colors + DARK_LEVEL)
    brightness = np.log(colors.mean(axis=1) + DARK_LEVEL)
    return np.column_stack([brightness, raised[:, 0] - raised[:, 1], raised[:, 2] - raised[:, 1]])


def colorfulness(rgb: NDArray[np.uint8]) -> float:
    """How far the colour of an image (h, w, 3) varies, as a fraction of how far its brightness does; 0 of an even one.

    Larger of the deviations of log R/G and log B/G, over the deviation of the log brightness, between the means of 64 x
    32 parts of the image. A cast is the same everywhere, noise averages out, and fog takes as much of colour as of
    contrast.
    """
    parts = cv2.resize(rgb, (64, 32), interpolation=cv2.INTER_AREA)
    bright, red, blue = log_chromaticity(parts.reshape(-1, 3)).std(axis=0).tolist()
    return max(red, blue) / bright if bright > 0 else 0.0
