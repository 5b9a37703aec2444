"""Two-pass K-means segmentation and the size gate (report chapters 2 and 3.1)."""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, ceil, floor, radians, tan

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Dropped, Regions, Segmentation
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import Camera, Image
from wayside.schemas.settings import GateSettings, SegmentSettings
from wayside.stages.segmentation.connected_regions import ConnectedRegions, connected_regions
from wayside.stages.segmentation.label_images import (
    DIFFERENCES,
    MOST_CENTERS,
    difference_histogram,
    label_both_passes,
)
from wayside.stages.segmentation.natural_breaks import classes_of_values, optimal_breaks
from wayside.stages.segmentation.palette import palette, sample_colors

SAMPLE_PX = 80_000
"""The palette is made from at least so many pixels of an image."""
ROADSIDE_TOP_M = 2.2
"""Top of roadside faces above the camera."""
ROADSIDE_RANGE_M = 12.0
"""Roadside faces are segmented down to this range."""
OVERHEAD_TOP_M = 6.5
"""Top of overhead faces above the camera."""
OVERHEAD_RANGE_M = 35.0
"""Overhead faces are segmented down to this range."""
LOWEST_EDGE_M = 1.1
"""Lower edge of faces below the camera."""
PITCH_MARGIN_DEG = 2.0
"""The camera's own pitch, brakes and hills turn the horizon by about this much."""


def segment(
    images: Iterator[Image], settings: SegmentSettings, gate: GateSettings
) -> Iterator[Segmentation]:
    """Divide every image into connected regions of one colour class and of one difference class.

    Pass one is K-means on colour. The difference image holds each pixel's distance to its centre. Pass two is K-means
    on that (exact, in one dimension). Regions of both label images that pass the size gate make the table: those of
    pass one first, each pass in reading order. `region_count` counts the regions of both before the gate.

    Parameters
    ----------
    images
        Images in any state; those without pixels go on with empty tables.
    settings, gate
        Numbers of clusters, part of the image, size limits.

    Yields
    ------
    One item an image, in order. Boxes are in pixels of the full image, labels cover `rows` only.

    Raises
    ------
    UsageError
        If a setting is outside its range.
    """
    _check(settings, gate)
    for image in images:
        if image.rgb is None or image.rgb.size == 0:
            yield unsegmented(image)
            continue
        height = len(image.rgb)
        rows = (0, height) if settings.whole_picture else band_of(image.frame.camera, height)
        yield _segment_rows(image, image.rgb, rows, settings, gate)


def band_of(camera: Camera | None, height: int) -> tuple[int, int]:
    """First and one past the last image row in which the face of a sign can stand.

    Signs stand next to the road or over it up to a known height, and the nearest view that is needed is some 12 m away.
    That bounds the angle above and below the horizon, which lies at the principal point for a level camera, give or
    take the pitch margin. Lens distortion moves these rows by a few pixels at most and is left out.

    Parameters
    ----------
    camera
        The calibration; without one the band is the whole image.
    height
        Rows of the image.
    """
    if camera is None:
        return 0, height
    margin = radians(PITCH_MARGIN_DEG)
    roadside = atan2(ROADSIDE_TOP_M, ROADSIDE_RANGE_M)
    above = max(roadside, atan2(OVERHEAD_TOP_M, OVERHEAD_RANGE_M)) + margin
    below = atan2(LOWEST_EDGE_M, ROADSIDE_RANGE_M) + margin
    first = max(0, floor(camera.cy - camera.fy * tan(above)))
    last = min(height, ceil(camera.cy + camera.fy * tan(below)) + 1)
    return (first, last) if first < last else (0, height)


def _segment_rows(
    image: Image,
    rgb: NDArray[np.uint8],
    rows: tuple[int, int],
    settings: SegmentSettings,
    gate: GateSettings,
) -> Segmentation:
    band = rgb[rows[0] : rows[1]]
    sample = sample_colors(band, SAMPLE_PX)
    centers = palette(sample, settings)
    breaks = optimal_breaks(
        difference_histogram(sample.pixels, centers), settings.difference_clusters
    )
    labels = label_both_passes(band, centers, classes_of_values(breaks, DIFFERENCES))
    passes = _connected(labels, band, gate)
    table, count = _table(passes, rows[0]), sum(one.total for one in passes)
    return Segmentation(
        image,
        table,
        count,
        centers.astype(np.float32),
        breaks.astype(np.float32),
        rows,
        labels,
        Dropped(size=count - len(table)),
    )


def regions_before_gate(segmentation: Segmentation) -> Regions:
    """All connected regions of an image, whatever their size: those of pass one, then of pass two, in reading order.

    Found again in the label images; none where these were not kept.
    """
    image, labels = segmentation.image.rgb, segmentation.labels
    if image is None or labels is None:
        return Regions.empty()
    first, last = segmentation.rows
    every = GateSettings(1, labels[0].size)
    return _table(_connected(labels, image[first:last], every), first)


def _connected(
    labels: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    band: NDArray[np.uint8],
    gate: GateSettings,
) -> list[ConnectedRegions]:
    return [connected_regions(image, band, gate.smallest_px, gate.largest_px) for image in labels]


def _table(passes: list[ConnectedRegions], first_row: int) -> Regions:
    box = np.concatenate([one.box for one in passes]).astype(np.float32)
    box[:, [1, 3]] += first_row
    source = [
        np.full(len(one.area), SOURCES.index(name), np.uint8)
        for one, name in zip(passes, ("pass1", "pass2"), strict=True)
    ]
    return Regions(
        box,
        np.concatenate([one.area for one in passes]),
        np.concatenate([one.rgb for one in passes]),
        np.concatenate(source),
    )


def unsegmented(image: Image) -> Segmentation:
    """An image without regions, as one that is not used."""
    return Segmentation(
        image,
        Regions.empty(),
        0,
        np.zeros((0, 3), np.float32),
        np.zeros(0, np.float32),
        (0, 0),
    )


def _check(settings: SegmentSettings, gate: GateSettings) -> None:
    for name, value in (
        ("segment.clusters", settings.clusters),
        ("segment.difference_clusters", settings.difference_clusters),
    ):
        if not 2 <= value <= MOST_CENTERS:
            raise UsageError(f"{name}: {value} is outside 2 to {MOST_CENTERS}")
    if not 1 <= gate.smallest_px <= gate.largest_px:
        raise UsageError(
            f"gate: smallest_px {gate.smallest_px} and largest_px {gate.largest_px} must satisfy 1 <= smallest_px <= "
            "largest_px"
        )
