"""The colour space of the features."""

from __future__ import annotations

from typing import Any

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
        raise ValueError(f"colours: wanted shape (n, 3), found {rgb.shape}; pass one colour a row")
    colors = np.asarray(rgb, np.float64)
    raised = np.log(colors + DARK_LEVEL)
    brightness = np.log(colors.mean(axis=1) + DARK_LEVEL)
    return np.column_stack([brightness, raised[:, 0] - raised[:, 1], raised[:, 2] - raised[:, 1]])
