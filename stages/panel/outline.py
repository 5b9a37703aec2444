"""The outer outline of a face: chosen among nested candidates by a linear model.

A face has several outlines one within the other: legend, inner field, border line, rim. The strongest of each shape is
found first. The edges parallel to it are the candidates. A conditional logit (McFadden 1974) over 11 features chooses
the outer one. The features are strength of the edge, evenness of the strip inside it (a rim has one colour all round,
the background has not), and difference from the detected box. Lengths are in samples of the template.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import LinearModel
from wayside.stages.kernels import Array
from wayside.stages.panel.outline_edges import (
    OFFSET_STEP,
    Gradients,
    edge_profiles,
    gradients_of,
    strip_colors,
)
from wayside.stages.panel.outline_fit import (
    Outline,
    refine_outline,
    rim_correction,
    side_variances,
    strongest_outlines,
)
from wayside.stages.panel.outline_shapes import box_size, growth, has_area, segments_of

SMALLEST_INWARD = 1.5
"""Candidates lie within the strongest outline by this at most."""
CANDIDATES_OUTWARD = 0.3
"""Candidates lie outside the strongest outline by this fraction of the smaller side at most."""
WEAKER_PART = 0.75
"""Fraction of the segments, the weaker ones, whose mean strength counts: an outline has edges all round."""
SMALLEST_EDGE = 0.15
"""Fraction of the strongest edge below which a candidate is left out."""
STRIP = 1.5
"""Width of the strip inside a candidate whose colour should be even."""
REFINE_VIEWS = 2
"""Nearest views of the last fit."""
REFINE_SEARCH = 1.5
"""Range of the edges of the last fit."""
OUTLINE_FEATURES = (
    "edge",
    "log_edge",
    "inner_strength",
    "unevenness",
    "edge_times_unevenness",
    "log_width",
    "log_height",
    "log_width_squared",
    "log_height_squared",
    "log_width_height_difference",
    "rectangle",
)
"""Features of a candidate, in this order: edge strength as a fraction of the strongest; strength of the outline it
surrounds; unevenness of the colour of the strip inside (30 grey levels); width and height relative to the detected box;
whether it is a rectangle."""
_UNEVEN_LEVELS, _MOST_UNEVEN = 30.0, 60.0
"""Scale and limit of the unevenness, grey levels: part of what the feature means."""
_CENTRE = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5]])
_SIZE = np.array([[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
"""Centre and size by left, top, right, bottom."""


class FaceOutline(NamedTuple):
    """The outer outline of a face: shape, box and rotation as in `Outline`; strength (0 to 1) of the one it surrounds.

    covariance (4, 4) of left, top, right, bottom, samples^2.
    """

    shape: str
    box: Array
    rotation: float
    strength: float
    covariance: Array

    @property
    def size_sigma(self) -> Array:
        """Standard deviations (2,) of width and height, samples."""
        return np.asarray(np.sqrt(np.diag(_SIZE @ self.covariance @ _SIZE.T)))

    @property
    def centre_sigma(self) -> Array:
        """Standard deviations (2,) of the centre, right and down, samples."""
        return np.asarray(np.sqrt(np.diag(_CENTRE @ self.covariance @ _CENTRE.T)))


class OutlineCandidate(NamedTuple):
    """An outline that may be the outer one, and its features (11,), named by `OUTLINE_FEATURES`."""

    outline: Outline
    features: Array


def fit_face_outline(
    views: NDArray[np.float32], box: Array, model: LinearModel
) -> FaceOutline | None:
    """Find the outer outline of the face that registered views show.

    Parameters
    ----------
    views
        (n, rows, columns, 3) float32, the nearest first.
    box
        Where the face was detected, [left, top, right, bottom] in samples (4,).
    model
        Weights of `OUTLINE_FEATURES`.

    Returns
    -------
    FaceOutline or None
        None where no shape has edges all round.

    Raises
    ------
    ValueError
        The model is of other features, or the views are another kind of array.
    """
    if model.features != OUTLINE_FEATURES:
        raise ValueError(f"a model of {model.features} instead of {OUTLINE_FEATURES}")
    gradients = gradients_of(views)
    candidates = outline_candidates(views, gradients, box)
    if not candidates:
        return None
    value = np.array([candidate.features for candidate in candidates]) @ model.weights
    best = int(np.argmax(value))
    probability = np.exp(value - value[best])
    probability /= probability.sum()
    chosen = candidates[best].outline
    sharp = gradients.nearest(REFINE_VIEWS)
    fine = refine_outline(sharp, chosen, REFINE_SEARCH, held=True)
    fine = fine._replace(box=fine.box + rim_correction(sharp, fine))
    rivals = np.array([candidate.outline.box for candidate in candidates]) - chosen.box
    covariance = (rivals.T * probability) @ rivals
    covariance += np.diag(side_variances(sharp, fine))
    return FaceOutline(chosen.shape, fine.box, fine.rotation, chosen.strength, covariance)


def outline_candidates(
    views: NDArray[np.float32], gradients: Gradients, box: Array
) -> list[OutlineCandidate]:
    """Outlines parallel to the strongest of the best shapes, with their features."""
    candidates, step = [], OFFSET_STEP
    for inner in strongest_outlines(gradients, box):
        low = -(SMALLEST_INWARD + STRIP)
        side = float(box_size(inner.box).min())
        high = step * np.ceil((CANDIDATES_OUTWARD * side + 1) / step)
        segments = segments_of(inner.shape, inner.box, inner.rotation)
        profiles = edge_profiles(gradients, segments, low, high)
        kept = math.ceil(WEAKER_PART * len(profiles))
        strength = np.sort(profiles, axis=0)[:kept].mean(axis=0)
        colors = strip_colors(views, segments, low, high)
        middle = np.median(colors, axis=(0, 1))
        uneven = np.median(np.abs(colors - middle).max(axis=3), axis=(0, 1))
        grow = growth(segments)
        peaks = _peaks(strength)
        top = float(max((strength[i] for i in peaks), default=0.0))
        for i in peaks:
            offset = i * step + low
            faint = top <= 0 or strength[i] < SMALLEST_EDGE * top
            if faint or offset <= -SMALLEST_INWARD:
                continue
            outer = inner.box + offset * grow
            if not has_area(outer):
                continue
            strip = float(uneven[max(0, i - round(STRIP / step)) : i + 1].min())
            features = _features(inner, outer, box, float(strength[i]) / top, strip)
            candidates.append(OutlineCandidate(inner._replace(box=outer), features))
    return candidates


def _features(inner: Outline, outer: Array, detected: Array, edge: float, strip: float) -> Array:
    wide, tall = np.log(box_size(outer) / box_size(detected))
    uneven = min(strip, _MOST_UNEVEN) / _UNEVEN_LEVELS
    return np.array(
        [
            edge,
            np.log(edge),
            inner.strength,
            uneven,
            edge * uneven,
            wide,
            tall,
            wide**2,
            tall**2,
            abs(wide - tall),
            float(inner.shape == "rectangle"),
        ]
    )


def _peaks(values: Array) -> list[int]:
    inner = values[1:-1]
    return (np.flatnonzero((inner >= values[:-2]) & (inner > values[2:])) + 1).tolist()
