"""A landmark as it is reported: position, size and facing with their scatter, colour and shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.landmarks import Landmark, Observation
from wayside.schemas.settings import LandmarkSettings
from wayside.stages.geometry import FrenetOffset
from wayside.stages.mapping.class_votes import voted_class
from wayside.stages.mapping.covariance import point_covariance
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.local_adjustment import Sighted, adjust_together
from wayside.stages.mapping.panel import Panel, box_rays
from wayside.stages.mapping.window import WindowFrame


class LandmarkMeasurement(NamedTuple):
    """Position, size and facing of a landmark with their scatter, metres and degrees.

    point (3,) and covariance (3, 3): world axes; centre_sigma (2,): error of the centre that all views share,
    right and down; size, sigma_size (2,): width and height.
    """

    point: NDArray[np.float64]
    covariance: NDArray[np.float64]
    centre_sigma: NDArray[np.float64]
    size: NDArray[np.float64]
    sigma_size: NDArray[np.float64]
    facing_deg: float
    sigma_facing_deg: float


def measure_landmark(
    fit: LandmarkFit,
    window: Sequence[WindowFrame],
    settings: LandmarkSettings,
    panel: Panel | None = None,
    *,
    adjusted: bool = False,
) -> LandmarkMeasurement:
    """The landmark by its panel, or else its boxes, relative to the camera that shows it largest and whole.

    Parameters
    ----------
    fit, window
        The landmark and its frames.
    settings
        Errors of boxes.
    panel
        Its measured panel.
    adjusted
        Adjust it with the motion of the frames around it, where a prior of that is known.
    """
    best = int(fit.frames[best_view(fit, window)])
    if panel is None:
        used = fit.used
        observed = Sighted(fit.frames[used], box_rays(fit, window), fit.ray_sigma[used])
        weight_sigma, point = fit.weight_sigma[used], fit.point
    else:
        observed = Sighted(panel.frames, panel.rays, panel.ray_sigma)
        weight_sigma, point = panel.weight_sigma, panel.point
    joint = adjust_together(window, best, observed, point) if adjusted else None
    if joint is None:
        unknown = np.diag(np.square(settings.step_sigma))
        steps = [unknown if f.motion.covariance is None else f.motion.covariance for f in window]
        covariance = point_covariance(
            np.stack([f.motion.pose.rotation for f in window]),
            np.stack([f.motion.pose.centre for f in window]),
            point,
            observed.frames,
            weight_sigma,
            observed.sigma,
            np.stack(steps),
            best,
        )
    else:
        point, covariance = joint.point, joint.covariance
    if panel is None:
        return LandmarkMeasurement(
            point,
            covariance,
            settings.centre_bias * fit.metric,
            settings.border * fit.metric,
            np.hypot(fit.spread, settings.size_sigma * fit.metric),
            0.0,
            settings.facing_sigma_deg,
        )
    return LandmarkMeasurement(
        point,
        covariance,
        panel.centre_sigma,
        panel.size,
        panel.sigma_size,
        panel.facing_deg,
        panel.sigma_facing_deg,
    )


def build_landmark(
    fit: LandmarkFit,
    window: Sequence[WindowFrame],
    measured: LandmarkMeasurement,
    offset: FrenetOffset,
    settings: LandmarkSettings,
    *,
    track_id: int,
    score: float,
    verdict: str,
    features: tuple[float, ...] = (),
    outline: str | None = None,
) -> Landmark:
    """The landmark in the camera frame of the image that shows it largest and whole.

    A back bears no colour of a sign, and its shape is that of the `outline` of its panel, where one is known.
    """
    best = best_view(fit, window)
    frame = window[fit.frames[best]]
    pose = frame.motion.pose
    color, color_distance = None, float("nan")
    # an outline tells which way a triangle points
    shape, shape_distance = outline and outline.removesuffix("_up"), float("nan")
    if not fit.back:
        color, color_distance = voted_class(fit, window, "color", COLORS, settings)
        shape, shape_distance = voted_class(fit, window, "shape", SHAPES, settings)
    return Landmark(
        back=fit.back,
        track_id=track_id,
        views=tuple(observation(fit, window, i) for i in range(len(fit.rows))),
        position=pose.to_camera(measured.point),
        covariance=pose.rotation.T @ measured.covariance @ pose.rotation
        + np.diag([*measured.centre_sigma**2, 0.0]),
        right_m=offset.right,
        above_m=offset.above,
        station_m=offset.station,
        best_frame=frame.frame.index,
        best_time_ns=frame.frame.time_ns,
        best_box=observation(fit, window, best).box,
        best_pose=pose,
        width_m=float(measured.size[0]),
        height_m=float(measured.size[1]),
        sigma_width_m=float(measured.sigma_size[0]),
        sigma_height_m=float(measured.sigma_size[1]),
        facing_deg=measured.facing_deg,
        sigma_facing_deg=measured.sigma_facing_deg,
        color=color,
        color_distance=color_distance,
        shape=shape,
        shape_distance=shape_distance,
        score=score,
        residual_px=fit.rms_px,
        verdict=verdict,
        features=features,
    )


def best_view(fit: LandmarkFit, window: Sequence[WindowFrame]) -> int:
    """The view with the largest box that is whole; where all are cut, the largest."""
    rank = [
        (bool(window[f].whole[row]), float(window[f].size[row].prod()))
        for f, row in zip(fit.frames, fit.rows, strict=True)
    ]
    return max(range(len(rank)), key=lambda i: rank[i])


def observation(fit: LandmarkFit, window: Sequence[WindowFrame], i: int) -> Observation:
    """View number i of a landmark."""
    frame = window[fit.frames[i]]
    row = int(frame.followed[fit.rows[i]])
    u, v = frame.candidates.ideal[row]
    x0, y0, x1, y1 = (float(c) for c in frame.candidates.regions.box[row])
    return Observation(
        frame.frame.index, row, float(u), float(v), (x0, y0, x1, y1), float(fit.residual_px[i])
    )
