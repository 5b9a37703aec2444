"""Whether a landmark is a sign: the sum of log-likelihood ratios (report chapter 9, for a whole track).

The terms of evidence are appearance, views, size, place, rigidity and surroundings. Each is a sum of monotone curves
over a few numbers on all views of a landmark together. What its images show counts over the whole range that was
learned from; the other terms count by what they were worth on real drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.models import EvidenceModel
from wayside.stages.classifiers import evidence_ratios
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.class_votes import mean_log_probabilities
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.sign_places import SignPlaces
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
BEST = 3
GUIDE_COLORS = {"green", "blue", "brown", "white", "black"}
"""Colours of rectangles that direct traffic: they are as large as their words need."""


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
        best = float(self.features[FEATURES.index("score_best")])
        return self.log_odds if self.ratios else best

    @property
    def weakest(self) -> str:
        """The term that weighs most against a sign."""
        return min(self.ratios, key=lambda ratio: ratio[1])[0]


@dataclass(frozen=True, slots=True)
class LandmarkClassifier:
    """Classifies landmarks of one side by a model of their evidence."""

    model: EvidenceModel | None = None
    """None: nothing is known of signs, and what stands is one."""

    def classify(
        self,
        fit: LandmarkFit,
        window: Sequence[WindowFrame],
        offset: FrenetOffset,
        places: SignPlaces,
        surroundings: float = nan,
    ) -> LandmarkEvidence:
        """The evidence for a landmark in its window at an offset from the path, on a drive with signs in places.

        surroundings: correlation round it; nan: not measured.
        """
        features = landmark_features(fit, window, offset, places, surroundings)
        named = dict(zip(FEATURES, features.tolist(), strict=True))
        if self.model is None:
            return LandmarkEvidence(features, (), max(fit.value, 0.0))
        ratios = tuple(evidence_ratios(self.model, named).items())
        return LandmarkEvidence(
            features, ratios, self.model.shift + sum(ratio for _, ratio in ratios)
        )

    def accepts(self, evidence: LandmarkEvidence) -> bool:
        """Whether the log odds reach the model's threshold."""
        return evidence.log_odds >= (0.0 if self.model is None else self.model.threshold)


def landmark_features(
    fit: LandmarkFit,
    window: Sequence[WindowFrame],
    offset: FrenetOffset,
    places: SignPlaces,
    surroundings: float,
) -> NDArray[np.float64]:
    """Numbers (9,) on a landmark, named by `FEATURES`."""
    scores = np.array([window[f].score[row] for f, row in zip(fit.frames, fit.rows, strict=True)])
    nearest = int(np.argmin(fit.depth))
    ray = window[fit.frames[nearest]].motion.pose.rotation[:, 2]
    color = _likeliest(fit, window, "color", COLORS)
    shape = _likeliest(fit, window, "shape", SHAPES)
    guides = shape == "rectangle" and (color is None or color in GUIDE_COLORS)
    log_sides = np.log(fit.metric)
    return np.array(
        [
            np.sort(scores)[-BEST:].mean(),
            np.log(len(fit.rows)),
            fit.missed / (fit.missed + len(fit.rows)),
            log_sides.mean(),
            0.0 if guides else max(log_sides.max(), 0.0),
            places.log_density(offset),
            (fit.spread / fit.metric).max(),
            np.sqrt(ray @ fit.covariance @ ray) / fit.depth[nearest],
            surroundings,
        ]
    )


def _likeliest(
    fit: LandmarkFit, window: Sequence[WindowFrame], what: str, names: Sequence[str]
) -> str | None:
    """The likeliest colour or shape; None where no network classified a view."""
    own = ((window[f], row) for f, row in zip(fit.frames, fit.rows, strict=True))
    means = mean_log_probabilities(own, what)
    return None if means is None else names[int(means.argmax())]
