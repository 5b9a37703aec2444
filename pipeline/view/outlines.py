"""Outlines of regions as the shape classifier sees them, and the curves of their first Fourier terms (chapter 4)."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from wayside.pipeline.view import entities as at
from wayside.pipeline.view.entities import Entity
from wayside.schemas.detections import Detections
from wayside.stages.report import TERMS, outlines_of

CURVES: dict[str, tuple[int, ...]] = {
    "circle": (1,),
    "ellipse": (1, -1),
    "six_terms": (1, *TERMS),
}
"""Terms beside the mean that each curve is made of: one is a circle, with its conjugate an ellipse."""
INKS = {
    "traced": (255, 255, 255),
    "circle": (245, 150, 60),
    "ellipse": (90, 200, 245),
    "six_terms": (240, 90, 200),
}


def curve_of_terms(
    sequences: NDArray[np.complex128], terms: tuple[int, ...]
) -> NDArray[np.complex128]:
    """Outlines (n, samples) with these Fourier terms and their mean alone."""
    spectrum = np.fft.fft(sequences, axis=-1)
    kept = np.zeros_like(spectrum)
    rows = [0, *terms]
    kept[:, rows] = spectrum[:, rows]
    return np.asarray(np.fft.ifft(kept, axis=-1))


def outline_entities(item: Detections, *, detail: bool) -> list[Entity]:
    """Outlines and curves of the candidates with an accepted shape; with detail of all that had to have one."""
    candidates = item.candidates
    given = np.isfinite(candidates.shape_distance)
    rows = np.flatnonzero(given if detail else given & (candidates.verdict == 0))
    traced = outlines_of(item.segmentation, candidates.regions.select(rows))
    traced = traced[np.isfinite(traced).all(axis=1)] + 1j * item.segmentation.rows[0]
    layers = {"traced": traced}
    layers |= {name: curve_of_terms(traced, terms) for name, terms in CURVES.items()}
    return [
        Entity(f"{at.OUTLINES}/{name}", (rr.LineStrips2D(closed(of), colors=[INKS[name]]),))
        for name, of in layers.items()
    ]


def closed(sequences: NDArray[np.complex128]) -> NDArray[np.float32]:
    """Closed polygons (n, samples + 1, 2) of outlines u + iv."""
    ring = np.concatenate([sequences, sequences[:, :1]], axis=1)
    return np.stack([ring.real, ring.imag], axis=-1).astype(np.float32)
