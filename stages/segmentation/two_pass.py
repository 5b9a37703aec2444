"""Two-pass K-means segmentation and the size gate (report chapters 2 and 3.1)."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Dropped, Regions, Segmentation
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import Camera, Image
from wayside.schemas.settings import GateSettings, SegmentSettings
from wayside.stages.kernels import compiled, compiled_within, require_array
from wayside.stages.segmentation.palette import (
    DIFFERENCES,
    nearest_centers,
    palette,
    sample_colors,
)

SAMPLE_PX = 80_000
"""The palette is made from at least so many pixels of an image."""
FACE_ROWS = (-0.4, 0.15)
"""Where in an image faces can stand, as tangents of the angle below its optical axis: with -0.22 and 0.13 a fifth of
the faces in images of streets is not seen."""


def segment(
    images: Iterator[Image], settings: SegmentSettings, gate: GateSettings
) -> Iterator[Segmentation]:
    """Divide every image into connected regions of one colour class and of one difference class.

    Pass one is K-means on colour. The difference image holds each pixel's distance to its centre. Pass two is K-means
    on that (exact, in one dimension). Regions of both label images that pass the size gate make the table: those of
    pass one first, each pass in reading order. `region_count` counts the regions of both before the gate.

    Images without pixels go on with empty tables. Boxes are in pixels of the full image, labels cover `rows` only.

    Raises UsageError where the limits of the size contradict each other, and ValueError where a number of clusters is
    outside its range.
    """
    if not 1 <= gate.smallest_px <= gate.largest_px:
        raise UsageError(
            f"gate: smallest_px {gate.smallest_px} and largest_px {gate.largest_px} must satisfy 1 <= smallest_px <= "
            "largest_px"
        )
    for image in images:
        if image.rgb is None or image.rgb.size == 0:
            yield unsegmented(image)
            continue
        yield _segment_rows(image, image.rgb, settings, gate)


def band_of(camera: Camera | None, height: int) -> tuple[int, int]:
    """First and one past the last image row in which the face of a sign can stand (`FACE_ROWS`).

    `height`: rows of the image. Without a camera, or where it looks elsewhere, the band is the whole image.
    """
    if camera is None:
        return 0, height
    first, last = (min(max(0, round(camera.cy + t * camera.fy)), height) for t in FACE_ROWS)
    return (first, last) if first < last else (0, height)


def _segment_rows(
    image: Image, rgb: NDArray[np.uint8], settings: SegmentSettings, gate: GateSettings
) -> Segmentation:
    rows = band_of(image.frame.camera, len(rgb))
    band = rgb[slice(*rows)]
    sample = sample_colors(rgb, SAMPLE_PX)
    centers = palette(sample, settings.clusters)
    counts = np.bincount(nearest_centers(sample, centers)[1], minlength=DIFFERENCES)
    breaks = optimal_breaks(counts, settings.difference_clusters)
    # The lower half is noise around the colours of pass one: one class. Larger k cut faces into pieces.
    breaks[: settings.difference_clusters // 2 + 1] = 0
    class_of = np.searchsorted(breaks[1:], np.arange(DIFFERENCES), side="right").astype(np.uint8)
    labels = nearest_centers(band, centers, class_of)
    table, count = _regions_of(labels, band, rows[0], gate)
    levels = centers.astype(np.float32), breaks.astype(np.float32)
    return Segmentation(image, table, count, *levels, rows, labels, Dropped(count - len(table)))


def regions_before_gate(segmentation: Segmentation) -> Regions:
    """All connected regions of an image, whatever their size: those of pass one, then of pass two, in reading order.

    Found again in the label images; none where these were not kept.
    """
    image, labels = segmentation.image.rgb, segmentation.labels
    if image is None or labels is None:
        return Regions.empty()
    first, last = segmentation.rows
    return _regions_of(labels, image[first:last], first, GateSettings(1, labels[0].size))[0]


def optimal_breaks(histogram: NDArray[Any], classes: int) -> NDArray[np.int64]:
    """First value of each class in the K-means optimum of whole numbers 0, 1, ... given how often each occurs.

    The best classes are intervals, found by dynamic programming without a start or a seed. The cost of the first i
    values in j classes is D[j, i] = min over t of D[j-1, t] + cost(t, i). It is the sum of squared distances to the
    mean. (Lloyd steps from quantiles end at two to three times this optimum.)

    histogram (n,): how often each value occurs, none negative. `classes`: k, 1 to n; some are empty where fewer values
    occur. Returns (classes,), rising (equal where a class is empty), the first is 0.

    Raises ValueError where the histogram is empty, not one-dimensional or negative somewhere, or k is not from 1 to n.
    """
    counts = np.ascontiguousarray(histogram, np.float64)
    if counts.ndim != 1 or not 1 <= classes <= counts.size:
        raise ValueError(f"classes: {classes} is outside 1 to the number of values, {counts.shape}")
    if not np.all(counts >= 0):
        raise ValueError("histogram: a count is negative or nan")
    counts = np.trim_zeros(counts, "b")
    counts = np.pad(counts, (0, max(0, classes - counts.size)))  # what never occurs costs nothing
    values = np.arange(counts.size)
    weight, first, second = (
        np.append(0.0, np.cumsum(counts * part)) for part in (1, values, values**2)
    )
    w, s, q = (one[:, None] - one for one in (weight, first, second))  # of the values t to i
    cost = np.maximum(0.0, q - s * s / np.where(w > 0, w, 1.0))
    cost[np.triu_indices(len(cost), 1)] = np.inf
    best, starts = cost[:, 0], []
    for _ in range(classes - 1):
        every = best + cost
        starts.append(every.argmin(axis=1))
        best = every.min(axis=1)
    breaks = [counts.size]
    for start in reversed(starts):
        breaks.append(int(start[breaks[-1]]))
    return np.array([0, *reversed(breaks[1:])], np.int64)


def connected_regions(
    labels: NDArray[np.uint8], rgb: NDArray[np.uint8], gate: GateSettings, source: str = "pass1"
) -> tuple[Regions, int]:
    """Regions of equal label (4 neighbours) within the size gate, in reading order, and how many there are before it.

    `labels` (height, width) and `rgb` (height, width, 3) uint8, C-contiguous; ValueError where they are not.
    """
    require_array(labels, "labels", np.uint8, (None, None))
    height, width = labels.shape
    require_array(rgb, "rgb", np.uint8, (height, width, 3))
    if labels.size == 0:
        return Regions.empty(), 0
    end, parent, area = np.empty((3, labels.size), np.int32)
    count = _join_runs(labels, end, parent, area)
    area = area[:count]
    kept = np.flatnonzero((area >= gate.smallest_px) & (area <= gate.largest_px))
    row = np.full(len(area), -1, np.int32)
    row[kept] = np.arange(len(kept))
    box = np.tile(np.array([width, height, 0, 0], np.int32), (len(kept), 1))
    sums = np.zeros((len(kept), 3), np.int64)
    _measure(end, parent, row, rgb, box, sums)
    return Regions(
        box.astype(np.float32),
        area[kept],
        (sums / area[kept, None]).astype(np.float32),
        np.full(len(kept), SOURCES.index(source), np.uint8),
    ), int(np.count_nonzero(area))


@compiled
def _join_runs(
    labels: NDArray[np.uint8],
    end: NDArray[np.int32],
    parent: NDArray[np.int32],
    area: NDArray[np.int32],
) -> int:
    """Number of runs of equal label in rows, in reading order.

    Fills for each run its end (row * width + column), the first run of its region (`parent`), and the pixels of the
    region that it is the first run of, else 0. Union-find: a root is the smallest run. The loops that find runs and
    pairs of them have no branch, which would be mispredicted in noise.
    """
    height, width = labels.shape
    label = np.empty(labels.size, np.uint8)
    above, below = np.empty((2, 2 * width), np.int32)
    n = first = 0
    for y in range(height):
        upper_first, first, before = first, n, labels[y, 0]
        for x in range(1, width):
            end[n], label[n] = y * width + x, before
            n += labels[y, x] != before
            before = labels[y, x]
        end[n], label[n] = (y + 1) * width, before
        n += 1
        for i in range(first, n):
            parent[i], area[i] = i, 0
        i, j, pairs = upper_first, first, 0
        while y > 0 and j < n:
            above[pairs], below[pairs] = i, j
            pairs += label[i] == label[j]
            upper, lower = end[i] + width, end[j]
            i += upper <= lower
            j += lower <= upper
        for k in range(pairs):
            i, j = _root(parent, above[k]), below[k]
            if parent[j] != j:  # joined already
                j = _root(parent, j)
            parent[max(i, j)] = min(i, j)
    start = 0
    for i in range(n):
        parent[i] = parent[parent[i]]
        area[parent[i]] += end[i] - start
        start = end[i]
    return n


@compiled
def _measure(
    end: NDArray[np.int32],
    parent: NDArray[np.int32],
    row: NDArray[np.int32],
    rgb: NDArray[np.uint8],
    box: NDArray[np.int32],
    sums: NDArray[np.int64],
) -> None:
    """Boxes (k, 4) and sums of colours (k, 3) of the regions whose first run has a row."""
    for i in range(row.size):
        k = row[parent[i]]
        if k < 0:
            continue
        start = end[i - 1] if i > 0 else 0
        y, left = divmod(start, rgb.shape[1])
        right = left + end[i] - start
        box[k, 0], box[k, 1] = min(box[k, 0], left), min(box[k, 1], y)
        box[k, 2], box[k, 3] = max(box[k, 2], right), y + 1
        for x in range(left, right):
            for c in range(3):
                sums[k, c] += rgb[y, x, c]


@compiled_within
def _root(parent: NDArray[np.int32], i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


def _regions_of(
    labels: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    band: NDArray[np.uint8],
    first_row: int,
    gate: GateSettings,
) -> tuple[Regions, int]:
    """Regions of both label images, with boxes in the whole image, and how many there are before the gate."""
    first, second = (
        connected_regions(image, band, gate, source)
        for image, source in zip(labels, ("pass1", "pass2"), strict=True)
    )
    regions = Regions.joined([first[0], second[0]])
    regions.box[:, [1, 3]] += first_row
    return regions, first[1] + second[1]


def unsegmented(image: Image) -> Segmentation:
    """An image without regions, as one that is not used."""
    centers, breaks = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    return Segmentation(image, Regions.empty(), 0, centers, breaks, (0, 0))
