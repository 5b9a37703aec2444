"""Shape class of candidates from Fourier descriptors of their outlines (report chapter 4)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import (
    SHAPES,
    SOURCES,
    Candidates,
    Detections,
    Segmentation,
    verdict_code,
)
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import nearest_class, require_gaussian_model
from wayside.stages.report.fourier import (
    SPACES,
    sequence_features,
    shape_dimensions,
)
from wayside.stages.report.outline import SAMPLES, region_sequences, traced_sequences

MOST_OUTLINES = 200
"""Candidates of one picture whose outline is looked at without the gate; a picture has thousands of regions."""

_PASSES = (SOURCES.index("pass1"), SOURCES.index("pass2"))


def classify_shape(
    detections: Iterator[Detections], model: GaussianModel, gate: bool
) -> Iterator[Detections]:
    """Give the open candidates the shape class of their outline by Mahalanobis distance.

    The outline of a region of pass one or two is that of its own pixels; of other sources, of the pixels in its box
    that are nearer to its mean colour than to its surroundings. Without the gate at most `MOST_OUTLINES` candidates of
    a picture are looked at, those nearest to a colour class; the rest keeps shape -1.

    Parameters
    ----------
    detections
        Candidates with colour distances.
    model
        Mean, covariance and threshold of each shape, in the space it names ("fourier6": the report's descriptors).
    gate
        Whether all are looked at and one without an accepted shape gets the verdict `shape`.

    Yields
    ------
    One item a picture, in order.

    Raises
    ------
    InputError
        If the model names a shape that does not exist or has another dimension than its space.
    """
    require_gaussian_model(model, SHAPES, {space: shape_dimensions(space) for space in SPACES})
    for one in detections:
        candidates = one.candidates
        rows = candidates.open_rows() if gate else _nearest_in_color(candidates)
        features = sequence_features(_outlines(one.segmentation, candidates, rows), model.space)
        shape, distance = candidates.shape.copy(), candidates.shape_distance.copy()
        shape[rows], distance[rows], accepted = nearest_class(features, model, SHAPES)
        verdict = candidates.verdict.copy()
        if gate:
            verdict[candidates.open_rows()] = verdict_code("shape")
            verdict[rows[accepted]] = verdict_code("open")
        yield replace(
            one,
            candidates=replace(candidates, shape=shape, shape_distance=distance, verdict=verdict),
        )


def _nearest_in_color(candidates: Candidates) -> NDArray[np.int64]:
    """Open rows, nearest colour first; rows in order among equals, those without a colour last."""
    rows = candidates.open_rows()
    order = np.argsort(candidates.color_distance[rows], kind="stable")
    return rows[order[:MOST_OUTLINES]]


def _outlines(
    segmentation: Segmentation, candidates: Candidates, rows: NDArray[np.int64]
) -> NDArray[np.complex128]:
    """Resampled outline of each row, (n, samples); nan where there is none."""
    sequences = np.full((len(rows), SAMPLES), complex(np.nan, np.nan))
    regions = candidates.regions.select(rows)
    by_color = np.ones(len(rows), bool)
    if segmentation.labels is not None:
        top = segmentation.rows[0]
        shift = np.array([0, top, 0, top], np.float32)
        for source, labels in zip(_PASSES, segmentation.labels, strict=True):
            own = regions.source == source
            sequences[own] = traced_sequences(labels, regions.box[own] - shift)
            by_color &= ~own
    if segmentation.image.rgb is not None:
        sequences[by_color] = region_sequences(
            segmentation.image.rgb, regions.box[by_color], regions.rgb[by_color]
        )
    return sequences
