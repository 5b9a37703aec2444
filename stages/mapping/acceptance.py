"""Greedy acceptance: hypotheses become landmarks, best first, and each removes its candidates from the rest.

Other boxes on a face make landmarks of their own: which one is the face, all evidence decides (`verdicts.same_face`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.stages.mapping.association import WindowCandidates, associate
from wayside.stages.mapping.hypotheses import Hypotheses
from wayside.stages.mapping.landmark_fit import BOX_SIGMA, LandmarkFit, fit_hypothesis

LEAST_SUM = -1.0
"""Hypotheses with a smaller sum over their views are dropped, log odds (set on the development drives)."""


def accept_greedily(
    candidates: WindowCandidates,
    hypotheses: Hypotheses,
    free: NDArray[np.bool_],
    gap_px: float,
    *,
    fewest: int,
    box_sigma: tuple[float, float] = BOX_SIGMA,
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
    gap_px
        Largest gap of a view, as in `associate`.
    fewest
        Views that a landmark needs.
    box_sigma
        Scatter of the centres of boxes, as `BOX_SIGMA`.
    """
    point, size = hypotheses.point, hypotheses.size
    left = free.copy()
    row, _, value = found = associate(candidates, point, size, left, gap_px)
    alive = (found.views() >= fewest) & (value > LEAST_SUM)
    fits: list[LandmarkFit] = []
    while alive.any():
        best = int(np.argmax(np.where(alive, value, -np.inf)))
        alive[best] = False
        fit = fit_hypothesis(
            candidates, row[best], left, gap_px, fewest=fewest, box_sigma=box_sigma
        )
        if fit is None or fit.value <= LEAST_SUM:
            continue
        fits.append(fit)
        left[candidates.first[fit.frames] + fit.rows] = False
        again = np.flatnonzero(alive & ((row >= 0) & ~left[row]).any(axis=1))
        if len(again):
            found = associate(candidates, point[again], size[again], left, gap_px)
            row[again], value[again] = found.row, found.value
            alive[again] = (found.views() >= fewest) & (found.value > LEAST_SUM)
    return fits
