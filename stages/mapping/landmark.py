"""A fitted place as it is reported: where, how large, what colour and shape, and how sure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.landmarks import Landmark, Observation
from wayside.schemas.models import TreeModel
from wayside.schemas.settings import LocalAdjustmentSettings
from wayside.stages.classifiers import log_odds
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.covariance import STEP_SIGMA, point_covariance
from wayside.stages.mapping.hypotheses import Fit
from wayside.stages.mapping.local_adjustment import LandmarkRays, adjust_jointly
from wayside.stages.mapping.panel import Panel, box_rays
from wayside.stages.mapping.window import Held, frames_of, local_rows

FACING_SIGMA_DEG = 20.0
"""Scatter of the facing of panels along a road: what is known while it is not measured."""

BORDER, SIZE_SIGMA = 1.06, 0.05
"""Boxes follow a face's inner field: the panel is larger by this factor, give or take (measured)."""
BIAS_SHARE = 0.02
"""Part of a panel's size by which the centres of all its boxes may be off together (measured)."""

CLEAR_PX = 60.0
"""Height from which a view of a face shows all there is to name it by."""
CUT_WEIGHT = 0.2
"""What a view cut by the edge of the picture counts for."""
DOUBT = -5.0
"""Logarithm of the least chance a view may give a class: each may be of a wrong box."""

ASIDE_M = 10.0
"""Metres aside from which the judge of a place sees no difference: the location model knows how far signs stand."""

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
"""What the judge of a place looks at, in this order."""


def place_features(
    fit: Fit, held: Sequence[Held], scores: NDArray[np.float64], beside: FrenetOffset
) -> NDArray[np.float64]:
    """Numbers (21,) about a place, named by `FEATURES`; scores (v,) are the log odds of its views."""
    count = len(fit.rows)
    ordered = np.sort(scores)[::-1]
    near = np.argsort(fit.depth, kind="stable")
    tall_px = fit.metric[1] / fit.depth * np.array([held[f].focal for f in fit.frames])
    nearest = int(near[0])
    ray = held[fit.frames[nearest]].motion.pose.rotation[:, 2]
    return np.array(
        [
            count,
            count / (count + fit.empty),
            fit.empty,
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
            np.clip(beside.right, -ASIDE_M, ASIDE_M),
            beside.above,
            np.sqrt(ray @ fit.covariance @ ray) / fit.depth[nearest],
            len(fit.covered) / count,
        ]
    )


def judge_place(features: NDArray[np.float64], model: TreeModel | None) -> tuple[float, bool]:
    """Log odds that a place is a sign, and whether it passes; without a model every place that fits passes."""
    if model is None:
        return float(features[FEATURES.index("views")] - 1), True
    score = float(log_odds(model, features[None].astype(np.float32))[0])
    return score, score >= model.threshold


def build_place(
    fit: Fit,
    held: Sequence[Held],
    found: Measured,
    beside: FrenetOffset,
    *,
    track_id: int,
    score: float,
    verdict: str,
    evidence: NDArray[np.float64] | None = None,
    outline: str | None = None,
) -> Landmark:
    """The place as it was measured, in the frame where it is largest and whole.

    A back bears no colour of a sign, and its shape is that of the `outline` of its panel, where one is known.
    """
    best = best_view(fit, held)
    home = held[fit.frames[best]]
    pose = home.motion.pose
    if fit.back:
        color, color_distance = None, float("nan")
        # an outline tells which way a triangle points
        shape, shape_distance = outline and outline.removesuffix("_up"), float("nan")
    else:
        color, color_distance = winner(*votes(fit, held, "color"), COLORS)
        shape, shape_distance = winner(*votes(fit, held, "shape"), SHAPES)
    return Landmark(
        back=fit.back,
        track_id=track_id,
        views=tuple(view_of(fit, held, i) for i in range(len(fit.rows))),
        position=pose.to_camera(found.point),
        covariance=pose.rotation.T @ found.covariance @ pose.rotation
        + np.diag([*found.centre_sigma**2, 0.0]),
        offset=np.array([beside.right, beside.above, beside.station - home.motion.station_m]),
        station_m=beside.station,
        best_frame=home.frame.index,
        best_time_ns=home.frame.time_ns,
        best_box=view_of(fit, held, best).box,
        best_pose=pose,
        width_m=float(found.size[0]),
        height_m=float(found.size[1]),
        sigma_width_m=float(found.sigma_size[0]),
        sigma_height_m=float(found.sigma_size[1]),
        facing_deg=found.facing_deg,
        sigma_facing_deg=found.sigma_facing_deg,
        color=color,
        color_distance=color_distance,
        shape=shape,
        shape_distance=shape_distance,
        score=score,
        residual_px=fit.rms_px,
        verdict=verdict,
        evidence=() if evidence is None else tuple(evidence.tolist()),
    )


class Measured(NamedTuple):
    """A place with all its scatter, metres and degrees.

    point (3,) and covariance (3, 3): world axes; centre_sigma (2,): what all views of the centre have wrong alike,
    right and down; size, sigma_size (2,): width and height.
    """

    point: NDArray[np.float64]
    covariance: NDArray[np.float64]
    centre_sigma: NDArray[np.float64]
    size: NDArray[np.float64]
    sigma_size: NDArray[np.float64]
    facing_deg: float
    sigma_facing_deg: float


