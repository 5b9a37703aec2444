"""Colour and shape of a landmark by the votes of its views."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame

CLEAR_PX = 60.0
"""A view of this height shows a face in full (set on the development drives)."""
CUT_WEIGHT = 0.2
"""Weight of a view cut by the edge of the image (set on the development drives)."""
LEAST_LOG_PROBABILITY = -5.0
"""Least log probability that a view gives a class: each view may be of a wrong box."""


class VotedClass(NamedTuple):
    """The class of most weight (None: no view has one), its distance, and the log probability of each by a network."""

    name: str | None
    distance: float
    log_probability: tuple[float, ...] = ()


def voted_class(
    fit: LandmarkFit, window: Sequence[WindowFrame], what: str, names: tuple[str, ...]
) -> VotedClass:
    """The class of most weight.

    Where a network classified the views (`color_log_probability`, `shape_log_probability`), the weight is the mean log
    probability, and there is no distance. Else the nearest classes of the views vote, each with the area of its box
    (report chapters 3.2 and 4).

    Parameters
    ----------
    fit, window
        The landmark and its frames.
    what
        `color` or `shape`.
    names
        Names of the classes, by number.
    """
    own = [(window[f], row) for f, row in zip(fit.frames, fit.rows, strict=True)]
    means = mean_log_probabilities(own, what)
    if means is not None:
        return VotedClass(names[int(means.argmax())], float("nan"), tuple(means.tolist()))
    weights: dict[int, float] = {}
    distances: dict[int, float] = {}
    for frame, row in own:
        candidate = frame.followed[row]
        kind = int(getattr(frame.candidates, what)[candidate])
        if kind >= 0:
            distance = float(getattr(frame.candidates, f"{what}_distance")[candidate])
            weights[kind] = weights.get(kind, 0.0) + float(frame.size[row].prod())
            distances[kind] = float(np.fmin(distances.get(kind, np.nan), distance))
    if not weights:
        return VotedClass(None, float("nan"))
    kind = max(sorted(weights), key=lambda k: weights[k])
    return VotedClass(names[kind], distances[kind])


def mean_log_probabilities(
    views: Iterable[tuple[WindowFrame, int]], what: str
) -> NDArray[np.float64] | None:
    """Mean over the classified views of the log probability of each class; None where no view is classified.

    A view weighs as it is tall, up to `CLEAR_PX`, less where it is cut; none may rule a class out.
    """
    total, weights = 0.0, 0.0
    for frame, row in views:
        odds = getattr(frame.candidates, f"{what}_log_probability")
        own = frame.followed[row]
        if odds is None or np.isnan(odds[own]).any():
            continue
        tall_px = float(frame.size[row, 1] * frame.focal)
        weight = min(tall_px, CLEAR_PX) * (1.0 if frame.whole[row] else CUT_WEIGHT)
        total = total + weight * np.maximum(odds[own].astype(np.float64), LEAST_LOG_PROBABILITY)
        weights += weight
    return np.asarray(total / weights) if weights else None
