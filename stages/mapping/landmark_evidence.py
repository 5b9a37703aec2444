"""Whether a landmark is a sign: the sum of log-likelihood ratios (report chapter 9, for a whole track).

Each term of evidence (appearance, views, size, place, rigidity, registration) is a bounded sum over a few numbers on
all views of a landmark together. A term that has never seen such a road can therefore not outvote all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import EvidenceModel, GaussianModel
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame

FEATURES = (
    "score_best",
    "score_mean",
    "log_views",
    "missed",
    "log_width",
    "log_height",
    "elongation",
    "place_sigmas",
    "residual_px",
    "size_scatter",
    "depth_sigma",
    "registered",
)
"""Names in the order of the values. score_best: mean of the three highest scores of its views; missed: frames that
should show it and have no candidate there; elongation: absolute logarithm of the aspect ratio; place_sigmas:
Mahalanobis distance from the nearest class of locations; size_scatter, depth_sigma: relative; registered: images in
register."""
BEST = 3


@dataclass(frozen=True, slots=True)
class LandmarkEvidence:
    """Numbers (f,) on a landmark, named by `FEATURES`, the log-likelihood ratio of each term, and their sum."""

    features: NDArray[np.float64]
    ratios: tuple[tuple[str, float], ...]
    log_odds: float

    @property
    def weakest(self) -> str:
        """The term that weighs most against a sign."""
        return min(self.ratios, key=lambda ratio: ratio[1])[0]


@dataclass(frozen=True, slots=True)
class LandmarkClassifier:
    """Classifies landmarks of one side by a model of their evidence; location: where signs stand (right, above; m).

    model None: nothing is known of signs, each further view is one more in favour; location None: they stand anywhere.
    """

    model: EvidenceModel | None = None
    location: GaussianModel | None = None

    def classify(
        self,
        fit: LandmarkFit,
        window: Sequence[WindowFrame],
        offset: FrenetOffset,
        registered: float = nan,
    ) -> LandmarkEvidence:
        """The evidence for a landmark in its window at an offset from the path.

        registered: number of images in register; nan: the panel is not measured yet.
        """
        features = landmark_features(fit, window, offset, self.location, registered)
        if self.model is None:
            return LandmarkEvidence(features, (), len(fit.rows) - 1.0)
        named = dict(zip(FEATURES, features.tolist(), strict=True))
        ratios = tuple(self.model.ratios(named).items())
        return LandmarkEvidence(
            features, ratios, self.model.shift + sum(ratio for _, ratio in ratios)
        )

    def accepts(self, evidence: LandmarkEvidence) -> bool:
        """Whether the log odds reach the model's threshold."""
        return self.model is None or evidence.log_odds >= self.model.threshold


def landmark_features(
    fit: LandmarkFit,
    window: Sequence[WindowFrame],
    offset: FrenetOffset,
    location: GaussianModel | None,
    registered: float,
) -> NDArray[np.float64]:
    """Numbers (12,) on a landmark, named by `FEATURES`."""
    scores = np.array([window[f].score[row] for f, row in zip(fit.frames, fit.rows, strict=True)])
    nearest = int(np.argmin(fit.depth))
    ray = window[fit.frames[nearest]].motion.pose.rotation[:, 2]
    width, height = np.log(fit.metric)
    place = np.array([[offset.right, offset.above]])
    return np.array(
        [
            np.sort(scores)[-BEST:].mean(),
            scores.mean(),
            np.log(len(fit.rows)),
            fit.missed,
            width,
            height,
            abs(width - height),
            nan if location is None else location.distances(place).min(),
            fit.rms_px,
            (fit.spread / fit.metric).max(),
            np.sqrt(ray @ fit.covariance @ ray) / fit.depth[nearest],
            registered,
        ]
    )