def measured_place(
    fit: Fit,
    held: Sequence[Held],
    panel: Panel | None = None,
    adjustment: LocalAdjustmentSettings | None = None,
) -> Measured:
    """The place by its panel, or else its boxes, relative to the camera that shows it largest and whole.

    adjustment: how it is adjusted with the motion of the frames around it, where that has a prior; None: it is not.
    """
    frame = int(fit.frames[best_view(fit, held)])
    if panel is None:
        used = fit.used
        sighted = LandmarkRays(fit.frames[used], box_rays(fit, held), fit.ray_sigma[used])
        weight_sigma, point = fit.weight_sigma[used], fit.point
    else:
        sighted = LandmarkRays(panel.frames, panel.rays, panel.ray_sigma)
        weight_sigma, point = panel.weight_sigma, panel.point
    joint = None
    if adjustment is not None:
        joint = adjust_jointly(held, frame, sighted, point, adjustment)
    if joint is None:
        covariance = covariance_at(point, sighted.frames, weight_sigma, sighted.sigma, held, frame)
    else:
        point, covariance = joint.point, joint.covariance
    if panel is None:
        return Measured(
            point,
            covariance,
            BIAS_SHARE * fit.metric,
            BORDER * fit.metric,
            np.hypot(fit.spread, SIZE_SIGMA * fit.metric),
            0.0,
            FACING_SIGMA_DEG,
        )
    return Measured(
        point,
        covariance,
        panel.centre_sigma,
        panel.size,
        panel.sigma_size,
        panel.facing_deg,
        panel.sigma_facing_deg,
    )


def best_view(fit: Fit, held: Sequence[Held]) -> int:
    """The view with the largest box that is whole; where all are cut, the largest."""
    rank = [
        (bool(held[f].whole[r]), float(held[f].size[r].prod()))
        for f, r in zip(fit.frames, local_rows(fit.rows, fit.frames, held), strict=True)
    ]
    return max(range(len(rank)), key=lambda i: rank[i])


def covariance_at(
    point: NDArray[np.float64],
    frames: NDArray[np.int64],
    weight_sigma: NDArray[np.float64],
    ray_sigma: NDArray[np.float64],
    held: Sequence[Held],
    best: int,
) -> NDArray[np.float64]:
    """Covariance (3, 3) of a point relative to the camera of frame `best`, world axes: rays and motion."""
    default = np.diag(STEP_SIGMA**2)
    steps = [default if h.motion.covariance is None else h.motion.covariance for h in held]
    return point_covariance(
        np.stack([h.motion.pose.rotation for h in held]),
        np.stack([h.motion.pose.centre for h in held]),
        point,
        frames,
        weight_sigma,
        ray_sigma,
        np.stack(steps),
        best,
    )


def view_of(fit: Fit, held: Sequence[Held], i: int) -> Observation:
    """View number i of a fit."""
    home = held[fit.frames[i]]
    row = int(home.open[local_rows(fit.rows, fit.frames, held)[i]])
    u, v = home.candidates.ideal[row]
    x0, y0, x1, y1 = (float(c) for c in home.candidates.regions.box[row])
    return Observation(
        home.frame.index, row, float(u), float(v), (x0, y0, x1, y1), float(fit.residual_px[i])
    )


def votes(fit: Fit, held: Sequence[Held], what: str) -> tuple[dict[int, float], dict[int, float]]:
    """Weight of each class over the views, and the least distance to it; large and sure views weigh more.

    Where a network named the views (`color_log_probability`, `shape_log_probability`), the weight
    is the mean logarithm of the chances. Else
    it is by the nearest classes of the views; where no view has one, other boxes on the same face speak for it.
    """
    own = list(zip(fit.frames, local_rows(fit.rows, fit.frames, held), strict=True))
    weights, distances = _votes(own, held, what)
    chances = mean_chances(own, held, what)
    if chances is not None:
        return dict(enumerate(chances.tolist())), distances
    if not weights and len(fit.covered):
        frames = frames_of(fit.covered, held)
        others = zip(frames, local_rows(fit.covered, frames, held), strict=True)
        weights, distances = _votes(others, held, what)
    return weights, distances


def mean_chances(
    views: Sequence[tuple[int, int]], held: Sequence[Held], what: str
) -> NDArray[np.float64] | None:
    """Mean over the named views of the logarithm of the chance of each class; None where no view is named.

    A view weighs as it is tall, up to `CLEAR_PX`, less where it is cut; no view may rule a class out (`DOUBT`).
    """
    total, weights = 0.0, 0.0
    for frame, local in views:
        home = held[frame]
        odds = getattr(home.candidates, f"{what}_log_probability")
        if odds is None or np.isnan(odds[home.open[local]]).any():
            continue
        tall_px = float(home.size[local, 1] * home.focal)
        weight = min(tall_px, CLEAR_PX) * (1.0 if home.whole[local] else CUT_WEIGHT)
        total = total + weight * np.maximum(odds[home.open[local]].astype(np.float64), DOUBT)
        weights += weight
    return np.asarray(total / weights) if weights else None


def _votes(
    views: Iterable[tuple[int, int]], held: Sequence[Held], what: str
) -> tuple[dict[int, float], dict[int, float]]:
    weights: dict[int, float] = {}
    distances: dict[int, float] = {}
    for frame, local in views:
        home = held[frame]
        row = home.open[local]
        kind = int(getattr(home.candidates, what)[row])
        distance = float(getattr(home.candidates, f"{what}_distance")[row])
        if kind < 0:
            continue
        sure = 1 / (1 + np.exp(-home.score[local]))
        weights[kind] = weights.get(kind, 0.0) + float(home.size[local].prod() * (0.1 + sure))
        distances[kind] = float(np.fmin(distances.get(kind, np.nan), distance))
    return weights, distances


def winner(
    weights: dict[int, float], distances: dict[int, float], names: tuple[str, ...]
) -> tuple[str | None, float]:
    """The class of most weight with its distance; None where no view has a class."""
    if not weights:
        return None, float("nan")
    kind = max(sorted(weights), key=lambda k: weights[k])
    return names[kind], distances.get(kind, float("nan"))
