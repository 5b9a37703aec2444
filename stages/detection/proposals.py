"""Candidates for sign faces beyond the segments: regions that last over the levels of a few maps.

One palette for a whole picture covers half of the faces; a face is one connected region at some level of some map
(colour against other colours, lighter or darker than the neighbourhood). All levels of six maps are swept, at full
size where far signs stand (near the horizon), at half and quarter size for near and large ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Regions, Segmentation
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.models import TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.classifiers import log_odds
from wayside.stages.detection.boxes import distinct_boxes, patch_means, stacked_pairs
from wayside.stages.detection.contrast_maps import LOWEST, face_maps
from wayside.stages.detection.region_features import REGION_FEATURES, region_features
from wayside.stages.detection.stable_regions import level_regions
from wayside.stages.imaging import halved

BANDS = ((-0.062, 0.056), (-0.16, 0.09), (-0.36, 0.13))
"""Rows looked at in full, half and quarter size, as tangents from the optical axis (up negative).

On level and hilly roads all faces under 40 px stand in the first, under 80 px in the second; pitch and hills included.
"""

STEP = 4
"""Width of a level; noise of a recorded picture is about as large."""

LASTING = 1
"""Levels over which a box must last."""

NARROWEST, WIDEST = 0.2, 6.5
"""Width by height of a face's box."""

SHORTEST_PX = 8
"""Height of the smallest face looked for, pixels of the picture."""

SAME = 0.7
"""Boxes that overlap more (IoU) are one candidate; at .45 faces were lost to their neighbours, at .6 not."""

MOST = 4000
"""Boxes of a picture that are compared with each other at most."""

STACKS = 2
"""Rounds in which regions are stacked: faces of up to four pieces are put together."""


@dataclass(frozen=True, slots=True)
class _Found:
    box: NDArray[np.float32]
    area: NDArray[np.int32]
    rgb: NDArray[np.float32]
    lasted: NDArray[np.int32]


def propose(
    items: Iterator[Segmentation], *, settings: CandidateSettings, ranking: TreeModel | None = None
) -> Iterator[Segmentation]:
    """Add regions of the sources `level` and `stack` to each picture's segments.

    Segments outside the size of a face are dropped, like boxes are merged. At most `settings.most` regions remain:
    those likeliest to be faces by their size, place and mean colour, if there is a `ranking` of these, or else those
    that lasted over most levels; the rest is counted. A picture that is not used passes untouched.

    Raises
    ------
    InputError
        Where the ranking is by something else.
    """
    if ranking is not None and ranking.features != REGION_FEATURES:
        raise InputError(
            f"ranking: wanted the features {', '.join(REGION_FEATURES)}, found "
            f"{', '.join(ranking.features)}; learn it again"
        )
    for item in items:
        rgb, camera = item.image.rgb, item.frame.camera
        if rgb is None or camera is None:
            yield item
            continue
        found = [level_candidates(band, top, scale) for band, top, scale in bands(rgb, camera)]
        regions, left_out = merged(item.regions, found)
        left_out += max(len(regions) - settings.most, 0)
        if ranking is None:
            regions = regions.select(np.arange(min(len(regions), settings.most)))
        else:
            regions = likeliest(regions, ranking, camera, settings.most)
        yield replace(item, regions=regions, left_out=left_out)


def bands(rgb: NDArray[np.uint8], camera: Camera) -> Iterator[tuple[NDArray[np.uint8], int, int]]:
    """The strips of the picture that are swept: pixels, first row in the picture, pixels of the picture per pixel."""
    scale = 1
    for above, below in BANDS:
        top = max(0, round(camera.cy + above * camera.fy)) // 4 * 4
        bottom = min(rgb.shape[0], round(camera.cy + below * camera.fy))
        strip = rgb[top : max(top, bottom)]
        for _ in range(scale.bit_length() - 1):
            strip = halved(strip)
        yield np.ascontiguousarray(strip), top, scale
        scale *= 2


