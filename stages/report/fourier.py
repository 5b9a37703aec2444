"""Fourier descriptors of closed outlines (report chapter 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SPACES = ("fourier6", "fourier6_oriented")

TERMS = (-1, 2, -2, 3, -3, -4)
"""Terms behind the six descriptors. The report says "magnitude of upper terms / first term" and gives no list.

These are the six lowest at which the outlines of signs differ: a regular n-gon has term 1-n as its first upper one
(triangle -2, square -3, pentagon -4), an elongated outline has -1, one without symmetry has 2 and 3.
"""


def shape_dimensions(space: str) -> int:
    """Number of features of a shape space; raises ValueError if it is unknown."""
    if space not in SPACES:
        raise ValueError(f"shape space: wanted one of {', '.join(SPACES)}, found {space!r}")
    return 6 if space == "fourier6" else 10


def outline_terms(sequences: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Fourier coefficients of closed sequences (n, samples), along the last axis, divided by their number."""
    return np.asarray(np.fft.fft(sequences, axis=-1) / sequences.shape[-1])


def fourier_descriptors(sequences: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Six descriptors |Z_k| / |Z_1| of each sequence, k in `TERMS`: (n, samples) to (n, 6).

    A shift changes only Z_0, a scale multiplies all terms alike, a rotation or another start point changes phases only,
    so none of them changes a descriptor (report chapter 4).
    """
    magnitude = np.abs(outline_terms(sequences))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(magnitude[:, TERMS] / magnitude[:, 1:2])


def oriented_descriptors(sequences: NDArray[np.complex128]) -> NDArray[np.float64]:
    """The six descriptors and four features that distinguish a diamond from a square: (n, samples) to (n, 10).

    6. Fourfold orientation Re(Z_-3 Z_1^3) / |Z_1|^4: free of scale and start point, but a rotation by t turns its phase
       by 4t, so that a square on its side (-1/9) and one on its corner (+1/9) differ by sign.
    7. |Z_-7| / |Z_1|: the first upper term of an octagon, none in a circle.
    8. Logarithm of width over height of the box around the outline.
    9. Fraction of that box inside the outline: rectangle 1, octagon .83, circle .79, diamond and triangle .5.
    """
    terms = outline_terms(sequences)
    first = np.abs(terms[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        fourfold = (terms[:, -3] * terms[:, 1] ** 3).real / first**4
        eightfold = np.abs(terms[:, -7]) / first
        width = np.ptp(sequences.real, axis=1)
        height = np.ptp(sequences.imag, axis=1)
        onward = np.roll(sequences, -1, axis=1)
        area = 0.5 * np.abs((sequences.conj() * onward).imag.sum(axis=1))
        extra = [fourfold, eightfold, np.log(width / height), area / (width * height)]
    return np.column_stack([fourier_descriptors(sequences), *extra])


def sequence_features(sequences: NDArray[np.complex128], space: str) -> NDArray[np.float64]:
    """Features of many resampled outlines at once: (n, samples) to (n, d) in the named space.

    Degenerate outlines give rows that are not finite; raises ValueError if the space is unknown.
    """
    shape_dimensions(space)
    if space == "fourier6":
        return fourier_descriptors(sequences)
    return oriented_descriptors(sequences)
