"""Fourier descriptors of closed outlines (report chapter 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TERMS = (-1, 2, -2, 3, -3, -4)
"""Terms behind the six descriptors. The report says "magnitude of upper terms / first term" and gives no list.

These are the six lowest at which the outlines of signs differ: a regular n-gon has term 1-n as its first upper one
(triangle -2, square -3, pentagon -4), an elongated outline has -1, one without symmetry has 2 and 3.
"""


def fourier_descriptors(sequences: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Six descriptors |Z_k| / |Z_1| of each sequence, k in `TERMS`: (n, samples) to (n, 6).

    A shift changes only Z_0, a scale multiplies all terms alike, a rotation or another start point changes phases only,
    so none of them changes a descriptor (report chapter 4). Degenerate outlines give rows that are not finite.
    """
    magnitude = np.abs(np.fft.fft(sequences, axis=-1) / sequences.shape[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(magnitude[:, TERMS] / magnitude[:, 1:2])
