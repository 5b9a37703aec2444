"""What the views of a landmark say together: whether it is a sign, of which colour and shape.

It is a sign by the sum of log-likelihood ratios (report chapter 9, for a whole track).

The terms of evidence are appearance, views, size, place, rigidity and surroundings. Each is a sum of monotone curves
over a few numbers on all views of a landmark together. What its images show counts over the whole range that was
learned from; the other terms count by what they were worth on real drives.
"""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import exp, log, nan, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.models import EvidenceModel
from wayside.stages.classifiers import evidence_ratios
from wayside.stages.geometry import FrenetOffset
from wayside.stages.kernels import Array
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame

FEATURES = (
    "score_best",
    "log_views",
    "missed",
    "log_side",
    "oversize",
    "log_place",
    "size_scatter",
    "depth_sigma",
    "surroundings",
)
"""Names in the order of the values. score_best: mean of the three highest scores of its views; missed: share of the
frames that should show it in which it has no candidate; log_side: of the mean side, metres; oversize: logarithm of the
longer side, metres, 0 below one and on a board of a colour that guide signs have; log_place: see `SignPlaces`;
size_scatter, depth_sigma: relative; surroundings: see `surroundings_correlation`."""
PLACE, SURROUNDINGS = FEATURES.index("log_place"), FEATURES.index("surroundings")
BEST = 3
CLEAR_PX = 60.0
"""A view of this height shows a face in full (set on the development drives)."""
CUT_WEIGHT = 0.2
"""Weight of a view cut by the edge of the image (set on the development drives)."""
LEAST_LOG_PROBABILITY = -5.0
"""Least log probability that a view gives a class: each view may be of a wrong box."""
GUIDE_COLORS = {"green", "blue", "brown", "white", "black"}
"""Colours of rectangles that direct traffic: they are as large as their words need."""
ASIDE_M, ASIDE_WIDTH_M = 9.0, 8.0
"""Middle and half width at half height of the distance from the path: carriageways of one to six lanes."""
ABOVE_M, ABOVE_SIGMA_M = 2.0, 2.5
"""Mean and deviation of the height above the camera: from plates at its height to boards over the road."""
LEAST_DENSITY = 1e-5
"""Per square metre: nowhere is impossible."""
LIKE_RIGHT_M, LIKE_RIGHT_SHARE, LIKE_ABOVE_M = 3.0, 0.1, 1.5
"""How far signs of one road scatter about each other, deviations: sideways at least and as a share of the distance
from the path (the error of the motion grows with it), and in height."""
PRIOR_SIGNS = 5.0
"""So many signs weigh as much as what was expected before the first."""
SURE = 5.5
"""Box score (log odds) at which a landmark counts as half a sign: of 70 above it on nine real drives 63 were signs."""
SAME_M = 1.5
"""Places nearer to each other are one support: it tells nothing of itself."""


@dataclass(slots=True)
class SignPlaces:
    """Where the signs of a drive stand: along the carriageway, whatever its width, and over it.

    How far from the path depends on the road and on the lane: 3 m on a village street, 20 m on the left lane of a
    freeway. The expectation before the first sign is broad and the same on both sides. Each sign that its own images
    show sharpens it for later ones on the same drive.
    """

    known: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))
    """Places so far: right, above, station, metres, and weight, (n, 4)."""

    def add(self, offset: FrenetOffset, score: float) -> None:
        """Count a landmark by its box score, not by all evidence: its own place must not confirm itself."""
        weight = 1 / (1 + exp(SURE - score))
        row = offset.right, offset.above, offset.station, weight
        self.known = np.vstack([self.known, row])

    def log_density(self, offset: FrenetOffset) -> float:
        """Logarithm of the density of signs, per square metre across the path, at an offset from it."""
        right, above = offset.right, offset.above
        aside = 1 / (1 + ((abs(right) - ASIDE_M) / ASIDE_WIDTH_M) ** 2) / (2 * pi * ASIDE_WIDTH_M)
        prior = max(aside * float(_normal(above - ABOVE_M, ABOVE_SIGMA_M)), LEAST_DENSITY)
        sigma = max(LIKE_RIGHT_M, LIKE_RIGHT_SHARE * abs(right))
        gap, above_of, station, weight = (self.known - (right, 0.0, offset.station, 0.0)).T
        weight = weight * (np.maximum(np.abs(station), np.abs(gap)) > SAME_M)
        near = _normal(gap, sigma) * _normal(above_of - above, LIKE_ABOVE_M)
        total = PRIOR_SIGNS * prior + weight @ near
        return log(total / (PRIOR_SIGNS + weight.sum()))


def _normal(gap: Array | float, sigma: float) -> Array:
    return np.asarray(np.exp(-0.5 * (gap / sigma) ** 2) / (sigma * sqrt(2 * pi)))


