"""What the landmark classifier sees: numbers on all views of a landmark together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import TreeModel
from wayside.stages.classifiers import log_odds
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame

FEATURES = (
    "views",
    "share_seen",
    "empty",
    "score_mean",
    "score_max",
    "score_second",
    "score_nearest",
    "score_near_mean",
    "score_least",
    "residual_px",
    "residual_share",
    "size_scatter",
    "width_m",
    "height_m",
    "aspect",
    "nearest_m",
    "tallest_px",
    "right_m",
    "above_m",
    "sigma_ahead_share",
    "rivals",
)
"""Names in the order of the values; `place.json` holds them. `empty`: frames where a view is missed; `rivals`: other
candidates on the face, by view."""


def landmark_features(
    fit: LandmarkFit, window: Sequence[WindowFrame], offset: FrenetOffset, right_limit_m: float
) -> NDArray[np.float64]:
    """Numbers (21,) on a landmark, named by `FEATURES`; the distance aside is clipped to `right_limit_m`."""
    count = len(fit.rows)
    views = [(window[f], row) for f, row in zip(fit.frames, fit.rows, strict=True)]
    scores = np.array([frame.score[row] for frame, row in views])
    ordered = np.sort(scores)[::-1]
    near = np.argsort(fit.depth, kind="stable")
    tall_px = fit.metric[1] / fit.depth * np.array([frame.focal for frame, _ in views])
    nearest = int(near[0])
    ray = views[nearest][0].motion.pose.rotation[:, 2]
    return np.array(
        [
            count,
            count / (count + fit.missed),
            fit.missed,
            scores.mean(),
            ordered[0],
            ordered[min(1, count - 1)],
            scores[nearest],
            scores[near[:3]].mean(),
            ordered[-1],
            fit.rms_px,
            fit.rms_px / tall_px[near[:4]].mean(),
            float((fit.spread / fit.metric).max()),
            fit.metric[0],
            fit.metric[1],
            fit.metric[0] / fit.metric[1],
            fit.depth[nearest],
            tall_px.max(),
            np.clip(offset.right, -right_limit_m, right_limit_m),
            offset.above,
            np.sqrt(ray @ fit.covariance @ ray) / fit.depth[nearest],
            len(fit.covered) / count,
        ]
    )


def classify_landmark(features: NDArray[np.float64], model: TreeModel | None) -> tuple[float, bool]:
    """Log odds that a landmark is a sign, and whether it is accepted; without a model every landmark is."""
    if model is None:
        return float(features[FEATURES.index("views")] - 1), True
    score = float(log_odds(model, features[None].astype(np.float32))[0])
    return score, score >= model.threshold
