"""Shape class of candidates from Fourier descriptors of their outlines (report chapter 4)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SHAPES, SOURCES, Detections, Regions, Segmentation
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import nearest_class, require_gaussian_model
from wayside.stages.report.outline import SAMPLES, TERMS, fourier_descriptors, traced_sequences

_PASSES = (SOURCES.index("pass1"), SOURCES.index("pass2"))


def classify_shape(
    detections: Iterator[Detections],
    *,
    model: GaussianModel,
) -> Iterator[Detections]:
    """Give the open candidates the shape class of their outline by Mahalanobis distance.

    The outline is traced on the region's own pixels in the label image of its pass. A candidate without an accepted
    shape gets the verdict `shape`.

    Parameters
    ----------
    detections
        Candidates from pass one and two.
    model
        Mean, covariance and threshold of each shape in space "fourier6".

    Yields
    ------
    One item an image, in order.

    Raises
    ------
    InputError
        If the model names a shape that does not exist or has another dimension than its space.
    """
    require_gaussian_model(model, SHAPES, {"fourier6": len(TERMS)})
    for one in detections:
        candidates = one.candidates
        rows = candidates.open_rows()
        features = region_descriptors(one.segmentation, candidates.regions.select(rows))
        shape, distance = candidates.shape.copy(), candidates.shape_distance.copy()
        shape[rows], distance[rows], accepted = nearest_class(features, model, SHAPES)
        named = replace(candidates, shape=shape, shape_distance=distance)
        yield replace(one, candidates=named.with_verdict(rows[~accepted], "shape"))


def region_descriptors(segmentation: Segmentation, regions: Regions) -> NDArray[np.float64]:
    """Fourier descriptors (n, 6) of the outlines of regions in the label images, nan without an outline."""
    return fourier_descriptors(outlines_of(segmentation, regions))


def outlines_of(segmentation: Segmentation, regions: Regions) -> NDArray[np.complex128]:
    """Resampled outline of each region, (n, samples) in pixels of the label image, nan without an outline."""
    sequences = np.full((len(regions), SAMPLES), complex(np.nan, np.nan))
    if segmentation.labels is not None:
        top = segmentation.rows[0]
        shift = np.array([0, top, 0, top], np.float32)
        for source, labels in zip(_PASSES, segmentation.labels, strict=True):
            own = regions.source == source
            sequences[own] = traced_sequences(labels, regions.box[own] - shift)
    return sequences
