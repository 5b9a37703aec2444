"""Colour spaces of the Gaussian classes and of the features."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SPACES = ("rgb", "log_chromaticity")

DARK_LEVEL = 4.0
"""Added to every channel before a logarithm, about the noise of a dark pixel: keeps ratios of near-black colours small.
The models were learned with it."""


def to_space(rgb: NDArray[Any], space: str) -> NDArray[np.float64]:
    """Colours in the space of a colour model.

    Parameters
    ----------
    rgb
        Colours, shape (n, 3), R, G, B from 0 to 255.
    space
        "rgb": as they are, the feature of the report (chapter 3.2). "log_chromaticity": natural logarithms of
        brightness (R+G+B)/3, of R/G and of B/G, each channel raised by `DARK_LEVEL`; a change of exposure then moves
        a colour along the first axis only.

    Returns
    -------
    Coordinates, shape (n, 3), finite for every input.

    Raises
    ------
    ValueError
        If the space is unknown or the colours are not (n, 3).
    """
    if rgb.ndim != 2 or rgb.shape[1] != 3:
        raise ValueError(f"colours: wanted shape (n, 3), found {rgb.shape}; pass one colour a row")
    colors = np.asarray(rgb, np.float64)
    if space == "rgb":
        return colors.copy()
    if space == "log_chromaticity":
        raised = np.log(colors + DARK_LEVEL)
        brightness = np.log(colors.mean(axis=1) + DARK_LEVEL)
        return np.column_stack(
            [brightness, raised[:, 0] - raised[:, 1], raised[:, 2] - raised[:, 1]]
        )
    raise ValueError(f"colour space: wanted one of {', '.join(SPACES)}, found {space!r}")
