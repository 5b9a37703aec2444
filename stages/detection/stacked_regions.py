"""Stacks: pairs of regions one above the other, equally wide, as one region.

Faces of several colours come apart into such pieces: stripes, halves, a shield under its band.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Dropped, Regions
from wayside.schemas.settings import CandidateSettings
from wayside.stages.geometry import non_maximum_suppression
from wayside.stages.kernels import compiled, require_array


def with_stacks(regions: Regions, settings: CandidateSettings) -> tuple[Regions, Dropped]:
    """The regions and after them the unions of their stacked pairs (source `stack`), without near-duplicates.

    Pairs whose sides agree best come first: of stacks that are nearly the same they stay. The others are counted.
    """
    pairs = stacked_pairs(regions.box, settings)
    sides = regions.box[pairs][:, :, ::2]
    apart = np.abs(sides[:, 0] - sides[:, 1]).sum(axis=1) / np.ptp(sides, axis=2).sum(axis=1)
    upper, lower = pairs[np.argsort(apart, kind="stable")].T
    low = np.minimum(regions.box[upper], regions.box[lower])[:, :2]
    high = np.maximum(regions.box[upper], regions.box[lower])[:, 2:]
    area = np.stack([regions.area_px[upper], regions.area_px[lower]])
    weight = (area / area.sum(axis=0)).astype(np.float32)[:, :, None]
    box = np.concatenate([low, high], axis=1)
    stacks = Regions(
        box,
        area.sum(axis=0).astype(np.int32),
        weight[0] * regions.rgb[upper] + weight[1] * regions.rgb[lower],
        np.full(len(low), SOURCES.index("stack"), np.uint8),
    ).select(settings.fits_face(box))
    both = regions.joined(stacks)
    kept = non_maximum_suppression(both.box, settings.same_region_iou)
    return both.select(kept), Dropped(len(box) - len(stacks), len(both) - len(kept))


def stacked_pairs(box: NDArray[np.float32], settings: CandidateSettings) -> NDArray[np.int64]:
    """Pairs of rows (m, 2), upper and lower, of boxes (n, 4) that stand one above the other, equally wide.

    Raises ValueError where the boxes are not (n, 4).
    """
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    order = np.argsort(box[:, 0], kind="stable")
    limits = settings.stack_edge, settings.stack_edge_px, settings.stack_gap, settings.stack_gap_px
    count = _fill_pairs(box[order], *limits, np.empty((0, 2), np.int64))
    pairs = np.empty((count, 2), np.int64)
    _fill_pairs(box[order], *limits, pairs)
    return np.asarray(order[pairs], np.int64).reshape(-1, 2)


@compiled
def _fill_pairs(
    box: Any, edge_share: Any, edge_px: Any, gap_share: Any, gap_px: Any, pairs: Any
) -> Any:
    # Boxes by their left side; writes the pairs as long as there is room, and counts them all.
    m = 0
    for i in range(box.shape[0]):
        wide = box[i, 2] - box[i, 0]
        for j in range(i + 1, box.shape[0]):
            if box[j, 0] - box[i, 0] > max(edge_share * wide, edge_px):
                break
            edge = max(edge_share * min(wide, box[j, 2] - box[j, 0]), edge_px)
            if box[j, 0] - box[i, 0] > edge or abs(box[j, 2] - box[i, 2]) > edge:
                continue
            upper, lower = (i, j) if box[i, 1] + box[i, 3] < box[j, 1] + box[j, 3] else (j, i)
            tall = min(box[i, 3] - box[i, 1], box[j, 3] - box[j, 1])
            gap = box[lower, 1] - box[upper, 3]
            if gap < -gap_share * tall or gap > max(gap_share * tall, gap_px):
                continue
            if m < pairs.shape[0]:
                pairs[m, 0], pairs[m, 1] = upper, lower
            m += 1
    return m