@dataclass(frozen=True, slots=True)
class LandmarkEvidence:
    """What speaks for and against a landmark."""

    features: NDArray[np.float64]
    """Numbers named by `FEATURES`, (f,)."""
    ratios: tuple[tuple[str, float], ...]
    """Log-likelihood ratio of each term. Empty: there is no model."""
    log_odds: float
    """Sum of the ratios with the prior. Without a model the value of the fit, which only ranks landmarks."""

    @property
    def score(self) -> float:
        """Log odds of a sign: without a model those of its best views, however many views of one object agree."""
        return self.log_odds if self.ratios else self.best_score

    @property
    def best_score(self) -> float:
        """Mean log odds of its best views."""
        return float(self.features[FEATURES.index("score_best")])

    @property
    def weakest(self) -> str:
        """The term that weighs most against a sign."""
        return min(self.ratios, key=lambda ratio: ratio[1])[0]


@dataclass(frozen=True, slots=True)
class LandmarkClassifier:
    """Classifies landmarks of one side by a model of their evidence."""

    model: EvidenceModel | None = None
    """None: nothing is known of signs, and what stands is one."""

    def classify(self, features: NDArray[np.float64], value: float) -> LandmarkEvidence:
        """The evidence for a landmark by its features (9,), see `FEATURES`, and the value of its fit."""
        if self.model is None:
            return LandmarkEvidence(features, (), max(value, 0.0))
        named = dict(zip(FEATURES, features.tolist(), strict=True))
        ratios = tuple(evidence_ratios(self.model, named).items())
        log_odds = self.model.shift + sum(ratio for _, ratio in ratios)
        return LandmarkEvidence(features, ratios, log_odds)

    def accepts(self, evidence: LandmarkEvidence) -> bool:
        """Whether the log odds reach the model's threshold."""
        return evidence.log_odds >= (0.0 if self.model is None else self.model.threshold)


def view_features(fit: LandmarkFit, window: Sequence[WindowFrame]) -> NDArray[np.float64]:
    """Numbers (9,) on a landmark, named by `FEATURES`; nan for its place and its surroundings."""
    seen = fit.seen
    nearest = int(np.argmin(fit.depth))
    ray = window[fit.frames[nearest]].motion.pose.rotation[:, 2]
    means = [mean_log_probabilities(seen, what) for what in ("color", "shape")]
    color, shape = (
        None if mean is None else names[int(mean.argmax())]
        for mean, names in zip(means, (COLORS, SHAPES), strict=True)
    )
    guides = shape == "rectangle" and (color is None or color in GUIDE_COLORS)
    log_sides = np.log(fit.metric)
    return np.array(
        [
            np.sort(seen["score"])[-BEST:].mean(),
            np.log(len(fit.rows)),
            fit.missed / (fit.missed + len(fit.rows)),
            log_sides.mean(),
            0.0 if guides else max(log_sides.max(), 0.0),
            nan,
            (fit.spread / fit.metric).max(),
            np.sqrt(ray @ fit.covariance @ ray) / fit.depth[nearest],
            nan,
        ]
    )


class VotedClass(NamedTuple):
    """The class of most weight (None: no view has one), its distance, and the log probability of each by a network."""

    name: str | None
    distance: float = nan
    log_probability: Sequence[float] = ()


def voted_class(
    fit: LandmarkFit, window: Sequence[WindowFrame], what: str, names: tuple[str, ...]
) -> VotedClass:
    """The class (`what`: color or shape) of most weight, by number in `names`.

    Where a network classified the views, the weight is the mean log probability, and there is no distance. Else the
    nearest classes of the views vote, each with the area of its box (report chapters 3.2 and 4).
    """
    means = mean_log_probabilities(fit.seen, what)
    if means is not None:
        return VotedClass(names[int(means.argmax())], nan, array("d", means))
    weights, distances = [0.0] * len(names), [nan] * len(names)
    rows, areas = fit.seen["candidate"].tolist(), fit.seen["size"].prod(axis=1).tolist()
    for frame, row, area in zip(fit.frames.tolist(), rows, areas, strict=True):
        table = window[frame].candidates
        kind = getattr(table, what).item(row) if row < len(table) else NONE  # predicted ones follow
        if kind != NONE:
            weights[kind] += area
            distances[kind] = np.fmin(distances[kind], getattr(table, f"{what}_distance")[row])
    best = weights.index(max(weights))
    return VotedClass(names[best], float(distances[best])) if weights[best] else VotedClass(None)


def mean_log_probabilities(seen: NDArray[np.void], what: str) -> NDArray[np.float64] | None:
    """Mean over the views `seen` (v,) of the log probability of each class; None where none is classified.

    A view weighs as it is tall, up to `CLEAR_PX`, less where it is cut; none may rule a class out.
    """
    seen = seen[~np.isnan(seen[what]).any(axis=1)]
    if not len(seen):
        return None
    weight = np.minimum(seen["tall_px"], CLEAR_PX) * np.where(seen["whole"], 1.0, CUT_WEIGHT)
    odds = np.maximum(seen[what], LEAST_LOG_PROBABILITY)
    return np.asarray((weight[:, None] * odds).sum(axis=0) / sum(weight))
