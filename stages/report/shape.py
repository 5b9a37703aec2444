"""Shape class of candidates by the Fourier descriptors of their outlines (report chapter 4).

An outline is the convex hull of the middles of the pixel edges of a region. Faces of signs are convex (all but
crossbucks), so a legend or a border that cuts into the region does not count, nor do holes.
"""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SHAPES, SOURCES, Detections, Regions, Segmentation
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import nearest_class
from wayside.stages.kernels import Array, require_array

SAMPLES = 64
"""Points at equal steps of arc length that stand for an outline."""
TERMS = (-1, 2, -2, 3, -3, -4)
"""Terms behind the six descriptors. The report says "magnitude of upper terms / first term" and gives no list.

These are the six lowest at which the outlines of signs differ: a regular n-gon has term 1-n as its first upper one
(triangle -2, square -3, pentagon -4), an elongated outline has -1, one without symmetry has 2 and 3.
"""
_EDGES = np.array([[-0.5, 0], [0.5, 0], [0, -0.5], [0, 0.5]], np.float32)  # from a pixel's centre


def trace_region(labels: NDArray[np.uint8], box: NDArray[np.int64]) -> Array | None:
    """Outline (n, 2) of the region that fills a box, in order; None where none does."""
    left, top, right, bottom = box
    if not (0 <= left < right <= labels.shape[1] and 0 <= top < bottom <= labels.shape[0]):
        return None
    x, y = max(left - 1, 0), max(top - 1, 0)
    around = labels[y : bottom + 1, x : right + 1]  # what leaves the box does not fill it
    wanted = (left - x, top - y, right - left, bottom - top)
    for label in np.unique(labels[top, left:right]):
        _, parts, found, _ = cv2.connectedComponentsWithStats(
            (around == label).astype(np.uint8), connectivity=4
        )
        filling = np.flatnonzero((found[1:, :4] == wanted).all(axis=1))
        if len(filling):
            pixels = np.argwhere(parts == 1 + filling[0])[:, ::-1] + (x, y)
            middles = cv2.convexHull(pixels.astype(np.float32)) + _EDGES
            return np.asarray(cv2.convexHull(middles.reshape(-1, 2))[:, 0])
    return None


def resample_outline(outline: Array) -> NDArray[np.complex128]:
    """Points (`SAMPLES`,) at equal steps along the closed polygon (n, 2), clockwise as seen (v points down)."""
    if cv2.contourArea(outline.astype(np.float32), oriented=True) < 0:
        outline = outline[::-1]
    closed = np.concatenate([outline, outline[:1]])
    passed = np.concatenate([[0.0], np.hypot(*np.diff(closed, axis=0).T).cumsum()])
    at = np.arange(SAMPLES) * passed[-1] / SAMPLES
    u, v = (np.interp(at, passed, column) for column in closed.T)
    return np.asarray(u + 1j * v, np.complex128)


def fourier_descriptors(sequences: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Six descriptors |Z_k| / |Z_1| of each sequence, k in `TERMS`: (n, samples) to (n, 6).

    A shift changes only Z_0, a scale multiplies all terms alike, a rotation or another start point changes phases only,
    so none of them changes a descriptor (report chapter 4). Degenerate outlines give rows that are not finite.
    """
    magnitude = np.abs(np.fft.fft(sequences, axis=-1) / sequences.shape[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(magnitude[:, TERMS] / magnitude[:, 1:2])


_PASSES = (SOURCES.index("pass1"), SOURCES.index("pass2"))


def classify_shape(
    detections: Iterator[Detections], *, model: GaussianModel
) -> Iterator[Detections]:
    """Give the open candidates the shape class of their outline by Mahalanobis distance, in space "fourier6".

    The outline is traced on the region's own pixels in the label image of its pass. A candidate without an accepted
    shape gets the verdict `shape`.
    """
    for one in detections:
        candidates = one.candidates
        rows = candidates.open_rows()
        features = region_descriptors(one.segmentation, candidates.regions.select(rows))
        shape, distance = candidates.shape.copy(), candidates.shape_distance.copy()
        shape[rows], distance[rows], ratio = nearest_class(features, model, SHAPES)
        named = replace(candidates, shape=shape, shape_distance=distance)
        yield replace(
            one, candidates=named.with_verdict(rows[~(ratio >= model.threshold)], "shape")
        )


def region_descriptors(segmentation: Segmentation, regions: Regions) -> NDArray[np.float64]:
    """Fourier descriptors (n, 6) of the outlines of regions in the label images, nan without an outline."""
    return fourier_descriptors(outlines_of(segmentation, regions))


def outlines_of(segmentation: Segmentation, regions: Regions) -> NDArray[np.complex128]:
    """Resampled outlines (n, SAMPLES), u + iv in pixels of the label image, of regions that fill their boxes exactly.

    Clockwise as seen; nan without an outline. Regions are those of equal label (4 neighbours). No two fill the same
    box: where both touched all four sides they would have to cross. Raises ValueError where a label image is of another
    type or shape.
    """
    sequences = np.full((len(regions), SAMPLES), complex(np.nan, np.nan))
    top = segmentation.rows[0]
    boxes = np.rint(regions.box - [0, top, 0, top]).astype(np.int64)
    for source, labels in zip(_PASSES, segmentation.labels or (), strict=False):
        require_array(labels, "labels", np.uint8, (None, None))
        for i in np.flatnonzero(regions.source == source):
            outline = trace_region(labels, boxes[i])
            if outline is not None:
                sequences[i] = resample_outline(outline)
    return sequences
