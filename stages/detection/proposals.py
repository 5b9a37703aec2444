"""Candidates for sign faces beyond the segments: stable regions of contrast maps.

One palette for a whole image covers half of the faces; a face is one connected region at some level of some map (colour
against other colours, lighter or darker than the neighbourhood). All levels of six maps are swept, at full size where
far signs stand (near the horizon), at half and quarter size for near and large ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import (
    SHAPES,
    SOURCES,
    Dropped,
    NetworkBoxes,
    Regions,
    Segmentation,
)
from wayside.schemas.frame import Camera
from wayside.schemas.models import OnnxFile, TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.classifiers import log_odds
from wayside.stages.detection.contrast_maps import contrast_maps, foreground_means
from wayside.stages.detection.feature_vectors import (
    REGION_FEATURES,
    region_features,
    require_names,
)
from wayside.stages.detection.network_proposals import (
    DetectionNetwork,
    boxes_of_maps,
    middle_scores,
)
from wayside.stages.detection.stable_regions import find_stable_regions
from wayside.stages.detection.stacked_regions import with_stacks
from wayside.stages.geometry import non_maximum_suppression
from wayside.stages.imaging import halved

FILLED = {"rectangle": 0.98, "diamond": 0.5, "octagon": 0.83, "triangle": 0.5, "circle": 0.785}
"""Area of a shape as a fraction of its box."""


@dataclass(frozen=True, slots=True)
class Proposals:
    """Stable regions of one band, n rows, in pixels of the image; lifetime (n,): levels over which the box stayed.

    unfit: how many more there are that no face has the size of.
    """

    regions: Regions
    lifetime: NDArray[np.int32]
    unfit: int = 0


def propose(
    items: Iterator[Segmentation],
    *,
    settings: CandidateSettings,
    ranking: TreeModel | None = None,
    network: OnnxFile | None = None,
) -> Iterator[Segmentation]:
    """Add regions of the sources `level` and `stack` to each image's segments.

    Segments outside the size of a face are dropped, boxes that are nearly the same are merged. At most `settings.most`
    regions remain: the most probable faces by their size, position and mean colour, where a `ranking` of these is
    given, else those of the longest lifetime; all others are counted in `dropped`. The boxes of a detection `network`
    join them without being ranked: it has seen more of them than their colour. An image that is not used passes
    unchanged.

    Raises
    ------
    InputError
        Where the ranking has other features.
    """
    if ranking is not None:
        require_names("ranking", ranking.features, REGION_FEATURES, exact=True)
    detection_network = None if network is None else DetectionNetwork(network.path)
    for item in items:
        rgb, camera = item.image.rgb, item.frame.camera
        if rgb is None or camera is None:
            yield item
            continue
        found = [
            propose_in_band(band, top, scale, settings)
            for band, top, scale in bands(rgb, camera, settings)
        ]
        regions, dropped = merge_regions(item.regions, found, settings)
        dropped = dropped.plus(Dropped(left_out=max(len(regions) - settings.most, 0)))
        if ranking is None:
            regions = regions.select(np.arange(min(len(regions), settings.most)))
        else:
            regions = most_probable(regions, ranking, camera, settings.most)
        if detection_network is not None:
            band, top = widest_band(rgb, camera, settings)
            if len(band):
                maps = detection_network.maps(band)
                seen = boxes_of_maps(
                    maps,
                    band.shape[:2],
                    settings.network_score,
                    settings.network_most,
                    settings.network_iou,
                )
                more, unfit = network_regions(seen, band, settings)
                down = np.array([0, top, 0, top], np.float32)
                regions = regions.joined(replace(more, box=more.box + down))
                dropped = dropped.plus(Dropped(size=unfit))
                score = middle_scores(maps, regions.box - down, settings.network_least)
                item = replace(item, network_score=score)
        yield replace(item, regions=regions, dropped=item.dropped.plus(dropped))


def bands(
    rgb: NDArray[np.uint8], camera: Camera, settings: CandidateSettings
) -> Iterator[tuple[NDArray[np.uint8], int, int]]:
    """The bands of rows that are searched: pixels, first row in the image, image pixels per pixel."""
    scale = 1
    for above, below in settings.bands:
        top = max(0, round(camera.cy + above * camera.fy)) // 4 * 4
        bottom = min(rgb.shape[0], round(camera.cy + below * camera.fy))
        band = rgb[top : max(top, bottom)]
        for _ in range(scale.bit_length() - 1):
            band = halved(band)
        yield np.ascontiguousarray(band), top, scale
        scale *= 2


def widest_band(
    rgb: NDArray[np.uint8], camera: Camera, settings: CandidateSettings
) -> tuple[NDArray[np.uint8], int]:
    """The rows that the detection network sees, and the first of them; there may be none."""
    above, below = settings.bands[-1]
    top = max(0, round(camera.cy + above * camera.fy))
    bottom = min(rgb.shape[0], round(camera.cy + below * camera.fy))
    return np.ascontiguousarray(rgb[top : max(top, bottom)]), top


def network_regions(
    found: NetworkBoxes, rgb: NDArray[np.uint8], settings: CandidateSettings
) -> tuple[Regions, int]:
    """Those of a size that faces have as regions, best first, and how many have another.

    Their area is that of the most probable shape.
    """
    rows = np.flatnonzero(settings.fits_face(found.box))
    box = found.box[rows]
    means = [mean_inside(rgb, corners) for corners in box]
    regions = Regions(
        box,
        filled_area(box, found.shape[rows].argmax(axis=1), settings),
        np.array(means, np.float32).reshape(-1, 3),
        np.full(len(box), SOURCES.index("network"), np.uint8),
    )
    return regions, len(found.box) - len(box)


def filled_area(
    box: NDArray[np.float32], shape: NDArray[np.integer], settings: CandidateSettings
) -> NDArray[np.int32]:
    """Areas (n,) of faces of these shapes (n,) in boxes (n, 4); of an unknown shape (-1) that of a usual one."""
    other = settings.other_filled
    filled = [other if k < 0 else FILLED.get(SHAPES[k], other) for k in shape]
    return np.asarray(np.array(filled) * np.prod(box[:, 2:] - box[:, :2], axis=1), np.int32)


def mean_inside(rgb: NDArray[np.uint8], box: NDArray[np.float32]) -> NDArray[np.float64]:
    """Mean colour of the inner half of a box: most of its corners show the background."""
    quarter = (box[2:] - box[:2]) / 4
    x0, y0 = np.floor(box[:2] + quarter).astype(int)
    x1, y1 = np.maximum(np.ceil(box[2:] - quarter).astype(int), [x0 + 1, y0 + 1])
    return np.asarray(rgb[y0:y1, x0:x1].reshape(-1, 3).mean(axis=0))


def propose_in_band(
    band: NDArray[np.uint8], top: int, scale: int, settings: CandidateSettings
) -> Proposals:
    """Stable regions of all contrast maps of one band."""
    parts = []
    shortest = max(settings.shortest_px // scale, settings.shortest_map_px)
    maps = contrast_maps(band, settings.map_dark_level, settings.neighbourhood_px)
    for values, first_level in zip(maps, settings.first_levels, strict=True):
        found = find_stable_regions(
            values,
            first_level=first_level,
            step=settings.level_step,
            min_lifetime=settings.lifetime,
            same_iou=settings.stable_iou,
            smallest=(settings.narrowest_map_px, shortest),
            largest=(settings.largest_map_px, settings.largest_map_px),
            capacity=settings.most_map_regions,
        )
        box = found.box * scale + np.array([0, top, 0, top], np.float32)
        keep = settings.fits_face(box)
        regions = Regions(
            box[keep],
            found.area[keep] * scale**2,
            foreground_means(band, values, found.box[keep], settings.mean_samples),
            np.full(int(keep.sum()), SOURCES.index("level"), np.uint8),
        )
        parts.append(Proposals(regions, found.lifetime[keep], int((~keep).sum())))
    return joined(parts)


def joined(parts: list[Proposals]) -> Proposals:
    """The rows of all parts, in order."""
    regions = Regions.empty()
    for part in parts:
        regions = regions.joined(part.regions)
    lifetime = [np.zeros(0, np.int32), *(part.lifetime for part in parts)]
    return Proposals(regions, np.concatenate(lifetime), sum(part.unfit for part in parts))


def merge_regions(
    segments: Regions, found: list[Proposals], settings: CandidateSettings
) -> tuple[Regions, Dropped]:
    """Proposals and segments as one table without near-duplicates, longest lifetime first; and what it lacks.

    The table has at most `settings.most_compared` rows; stacks of its regions stand behind the others.
    """
    fitting = segments.select(settings.fits_face(segments.box))
    unfit = len(segments) - len(fitting)
    every = joined([*found, Proposals(fitting, np.zeros(len(fitting), np.int32), unfit)])
    order = np.argsort(-every.lifetime, kind="stable")
    kept = non_maximum_suppression(every.regions.box[order], settings.same_region_iou)
    most = settings.most_compared
    regions = every.regions.select(order[kept[:most]])
    dropped = Dropped(every.unfit, len(order) - len(kept), max(len(kept) - most, 0))
    for _ in range(settings.stack_rounds):
        regions, unstacked = with_stacks(regions, settings)
        dropped = dropped.plus(unstacked)
    dropped = dropped.plus(Dropped(left_out=max(len(regions) - most, 0)))
    return regions.select(np.arange(min(len(regions), most))), dropped


def most_probable(regions: Regions, ranking: TreeModel, camera: Camera, most: int) -> Regions:
    """At most so many regions, in the order they came: those of the highest log odds by the ranking."""
    odds = log_odds(ranking, region_features(regions, camera))
    return regions.select(np.sort(np.argsort(-odds, kind="stable")[:most]))
