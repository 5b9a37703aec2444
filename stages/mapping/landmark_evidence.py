"""Whether a landmark is a sign: the sum of log-likelihood ratios (report chapter 9, for a whole track).

Each term of evidence (appearance, views, size, place, rigidity, registration, surroundings) is a bounded sum over a few
numbers on all views of a landmark together. A term that has never seen such a road can therefore not outvote all the
others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import nan

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.models import EvidenceModel, GaussianModel
from wayside.schemas.settings import LandmarkSettings
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.class_votes import mean_log_probabilities
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.panel import Panel
from wayside.stages.mapping.window import WindowFrame

FEATURES = (
    "score_best",
    "score_mean",
    "log_views",
    "missed",
    "log_width",
    "log_height",
    "color_certainty",
    "shape_certainty",
    "place_sigmas",
    "size_scatter",
    "depth_sigma",
    "agreement",
    "surroundings",
)
"""Names in the order of the values. score_best: mean of the three highest scores of its views; missed: share of the
frames that should show it in which it has no candidate; color_certainty, shape_certainty: mean log probability of the
class that the views together give; place_sigmas: Mahalanobis distance from the nearest class of locations;
size_scatter, depth_sigma: relative; agreement: see `registration_agreement`; surroundings: see
`surroundings_correlation`."""
BEST = 3
FREE_PX, EXACT_PX = 3.0, 0.1
"""Residuals of registered images that show different things, and below which no residual is better than another. With
`BEST` part of what the features mean: the models hold for these."""


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
    """Classifies landmarks of one side by a model of their evidence.

    model None: nothing is known of signs, and what stands is one: any two rays meet somewhere, so it takes a third box
    or images in register. location: where signs stand (right, above; metres), None: anywhere; settings: weights of
    views in the votes for colour and shape.
    """

    model: EvidenceModel | None = None
    location: GaussianModel | None = None
    settings: LandmarkSettings = field(default_factory=LandmarkSettings)

    def classify(
        self,
        fit: LandmarkFit,
        window: Sequence[WindowFrame],
        offset: FrenetOffset,
        agreement: float = nan,
        surroundings: float = nan,
    ) -> LandmarkEvidence:
        """The evidence for a landmark in its window at an offset from the path.

        agreement: of its registered images; surroundings: correlation round it; nan: not measured yet.
        """
        features = landmark_features(
            fit, window, offset, self.location, agreement, surroundings, self.settings
        )
        if self.model is None:
            confirmed = fit.used.sum() > 2 or not agreement <= 0
            log_odds = max(fit.value, 0.0) if confirmed else -1.0
            return LandmarkEvidence(features, (("rigidity", log_odds),), log_odds)
        named = dict(zip(FEATURES, features.tolist(), strict=True))
        ratios = tuple(self.model.ratios(named).items())
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
    location: GaussianModel | None,
    agreement: float,
    surroundings: float,
    settings: LandmarkSettings,
) -> NDArray[np.float64]:
    """Numbers (13,) on a landmark, named by `FEATURES`."""
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
            fit.missed / (fit.missed + len(fit.rows)),
            width,
            height,
            _certainty(fit, window, "color", settings),
            _certainty(fit, window, "shape", settings),
            nan if location is None else location.distances(place).min(),
            (fit.spread / fit.metric).max(),
            np.sqrt(ray @ fit.covariance @ ray) / fit.depth[nearest],
            agreement,
            surroundings,
        ]
    )


def _certainty(
    fit: LandmarkFit, window: Sequence[WindowFrame], what: str, settings: LandmarkSettings
) -> float:
    """Mean log probability of the likeliest colour or shape; 0 where no network classified the views."""
    own = ((window[f], row) for f, row in zip(fit.frames, fit.rows, strict=True))
    means = mean_log_probabilities(own, what, settings)
    return 0.0 if means is None else float(means.max())


def registration_agreement(registered: int, panel: Panel | None) -> float:
    """How much likelier the registered images of a landmark are under one standing panel than at random.

    n images give 2 n coordinates of its centre, of which three are the point itself: two images of anything nearly
    always meet. Each of the others counts the logarithm of the residual expected at random over that found.
    """
    if panel is None or registered < 2:
        return 0.0
    spare = 2 * registered - 3
    return spare * float(np.log(FREE_PX / np.clip(panel.residual_px, EXACT_PX, FREE_PX)))


def score_by_views(frames: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Give each landmark the mean log odds of its three best views, where no landmark classifier knows the detector.

    How many views agree is no part of it: views of one object are alike, and a detector that takes a board for a sign
    does so in all of them.
    """
    best = FEATURES.index("score_best")
    for frame in frames:
        scored = tuple(replace(one, score=one.features[best]) for one in frame.landmarks)
        yield replace(frame, landmarks=scored)
