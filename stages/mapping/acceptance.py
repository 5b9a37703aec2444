"""Greedy acceptance: hypotheses become landmarks, best first, and each removes its candidates from the rest.

Other boxes on a face make landmarks of their own: which one is the face, all evidence decides (`verdicts.same_face`).
"""

from __future__ import annotations

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
        fits.append(fit)
        left[candidates.first[fit.frames] + fit.rows] = False
        again = np.flatnonzero(alive & ((row >= 0) & ~left[row]).any(axis=1))
        if len(again):
            found = associate(candidates, point[again], size[again], left, gates)
            row[again], value[again] = found.row, found.value
            alive[again] = (found.views() >= fewest) & (found.value > settings.least_value)
    return fits
