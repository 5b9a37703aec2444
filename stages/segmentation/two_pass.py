"""Two-pass K-means segmentation and the size gate (report chapters 2 and 3.1)."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba.cpython.unsafe.numbers import trailing_zeros
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Dropped, Regions, Segmentation
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import Camera, Image
from wayside.schemas.settings import GateSettings, SegmentSettings
from wayside.stages.kernels import Array, Bytes, Numbers, compiled, compiled_within, require_array
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

_PACK = np.uint64(0x0102040810204080)
Runs = NDArray[np.uint32]
Counts = NDArray[np.int32]


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
    image: Image, rgb: Bytes, settings: SegmentSettings, gate: GateSettings
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


def optimal_breaks(histogram: NDArray[Any], classes: int) -> Numbers:
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
    counts = counts[: max(classes, np.flatnonzero(counts).max(initial=-1) + 1)]
    values = np.arange(counts.size)
    moments = np.stack([counts, counts * values, counts * values**2]).cumsum(axis=1)
    w, s, q = (np.subtract.outer(*[np.append(0.0, one)] * 2) for one in moments)  # of t to i
    starts = np.empty((classes - 1, counts.size + 1), np.int64)
    _divide(np.maximum(0.0, q - s * s / np.where(w > 0, w, 1.0)), starts)
    breaks = [counts.size]
    for start in starts[::-1]:
        breaks.append(int(start[breaks[-1]]))
    return np.array([0, *reversed(breaks[1:])], np.int64)


@compiled
def _divide(cost: Array, starts: Numbers) -> None:
    """First value of the last class of the best division of the first i values into 2, 3, ... classes."""
    best = cost[:, 0].copy()
    for j in range(len(starts)):
        for i in range(best.size - 1, -1, -1):
            least = np.inf
            for t in range(i + 1):
                this = best[t] + cost[i, t]
                if this < least:
                    least, starts[j, i] = this, t
            best[i] = least


def connected_regions(
    labels: Bytes, rgb: Bytes, gate: GateSettings, source: str = "pass1"
) -> tuple[Regions, int]:
    """Regions of equal label (4 neighbours) within the size gate, in reading order, and how many there are before it.

    `labels` (height, width) and `rgb` (height, width, 3) uint8, C-contiguous; ValueError where they are not.
    """
    require_array(labels, "labels", np.uint8, (None, None))
    height, width = labels.shape
    require_array(rgb, "rgb", np.uint8, (height, width, 3))
    if labels.size == 0:
        return Regions.empty(), 0
    start, parent, area = np.empty((3, labels.size + 1), np.uint32)
    count = _join_runs(labels, start, parent, area)
    area, row = area[:count], np.full(count, -1, np.int32)
    kept = np.flatnonzero((area >= gate.smallest_px) & (area <= gate.largest_px))
    row[kept] = np.arange(len(kept))
    box = np.tile(np.array([width, height, 0, 0], np.int32), (len(kept), 1))
    sums = np.zeros((len(kept), 3), np.int64)
    _measure(start, parent, row, width, rgb.ravel(), box, sums)
    return Regions(
        box.astype(np.float32),
        area[kept].astype(np.int32),
        (sums / area[kept, None]).astype(np.float32),
        np.full(len(kept), SOURCES.index(source), np.uint8),
    ), int(np.count_nonzero(area))


@compiled
def _join_runs(labels: Bytes, start: Runs, parent: Runs, area: Runs) -> int:
    """Number of runs of equal label in rows, in reading order.

    Fills for each run its start (row * width + column), the first run of its region (`parent`), and the pixels of the
    region that it is the first run of, else 0. Union-find: a root is the smallest run. 64 pixels are one word. The
    loop over starts of runs, here and in the row above, has no branch, which noise would mispredict.
    """
    height, width = labels.shape
    words, one, top = (width + 63) // 64, np.uint64(1), np.uint64(56)
    flags, above = np.zeros((2, 64 * words), np.uint8), np.zeros(words, np.uint64)
    eights, pair = flags.view(np.uint64), np.empty((2, 2 * width), np.uint32)
    n = upper = np.uint64(0)  # signed indices would be tested for being negative
    for y in range(height):
        row, row_above, first, pairs = labels[y], labels[max(0, y - 1)], n, np.uint64(0)
        flags[0, 0] = 1
        for x in range(1, width):
            flags[0, x] = row[x] != row[x - 1]
        for x in range(width):
            flags[1, x] = row[x] == row_above[x]
        for word in range(words):
            new = same = np.uint64(0)
            for byte in range(8):  # the highest byte of a product has one bit of each byte
                new |= eights[0, 8 * word + byte] * _PACK >> top << np.uint64(8 * byte)
                same |= eights[1, 8 * word + byte] * _PACK >> top << np.uint64(8 * byte)
            before = above[word]
            either, above[word] = new | before, new
            while either:
                bit = np.uint64(trailing_zeros(either))  # type: ignore[call-arg]
                either &= either - one
                start[n] = y * width + 64 * word + np.int64(bit)
                n += new >> bit & one
                upper += before >> bit & one
                pair[0, pairs], pair[1, pairs] = upper - one, n - one
                pairs += same >> bit & one
        for run in range(first, n):
            parent[run], area[run] = run, 0
        for k in range(pairs if y > 0 else np.uint64(0)):
            i, j = _root(parent, pair[0, k]), pair[1, k]
            if parent[j] != j:  # joined already
                j = _root(parent, j)
            parent[max(i, j)] = min(i, j)
    start[n] = labels.size
    for run in range(n):
        parent[run] = parent[parent[run]]
        area[parent[run]] += start[run + one] - start[run]
    return int(n)


@compiled
def _measure(
    start: Runs, parent: Runs, row: Counts, width: int, levels: Bytes, box: Counts, sums: Numbers
) -> None:
    """Boxes (k, 4) and sums of colours (k, 3) of the regions whose first run has a row; `levels`: of a flat image."""
    kept, count = np.empty(row.size, np.uint32), 0
    for i in range(row.size):
        kept[count] = i
        count += row[parent[i]] >= 0
    for i in kept[:count]:
        k, end = row[parent[i]], start[i + np.uint32(1)]
        y, left = divmod(start[i], np.uint32(width))
        box[k, 0], box[k, 1] = min(box[k, 0], left), min(box[k, 1], y)
        box[k, 2], box[k, 3] = max(box[k, 2], left + end - start[i]), y + 1
        red = green = blue = np.uint32(0)
        for x in range(3 * start[i], 3 * end, 3):
            red, green, blue = red + levels[x], green + levels[x + 1], blue + levels[x + 2]
        sums[k, 0], sums[k, 1], sums[k, 2] = sums[k, 0] + red, sums[k, 1] + green, sums[k, 2] + blue


@compiled_within
def _root(parent: Runs, i: np.uint32) -> np.uint32:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


def _regions_of(
    labels: tuple[Bytes, Bytes], band: Bytes, first_row: int, gate: GateSettings
) -> tuple[Regions, int]:
    """Regions of both label images, with boxes in the whole image, and how many there are before the gate."""
    first, second = (connected_regions(labels[k], band, gate, SOURCES[k]) for k in range(2))
    regions = Regions.joined([first[0], second[0]])
    regions.box[:, [1, 3]] += first_row
    return regions, first[1] + second[1]


def unsegmented(image: Image) -> Segmentation:
    """An image without regions, as one that is not used."""
    centers, breaks = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    return Segmentation(image, Regions.empty(), 0, centers, breaks, (0, 0))