def level_candidates(band: NDArray[np.uint8], top: int, scale: int) -> _Found:
    """Regions of all maps of one strip, boxes in pixels of the picture."""
    maps = face_maps(band)
    parts = []
    for values, lowest in zip(maps, LOWEST, strict=True):
        shortest = max(SHORTEST_PX // scale, 6)
        swept = level_regions(
            values, lowest=lowest, step=STEP, lasting=LASTING, smallest=(3, shortest)
        )
        size = swept.box[:, 2:] - swept.box[:, :2]
        aspect = size[:, 0] / size[:, 1]
        keep = (aspect >= NARROWEST) & (aspect <= WIDEST)
        box = swept.box[keep]
        rgb = patch_means(band, values, box)
        box = box * scale + np.array([0, top, 0, top], np.float32)
        parts.append(_Found(box, swept.area[keep] * scale**2, rgb, swept.lasted[keep]))
    return _Found(
        np.concatenate([p.box for p in parts]),
        np.concatenate([p.area for p in parts]),
        np.concatenate([p.rgb for p in parts]),
        np.concatenate([p.lasted for p in parts]),
    )


def merged(segments: Regions, found: list[_Found]) -> tuple[Regions, int]:
    """Segments and swept regions as one table, like boxes once; those that lasted over most levels first.

    And how many found no room in it.
    """
    size = segments.box[:, 2:] - segments.box[:, :2]
    aspect = size[:, 0] / np.maximum(size[:, 1], 1)
    plausible = (aspect >= NARROWEST) & (aspect <= WIDEST) & (size[:, 1] >= SHORTEST_PX)
    segments = segments.select(plausible)
    count = sum(len(f.box) for f in found)
    box = np.concatenate([*(f.box for f in found), segments.box]).astype(np.float32)
    together = Regions(
        box,
        np.concatenate([*(f.area for f in found), segments.area_px]).astype(np.int32),
        np.concatenate([*(f.rgb for f in found), segments.rgb]).astype(np.float32),
        np.concatenate([np.full(count, SOURCES.index("level"), np.uint8), segments.source]),
    )
    lasted = np.concatenate([*(f.lasted for f in found), np.zeros(len(segments), np.int32)])
    order = np.argsort(-lasted, kind="stable")
    distinct = distinct_boxes(box[order], SAME)
    regions = together.select(order[distinct[:MOST]])
    for _ in range(STACKS):
        regions = with_stacks(regions)
    cut = max(len(distinct) - MOST, 0) + max(len(regions) - MOST, 0)
    return regions.select(np.arange(min(len(regions), MOST))), cut


def likeliest(regions: Regions, ranking: TreeModel, camera: Camera, most: int) -> Regions:
    """At most so many regions, in the order they came: those that the ranking holds for the likeliest faces."""
    odds = log_odds(ranking, region_features(regions, camera))
    return regions.select(np.sort(np.argsort(-odds, kind="stable")[:most]))


def with_stacks(regions: Regions) -> Regions:
    """The regions and after them what pairs of them, one above the other, make together (source `stack`).

    Pairs whose sides agree best come first: of like stacks they stay.
    """
    pairs = stacked_pairs(regions.box)
    sides = regions.box[pairs][:, :, ::2]
    apart = np.abs(sides[:, 0] - sides[:, 1]).sum(axis=1) / np.ptp(sides, axis=2).sum(axis=1)
    upper, lower = pairs[np.argsort(apart, kind="stable")].T
    low = np.minimum(regions.box[upper], regions.box[lower])[:, :2]
    high = np.maximum(regions.box[upper], regions.box[lower])[:, 2:]
    area = np.stack([regions.area_px[upper], regions.area_px[lower]])
    share = (area / area.sum(axis=0)).astype(np.float32)[:, :, None]
    size = high - low
    aspect = size[:, 0] / size[:, 1]
    fits = (aspect >= NARROWEST) & (aspect <= WIDEST) & (size[:, 1] >= SHORTEST_PX)
    stacks = Regions(
        np.concatenate([low, high], axis=1),
        area.sum(axis=0).astype(np.int32),
        share[0] * regions.rgb[upper] + share[1] * regions.rgb[lower],
        np.full(len(low), SOURCES.index("stack"), np.uint8),
    ).select(fits)
    both = regions.joined(stacks)
    return both.select(distinct_boxes(both.box, SAME))
