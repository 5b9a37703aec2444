"""Greedy acceptance: hypotheses become landmarks, best first, and each removes its candidates from the rest.

So a plaque under a sign is found after the sign, and the several boxes on one face end up in one landmark.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import AcceptanceSettings, LandmarkSettings
from wayside.stages.mapping.association import AssociationGates, WindowCandidates, associate
from wayside.stages.mapping.hypotheses import Hypotheses
from wayside.stages.mapping.landmark_fit import LandmarkFit, fit_hypothesis


def accept_greedily(
    candidates: WindowCandidates,
    hypotheses: Hypotheses,
    free: NDArray[np.bool_],
    gates: AssociationGates,
    settings: AcceptanceSettings,
    landmark: LandmarkSettings,
    *,
    fewest: int,
) -> list[LandmarkFit]:
    """Landmarks of a window, best first, each with candidates of its own.

    Parameters
    ----------
    candidates
        The window, N rows.
    hypotheses
        Points to try.
    free
        Candidates that may be used, (N,).
    gates
        Largest gaps and ratios of a view, and what it counts.
    settings, landmark
        Limits of hypotheses; errors of boxes; robust cost and limits of the iteration.
    fewest
        Views that a landmark needs.
    """
    point, size = hypotheses.point, hypotheses.size
    left = free.copy()
    row, _, value = found = associate(candidates, point, size, left, gates)
    alive = (found.views() >= fewest) & (value > settings.least_value)
    fits: list[LandmarkFit] = []
    while alive.any():
        best = int(np.argmax(np.where(alive, value, -np.inf)))
        alive[best] = False
        fit = fit_hypothesis(
            candidates, row[best], left, gates, landmark, fewest=fewest, rounds=settings.rounds
        )
        if fit is None or fit.value <= settings.least_value:
            continue
        own = candidates.first[fit.frames] + fit.rows
        covered = np.setdiff1d(same_face_rows(candidates, own, fit.frames, left, settings), own)
        fits.append(replace(fit, covered=candidates.by_frame(covered)))
        left[own] = False
        left[covered] = False
        again = np.flatnonzero(alive & ((row >= 0) & ~left[row]).any(axis=1))
        if len(again):
            found = associate(candidates, point[again], size[again], left, gates)
            row[again], value[again] = found.row, found.value
            alive[again] = (found.views() >= fewest) & (found.value > settings.least_value)
    return fits


def same_face_rows(
    candidates: WindowCandidates,
    rows: NDArray[np.int64],
    frames: NDArray[np.int64],
    free: NDArray[np.bool_],
    settings: AcceptanceSettings,
) -> NDArray[np.int64]:
    """Free candidates that overlap the view (rows and frames, (v,), ascending) of their frame, or lie within it."""
    c, first = candidates, candidates.first
    beside = [first[f] + np.flatnonzero(free[first[f] : first[f + 1]]) for f in frames]
    pairs = np.concatenate(beside), np.repeat(rows, [len(near) for near in beside])
    low = np.maximum(*(c.ray[side] - c.size[side] / 2 for side in pairs))
    high = np.minimum(*(c.ray[side] + c.size[side] / 2 for side in pairs))
    shared = np.maximum(high - low, 0).prod(axis=1)
    area, view = (c.size[side].prod(axis=1) for side in pairs)
    same = shared > settings.same_face_cover * area
    same |= shared > settings.same_face_iou * (area + view - shared)
    return np.asarray(pairs[0][same])
