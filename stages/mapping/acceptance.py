"""Greedy acceptance: hypotheses become landmarks, best first, and each removes its candidates from the rest.

So a plaque under a sign is found after the sign, and the several boxes on one face end up in one landmark.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import AcceptanceSettings, AdjustmentSettings, LandmarkSettings
from wayside.stages.kernels import Array, compiled
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
    solver: AdjustmentSettings,
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
    settings, landmark, solver
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
            candidates,
            row[best],
            left,
            gates,
            landmark,
            solver,
            fewest=fewest,
            rounds=settings.rounds,
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
    """Free candidates that overlap one of the views (rows and frames, (v,)) or lie within it."""
    mark = np.zeros(len(candidates.ray), np.bool_)
    _mark_same_face(
        candidates.first, candidates.ray, candidates.size, rows, frames, free,
        settings.same_face_iou, settings.same_face_cover, mark,
    )  # fmt: skip
    return np.flatnonzero(mark)


@compiled
def _mark_same_face(
    first: NDArray[np.int64],
    ray: Array,
    size: Array,
    rows: NDArray[np.int64],
    frames: NDArray[np.int64],
    free: NDArray[np.bool_],
    iou: float,
    cover: float,
    mark: NDArray[np.bool_],
) -> None:
    for i in range(rows.shape[0]):
        r, n = rows[i], frames[i]
        for k in range(first[n], first[n + 1]):
            if not free[k]:
                continue
            wide = min(ray[r, 0] + size[r, 0] / 2, ray[k, 0] + size[k, 0] / 2) - max(
                ray[r, 0] - size[r, 0] / 2, ray[k, 0] - size[k, 0] / 2
            )
            tall = min(ray[r, 1] + size[r, 1] / 2, ray[k, 1] + size[k, 1] / 2) - max(
                ray[r, 1] - size[r, 1] / 2, ray[k, 1] - size[k, 1] / 2
            )
            if wide <= 0 or tall <= 0:
                continue
            inner = wide * tall
            mine, other = size[r, 0] * size[r, 1], size[k, 0] * size[k, 1]
            if inner > iou * (mine + other - inner) or inner > cover * other:
                mark[k] = True
