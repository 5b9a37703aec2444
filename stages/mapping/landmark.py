"""A landmark as it is reported: position, size and facing with their scatter, colour and shape."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.landmarks import Landmark, Views
from wayside.stages.geometry import FrenetOffset, cross_matrices
from wayside.stages.mapping.landmark_evidence import VotedClass, voted_class
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.local_adjustment import LandmarkMeasurement, adjust_jointly
from wayside.stages.mapping.panel import Panel
from wayside.stages.mapping.window import WindowFrame, WindowPoses

BORDER = 1.06
"""Panel by box: boxes follow the inner field (measured on the development drives)."""
SIZE_SIGMA = 0.05
"""Scatter of that factor (measured on the development drives)."""
CENTRE_BIAS = 0.02
"""Error that the centres of all boxes share, by the size (measured on the development drives)."""
STEP_COVARIANCE = np.diag(np.square([2e-4, 2e-4, 2e-4, 0.01, 0.005, 0.025]))
"""Covariance (6, 6) of a step of unknown scatter: turn, rad; right, down, ahead, m (set on the development drives)."""


def measure_landmark(
    fit: LandmarkFit,
    window: Sequence[WindowFrame],
    panel: Panel | None = None,
    jointly: bool = False,
) -> LandmarkMeasurement:
    """The landmark by its panel, or else its boxes, relative to the camera that shows it largest and whole.

    `panel`: None: the one that the boxes show. `jointly`: whether it is adjusted with the motion of the frames around
    it, where that has a prior.
    """
    best = int(fit.frames[best_view(fit.seen)])
    panel = panel or box_panel(fit)
    joint = adjust_jointly(window, best, panel) if jointly else None
    if joint is not None:
        return joint
    known = (f.motion.covariance for f in window)
    steps = [STEP_COVARIANCE if one is None else one for one in known]
    _, rotations, centres = WindowPoses.of(window)
    views = panel.point, panel.frames, panel.weight_sigma, panel.ray_sigma
    covariance = point_covariance(rotations, centres, *views, np.stack(steps), best)
    return LandmarkMeasurement(panel.point, covariance, panel)


def point_covariance(
    rotations: NDArray[np.float64],
    centres: NDArray[np.float64],
    point: NDArray[np.float64],
    views: NDArray[np.int64],
    weight_sigma: NDArray[np.float64],
    ray_sigma: NDArray[np.float64],
    steps: NDArray[np.float64],
    best: int,
) -> NDArray[np.float64]:
    """Covariance (3, 3) of a point relative to the camera of frame `best`, in world axes, square metres.

    First-order propagation (report chapter 8's projection, eq. 7.6). The estimate moves by the gain (J' W J)^-1 J' W
    times the error of the rays. An error of the step between two frames moves all views on the far side of it, seen
    from `best`, together.

    `rotations` (n, 3, 3), `centres` (n, 3), `point` (3,): in the world; cameras of consecutive frames. `views` (v,):
    frames of the fit. `weight_sigma`, `ray_sigma` (v,): scatter by which they were weighted, and of the rays alone.
    `steps` (n, 6, 6): covariance of the step from the frame before, in the frame of that camera. A step is a rotation
    vector, rad, then a translation, m; row 0 is not used. `best`: the frame in which the point is reported.
    """
    local = np.einsum("ni,nij->nj", point - centres[views], rotations[views])
    depth = local[:, 2]
    project = np.zeros((len(views), 2, 3))
    project[:, 0, 0] = project[:, 1, 1] = 1 / depth
    project[:, :, 2] = -local[:, :2] / depth[:, None] ** 2
    jacobian = project @ rotations[views].transpose(0, 2, 1)
    weight = 1 / weight_sigma**2
    information = np.einsum("v,vki,vkj->ij", weight, jacobian, jacobian)
    gain = np.linalg.inv(information) @ (weight[:, None, None] * jacobian.transpose(0, 2, 1))
    covariance: NDArray[np.float64] = np.einsum("v,vik,vjk->ij", ray_sigma**2, gain, gain)
    # each step between the views and `best`, all at once
    step = np.arange(min(int(views.min()), best) + 1, max(int(views.max()), best) + 1)
    beyond = np.where(step[:, None] <= best, views < step[:, None], views >= step[:, None])
    before = rotations[step - 1]
    lever_arm = ((point - centres[step])[:, None] @ before)[:, 0]
    by_step = before @ np.concatenate([-cross_matrices(lever_arm), 0 * before + np.eye(3)], axis=2)
    effect = np.tensordot(beyond, gain @ jacobian, 1) @ by_step
    covariance += (effect @ steps[step] @ effect.transpose(0, 2, 1)).sum(axis=0)
    return (covariance + covariance.T) / 2


def box_panel(fit: LandmarkFit) -> Panel:
    """The panel that the boxes of a landmark show: they follow its inner field, and nothing shows its facing."""
    used = fit.used
    return Panel(
        fit.point,
        fit.frames[used],
        np.ascontiguousarray(fit.seen["ray"][used]),
        fit.weight_sigma[used],
        fit.ray_sigma[used],
        centre_sigma=CENTRE_BIAS * fit.metric,
        size=BORDER * fit.metric,
        sigma_size=np.hypot(fit.spread, SIZE_SIGMA * fit.metric),
        facing_deg=np.nan,
        sigma_facing_deg=np.nan,
        shape="",
        residual_px=fit.rms_px,
    )


def build_landmark(
    fit: LandmarkFit,
    window: Sequence[WindowFrame],
    measured: LandmarkMeasurement,
    offset: FrenetOffset,
    **more: Any,
) -> Landmark:
    """The landmark in the camera frame of the image that shows it largest and whole; more: its other columns.

    A back has no colour of a sign. Its shape is the shape of the outline of its panel, where this is known.
    """
    seen, panel = fit.seen, measured.panel
    number, ideal, box = (seen[name].T for name in ("image", "ideal", "box"))
    best, views = best_view(seen), Views(number, seen["candidate"], *ideal, *box, fit.residual_px)
    frame = window[fit.frames[best]]
    pose = frame.motion.pose
    if fit.back:
        # an outline tells which way a triangle points
        color, shape = VotedClass(None), VotedClass(panel.shape.removesuffix("_up") or None)
    else:
        color = voted_class(fit, window, "color", COLORS)
        shape = voted_class(fit, window, "shape", SHAPES)
    return Landmark(
        back=fit.back,
        views=views,
        position=pose.to_camera(measured.point),
        covariance=pose.rotation.T @ measured.covariance @ pose.rotation
        + np.diag([*panel.centre_sigma**2, 0.0]),
        right_m=offset.right,
        above_m=offset.above,
        station_m=offset.station,
        best_frame=frame.frame.index,
        best_time_ns=frame.frame.time_ns,
        best_box=views[best].box,
        best_pose=pose,
        width_m=float(panel.size[0]),
        height_m=float(panel.size[1]),
        sigma_width_m=float(panel.sigma_size[0]),
        sigma_height_m=float(panel.sigma_size[1]),
        facing_deg=panel.facing_deg,
        sigma_facing_deg=panel.sigma_facing_deg,
        color=color.name,
        color_distance=color.distance,
        shape=shape.name,
        shape_distance=shape.distance,
        residual_px=fit.rms_px,
        color_log_probability=color.log_probability,
        shape_log_probability=shape.log_probability,
        **more,
    )


def best_view(seen: NDArray[np.void]) -> int:
    """Of some views the one with the largest box that is whole; where all are cut, the largest."""
    return int(np.lexsort((-seen["size"].prod(axis=1), ~seen["whole"]))[0])
