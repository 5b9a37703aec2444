"""Boxes over two faces: a sign and its plaque also make one box together, and no less likely a one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import AcceptanceSettings
from wayside.stages.geometry import box_areas
from wayside.stages.mapping.association import AssociationGates, WindowCandidates


class Parts(NamedTuple):
    """Two hypotheses that replace a third one, the better first, and its rows (k,) where both are seen."""

    best: int
    other: int
    rows: NDArray[np.int64]


def find_parts(
    candidates: WindowCandidates,
    row: NDArray[np.int32],
    value: NDArray[np.float64],
    whole: int,
    alive: NDArray[np.bool_],
    gates: AssociationGates,
    settings: AcceptanceSettings,
) -> Parts | None:
    """The two hypotheses whose boxes fill those of a third one and are worth more; None: there are none.

    Both must be seen in the nearest views (far ones show both faces as one). Halves of one face are not worth more, as
    the box classifier refuses them.

    Parameters
    ----------
    candidates
        The window.
    row, value
        Association (m, n) and value (m,) of all hypotheses.
    whole
        The hypothesis that may be of two faces.
    alive
        Hypotheses that may be its parts, (m,).
    gates
        How a candidate's log odds enter the value.
    settings
        Limits of parts.
    """
    frames = np.flatnonzero(row[whole] >= 0)[-settings.part_frames :]
    likely = np.flatnonzero(alive & (value > 0))
    fewest = max(2, len(frames) // 2)
    if len(likely) < 2 or len(frames) < fewest:
        return None
    box, parts = _boxes(candidates, row[whole, frames]), row[likely][:, frames]
    part_box = _boxes(candidates, np.maximum(parts, 0))
    own, area = box_areas(part_box), box_areas(box)
    inner = np.concatenate(
        [np.maximum(part_box, box)[..., :2], np.minimum(part_box, box)[..., 2:]], axis=-1
    )
    within = (
        (parts >= 0)
        & (box_areas(inner) > settings.part_within * own)
        & (own < settings.part_largest * area)
    )
    chosen = np.flatnonzero(within.sum(axis=1) >= fewest)
    chosen = chosen[np.argsort(-value[likely[chosen]], kind="stable")]
    _, first = np.unique(np.where(within, parts, -1)[chosen], axis=0, return_index=True)
    chosen = chosen[np.sort(first)][: settings.most_parts]
    view_value = np.clip(candidates.score + gates.value_shift, gates.value_least, gates.value_most)
    of_whole, of_part = view_value[row[whole, frames]], view_value[np.maximum(parts, 0)]
    best: Parts | None = None
    most = settings.parts_gain
    for i, a in enumerate(chosen):
        for b in chosen[i + 1 :]:
            both = within[a] & within[b]
            if both.sum() < fewest:
                continue
            values = of_part[[a, b]][:, both].mean(axis=1)
            gain = float(values.sum() / max(of_whole[both].mean(), 1.0))
            if gain <= most or values.min() <= settings.part_value:
                continue
            one, other = part_box[a, both], part_box[b, both]
            low, high = np.minimum(one, other), np.maximum(one, other)
            hull = box_areas(np.concatenate([low[:, :2], high[:, 2:]], axis=1))
            overlap = box_areas(np.concatenate([high[:, :2], low[:, 2:]], axis=1))
            smaller = np.minimum(own[a, both], own[b, both])
            if np.median(hull / area[both]) <= settings.parts_fill:
                continue
            if np.median(overlap / smaller) < settings.parts_share:
                rows = row[whole, frames[both]].astype(np.int64)
                best, most = Parts(int(likely[a]), int(likely[b]), rows), gain
    return best


def _boxes(candidates: WindowCandidates, rows: NDArray[np.int32]) -> NDArray[np.float64]:
    """Boxes (..., 4) of candidates as ideal image coordinates."""
    ray, half = candidates.ray[rows], candidates.size[rows] / 2
    return np.concatenate([ray - half, ray + half], axis=-1)
