"""Shape class of candidates by the Fourier descriptors of their outlines (report chapter 4).

An outline is the convex hull of the middles of the pixel edges of a region. All faces but crossbucks are convex, and a
legend or border that cuts into the region does not count. Signs stand upright, and a turned panel looks narrower. So
outlines are scaled to one width and height, and terms keep their phases: a square is no diamond.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SHAPES, Detections, Regions, Segmentation
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import nearest_class
from wayside.stages.kernels import Array

SAMPLES = 64
"""Points at equal steps of arc length that stand for an outline."""
TERMS = (-1, 2, -2, 3, -3, -4, -5, -7)
"""Terms behind the descriptors, of which the report gives no list. A regular n-gon has 1-n as its first upper one
(triangle -2, octagon -7), an oblique outline has -1, one without symmetry 2 and 3."""
DESCRIPTORS = 2 * len(TERMS) + 3
_EDGES = np.array([[-0.5, 0], [0.5, 0], [0, -0.5], [0, 0.5]], np.float32)  # from a pixel's centre


class Outlines(NamedTuple):
    """Outlines of n regions; nan for a region without one."""

    points: NDArray[np.complex128]
    """(n, `SAMPLES`), u + iv in pixels of the label image, clockwise as seen."""
    filled: NDArray[np.float64]
    """Shares (n, 2) of their area that the pixels of the region fill, without and with its holes."""


def trace_region(labels: NDArray[np.uint8], box: NDArray[np.int64]) -> tuple[Array, list[float]]:
    """Outline (m, 2), clockwise as seen, of the region that fills a box, and its `Outlines.filled`."""
    left, top, right, bottom = box
    x, y = max(left - 1, 0), max(top - 1, 0)
    around = labels[y : bottom + 1, x : right + 1]  # what leaves the box does not fill it
    wanted = (left - x, top - y, right - left, bottom - top)
    for label in np.unique(labels[top, left:right]):
        same = (around == label).astype(np.uint8)
        _, parts, found, _ = cv2.connectedComponentsWithStats(same, connectivity=4)
        filling = np.flatnonzero((found[1:, :4] == wanted).all(axis=1))
        if len(filling):
            break
    own = np.pad((parts == 1 + filling[0]).astype(np.uint8), 1)
    pixels = np.argwhere(own)[:, ::-1] + (x - 1, y - 1)
    middles = cv2.convexHull(pixels.astype(np.float32)) + _EDGES
    hull = np.asarray(cv2.convexHull(middles.reshape(-1, 2))[:, 0])
    cv2.floodFill(own, None, (0, 0), (2,))
    areas = len(pixels), np.count_nonzero(own != 2)
    return hull, [area / cv2.contourArea(hull) for area in areas]


def resample_outline(outline: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Points (`SAMPLES`,) at equal steps along the closed polygon (n,), in its direction."""
    closed = np.append(outline, outline[0])
    passed = np.append(0.0, np.abs(np.diff(closed)).cumsum())
    at = np.arange(SAMPLES) * passed[-1] / SAMPLES
    return np.asarray(np.interp(at, passed, closed), np.complex128)


def fourier_descriptors(outlines: Outlines) -> NDArray[np.float64]:
    """Descriptors (n, `DESCRIPTORS`) of outlines: Z_k / |Z_1| for k in `TERMS`, their proportions, and `filled`.

    The first are real and imaginary parts, of an outline of width and height 1 that starts where the phase of Z_1 is 0.
    Place, scale and start point change nothing (report chapter 4). Proportions are the logarithm of width by height.
    """
    u, v = outlines.points.real, outlines.points.imag
    wide, tall = np.ptp(u, axis=1, keepdims=True), np.ptp(v, axis=1, keepdims=True)
    scaled = u / wide + 1j * v / tall
    for i in np.flatnonzero(np.isfinite(wide)):
        scaled[i] = resample_outline(scaled[i])
    spectrum = np.fft.fft(scaled, axis=-1)
    first = spectrum[:, 1:2]
    terms = spectrum[:, TERMS] / np.abs(first) * np.exp(-1j * np.angle(first) * np.array(TERMS))
    return np.column_stack([terms.real, terms.imag, np.log(wide / tall), outlines.filled])


def classify_shape(
    detections: Iterator[Detections], *, model: GaussianModel
) -> Iterator[Detections]:
    """Give the open candidates the shape class of their outline by Mahalanobis distance, in space "fourier8".

    A candidate without an accepted shape gets the verdict `shape`.
    """
    for one in detections:
        candidates = one.candidates
        rows = candidates.open_rows()
        shape, distance = candidates.shape.copy(), candidates.shape_distance.copy()
        features = fourier_descriptors(
            outlines_of(one.segmentation, candidates.regions.select(rows))
        )
        shape[rows], distance[rows], ratio = nearest_class(features, model, SHAPES)
        named = replace(candidates, shape=shape, shape_distance=distance)
        refused = rows[~(ratio >= model.threshold)]
        yield replace(one, candidates=named.with_verdict(refused, "shape"))


def outlines_of(segmentation: Segmentation, regions: Regions) -> Outlines:
    """Outlines of regions of equal label (4 neighbours); no two fill the same box, as they would have to cross."""
    points = np.full((len(regions), SAMPLES), complex(np.nan, np.nan))
    filled = np.full((len(regions), 2), np.nan)
    top = segmentation.rows[0]
    boxes = np.rint(regions.box - [0, top, 0, top]).astype(np.int64)
    for source, labels in enumerate(segmentation.labels or ()):  # pass one and two, as in `SOURCES`
        for i in np.flatnonzero(regions.source == source):
            hull, filled[i] = trace_region(labels, boxes[i])
            points[i] = resample_outline(hull[:, 0] + 1j * hull[:, 1])
    return Outlines(points, filled)
