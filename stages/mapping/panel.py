"""The panel of a place as a plane, from the pictures of all its views together.

The views are drawn on one plane across the path and brought into register to a few hundredths of a pixel; in register
they show the outer outline of the face; where it lies in each view is the place again, seven times as exact as boxes;
and how its width and height change from view to view tells the size and the facing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import FrenetOffset
from wayside.stages.kernels import Array
from wayside.stages.mapping.facing import Plane, solve_facing
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.outline_edges import ASPECT
from wayside.stages.mapping.outline_fit import Face
from wayside.stages.mapping.panel_views import (
    LEAST_STRENGTH,
    Registered,
    outline_of,
    register_views,
    usable_views,
)
from wayside.stages.mapping.triangulation import triangulate_views
from wayside.stages.mapping.window import WindowFrame

CENTRE_SIGMA_PX, STRETCH_SIGMA, BLUR_SIGMA = 0.15, 0.003, 0.025
"""Scatter of a registered centre and stretch beyond their own: motion from view to view; blur of views twice as far."""
OVERCONFIDENT = 2.0
"""Registration is so much less exact than its residuals say: they do not know of moving backgrounds (measured)."""
TURN_SIGMA = float(np.radians(8.0))
"""Scatter of the facing of panels along a road."""
ASPECT_SIGMA = 0.02
"""Scatter of the proportion of shapes that have one, outline included."""
FARTHEST_SHARE, FARTHEST_OFF_M = 0.1, 1.0
LARGEST_CHANGE = 2.5
"""A panel that ends up farther from its boxes, or changes its size by more, is another thing."""


@dataclass(frozen=True, slots=True)
class Panel:
    """A measured panel: centre (3,) in the world, size in metres, facing in degrees, with standard deviations.

    frames (v,), rays (v, 2), weight_sigma, ray_sigma (v,): the views of the centre as in `LandmarkFit`; centre_sigma
    (2,): scatter of the centre across the face that all views share, metres; gap_px: RMS distance of the centres of the
    registered pictures from the point they were fitted to.
    """

    point: Array
    frames: NDArray[np.int64]
    rays: Array
    weight_sigma: Array
    ray_sigma: Array
    centre_sigma: Array
    size: Array
    sigma_size: Array
    facing_deg: float
    sigma_facing_deg: float
    shape: str
    strength: float
    gap_px: float


def measure_panel(
    fit: LandmarkFit, held: Sequence[WindowFrame], beside: FrenetOffset, drift_rad: float
) -> tuple[int, Panel | None]:
    """How many pictures of a place look alike, and its panel; None where its outline or its place are not believed."""
    plane = across_path(fit.point, held, beside)
    seen = usable_views(plane, fit.metric, held)
    if not seen:
        return 0, None
    group = register_views(plane, fit.metric, seen, fit.frames, held)
    face = outline_of(group, fit.metric)
    if face is None or face.strength < LEAST_STRENGTH:
        return len(group.views), None
    return len(group.views), solve_panel(fit, group, face, held, drift_rad)


def across_path(point: Array, held: Sequence[WindowFrame], beside: FrenetOffset) -> Plane:
    """The plane through a point across the path there, axes right, down and ahead."""
    stations = np.array([h.motion.station_m for h in held])
    after = int(np.clip(np.searchsorted(stations, beside.station), 1, max(len(held) - 1, 1)))
    pose = held[min(after, len(held) - 1)].motion.pose
    ahead = pose.rotation[:, 2]
    if len(held) > 1:
        travelled = pose.centre - held[after - 1].motion.pose.centre
        length = float(np.linalg.norm(travelled))
        ahead = travelled / length if length > 0 else ahead
    up = -pose.rotation[:, 1]
    up = up - (up @ ahead) * ahead
    up /= np.linalg.norm(up)
    return Plane(point, np.cross(ahead, up), -up, ahead)


def box_rays(fit: LandmarkFit, held: Sequence[WindowFrame]) -> Array:
    """Rays (v, 2) of the centres of the boxes that a place was fitted to."""
    used = zip(fit.rows[fit.used], fit.frames[fit.used], strict=True)
    return np.array([held[frame].ray[row] for row, frame in used])


def projected(point: Array, fit: LandmarkFit, held: Sequence[WindowFrame]) -> Array:
    """Rays (v, 2) of a point of the world in the frames that a place was fitted to."""
    local = np.array([held[frame].motion.pose.to_camera(point) for frame in fit.frames[fit.used]])
    return np.asarray(local[:, :2] / local[:, 2:])


def solve_panel(
    fit: LandmarkFit, group: Registered, face: Face, held: Sequence[WindowFrame], drift_rad: float
) -> Panel | None:
    """Place, size and facing from where the outline lies in all views; None where it runs away from the boxes."""
    plane, step = group.plane, group.step
    drawn, found = zip(*group.views, strict=True)
    frames = np.array([d.frame for d in drawn], np.int64)
    poses = [held[k].motion.pose for k in frames]
    focal = np.array([held[k].focal for k in frames])
    depth = np.array([d.depth for d in drawn])
    shift, stretch = (np.array([getattr(f, name) for f in found]) for name in ("shift", "stretch"))
    middle = (np.array(drawn[0].grey.shape[::-1]) - 1) / 2
    centre = ((face.box[:2] + face.box[2:]) / 2 - middle) * step
    size = (face.box[2:] - face.box[:2]) * step
    points = plane.points(centre * stretch + shift * step)
    local = np.array([pose.to_camera(point) for pose, point in zip(poses, points, strict=True)])
    covariances = np.array([f.covariance for f in found])
    deviations = OVERCONFIDENT * np.sqrt(np.einsum("vii->vi", covariances))
    shift_px = deviations[:, :2].mean(axis=1) * step / depth * focal
    ray_sigma = np.hypot(CENTRE_SIGMA_PX, shift_px) / focal
    weight_sigma = np.hypot(ray_sigma, drift_rad * np.sqrt(frames.max() - frames))
    if len(frames) > 1:
        point, _, _ = triangulate_views(
            np.stack([pose.rotation for pose in poses]),
            np.stack([pose.centre for pose in poses]),
            np.ascontiguousarray(local[:, :2] / local[:, 2:]),
            weight_sigma,
        )
        views = (frames, local[:, :2] / local[:, 2:], weight_sigma, ray_sigma)
    else:  # the depth is that of the boxes
        point = points[0]
        shifted = (
            box_rays(fit, held) + projected(point, fit, held) - projected(fit.point, fit, held)
        )
        views = (
            fit.frames[fit.used],
            shifted,
            fit.weight_sigma[fit.used],
            fit.ray_sigma[fit.used],
        )
    seen = np.array([pose.to_camera(point) for pose in poses])
    gaps = (seen[:, :2] / seen[:, 2:] - local[:, :2] / local[:, 2:]) * focal[:, None]
    off = float(np.linalg.norm(point - fit.point))
    grown = size / fit.metric
    if not off < max(FARTHEST_OFF_M, FARTHEST_SHARE * depth.min()):
        return None
    if grown.max() > LARGEST_CHANGE or grown.min() < 1 / LARGEST_CHANGE:
        return None
    there = plane._replace(point=point)
    centres = np.stack([pose.centre for pose in poses])
    farther = ((point - centres) @ plane.ahead) / ((plane.point - centres) @ plane.ahead)
    sizes = size * stretch * farther[:, None]
    stretch_sigma = np.hypot(STRETCH_SIGMA, BLUR_SIGMA * (depth / depth[0] - 1))
    aspect = (ASPECT[face.shape], ASPECT_SIGMA) if face.shape in ASPECT else None
    facing = solve_facing(
        there,
        centres,
        sizes,
        np.hypot(stretch_sigma[:, None], deviations[:, 2:]),
        turn_sigma=TURN_SIGMA,
        aspect=aspect,
    )
    true_size = np.exp(facing.log_size)
    edge = face.sigma * step
    return Panel(
        point=point,
        frames=views[0],
        rays=views[1],
        weight_sigma=views[2],
        ray_sigma=views[3],
        centre_sigma=edge / 2,
        size=true_size,
        sigma_size=np.hypot(edge, true_size * np.sqrt(np.diag(facing.covariance)[1:])),
        facing_deg=float(np.degrees(facing.turn)),
        sigma_facing_deg=float(np.degrees(np.sqrt(facing.covariance[0, 0]))),
        shape=face.shape,
        strength=face.strength,
        gap_px=float(np.sqrt((gaps**2).sum(axis=1).mean())),
    )
