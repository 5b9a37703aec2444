"""The panel of a landmark measured as a plane, from the images of all its views together.

The images are rectified on one plane across the path and registered to a few hundredths of a pixel; together they show
the outer outline of the face. Its centre in each view gives the position, seven times as exact as boxes. The change of
its width and height from view to view gives the size and the facing.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.measurement import PanelView
from wayside.schemas.models import LinearModel
from wayside.schemas.roadside import Posts
from wayside.stages.geometry import FrenetOffset
from wayside.stages.kernels import Array
from wayside.stages.mapping.landmark_fit import DRIFT_RAD, LandmarkFit
from wayside.stages.mapping.triangulation import CAUCHY_SIGMAS, triangulate_views
from wayside.stages.mapping.window import WindowFrame, WindowPoses
from wayside.stages.panel import (
    ASPECT,
    FaceOutline,
    PanelPlane,
    PosedImage,
    RegisteredViews,
    box_round,
    measure_posts,
    register_views,
    segments_of,
    solve_facing,
    usable_views,
)

CENTRE_SIGMA_PX = 0.15
"""Scatter of a registered centre beyond its covariance."""
STRETCH_SIGMA = 0.003
"""Relative scatter of a registered stretch beyond its covariance: motion from view to view."""
BLUR_SIGMA = 0.025
"""Relative scatter of the stretch of a view twice as far as the template, by its blur."""
COVARIANCE_SCALE = 2.0
"""Factor on standard deviations of registration, whose residuals do not show moving backgrounds (drives unknown)."""
FARTHEST_OFF_M = 1.0
"""A panel farther from its boxes is refused."""
USUAL_CAMERA_M = 1.6
"""Height of a camera above the road until the motion tells it."""
FARTHEST_OFF = 0.1
"""Far off it may be farther: this fraction of the depth of the nearest view."""


@dataclass(frozen=True, slots=True)
class Panel:
    """A measured panel, seen in v views."""

    point: Array
    """Its centre in the world, (3,)."""
    frames: NDArray[np.int64]
    """Of the views, as in `LandmarkFit`, (v,)."""
    rays: Array
    """Of the centre in each view, (v, 2)."""
    weight_sigma: Array
    """As in `LandmarkFit`, (v,)."""
    ray_sigma: Array
    """As in `LandmarkFit`, (v,)."""
    centre_sigma: Array
    """Error of the centre across the face that all views share, (2,), metres."""
    size: Array
    """Width and height, (2,), metres."""
    sigma_size: Array
    """Standard deviations of both, (2,)."""
    facing_deg: float
    """As in `Landmark`."""
    sigma_facing_deg: float
    """Its standard deviation."""
    shape: str
    """One of `SHAPES`."""
    residual_px: float
    """RMS distance of the centres in the registered views from the fitted point."""


class PanelModels(NamedTuple):
    """What panels are measured with."""

    outline: LinearModel
    """Chooses their outlines."""
    posts: LinearModel | None = None
    """Tells the kinds of posts below them. None: these are not looked at."""


class PanelMeasurement(NamedTuple):
    """How a panel was measured."""

    views: tuple[PanelView, ...] = ()
    """The registered views."""
    outline: FaceOutline | None = None
    """In samples of their template. None: none is strong enough."""
    panel: Panel | None = None
    """None: the outline or the position is refused."""
    posts: Posts | None = None
    """None: not asked for, or no view shows all of it."""

    @property
    def segments(self) -> Array | None:
        """Ends of the segments of the outline (k, 2, 2)."""
        if self.outline is None:
            return None
        sides = segments_of(self.outline.shape, self.outline.box, self.outline.rotation)
        return np.stack([sides.begin, sides.end], axis=1)

    @property
    def face(self) -> Array | None:
        """Box [left, top, right, bottom] round the outline, corners and all."""
        if self.outline is None:
            return None
        return box_round(self.outline.shape, self.outline.box, self.outline.rotation)


def measure_panel(
    fit: LandmarkFit, held: Sequence[WindowFrame], beside: FrenetOffset, models: PanelModels
) -> PanelMeasurement:
    """The panel of a landmark from its registered views, and its posts; no views where none shows all of it."""
    plane = across_path(fit.point, held, beside)
    images = [
        PosedImage(k, h.motion.pose, h.camera, h.rgb)
        for k, h in enumerate(held)
        if h.rgb is not None
    ]
    usable = usable_views(plane, fit.metric, images)
    if not usable:
        return PanelMeasurement()
    registered = register_views(plane, fit.metric, usable, fit.frames, models.outline)
    views = tuple(
        PanelView(held[view.image.frame].frame.index, view.rgb, alignment)
        for view, alignment in registered.views
    )
    outline = registered.outline
    box = registered.box if outline is None else outline.box
    posts = None if models.posts is None else _posts(registered, box, held, models.posts)
    if outline is None:
        return PanelMeasurement(views, posts=posts)
    return PanelMeasurement(views, outline, solve_panel(fit, registered, outline, held), posts)


def _posts(
    registered: RegisteredViews, box: Array, held: Sequence[WindowFrame], kinds: LinearModel
) -> Posts:
    """What a panel stands on; box (4,): of the panel in samples of the template."""
    template, _ = registered.views[0]
    motion = held[template.image.frame].motion
    height = motion.camera_height_m if np.isfinite(motion.camera_height_m) else USUAL_CAMERA_M
    below = box[3] - (template.rgb.shape[0] - 1) / 2
    low = registered.plane.points(np.array([[0.0, below * registered.step]]))[0]
    above_m = height - float(registered.plane.down @ (low - motion.pose.centre))
    return measure_posts(registered, box, above_m, kinds)


def across_path(point: Array, held: Sequence[WindowFrame], beside: FrenetOffset) -> PanelPlane:
    """The plane through a point across the path there."""
    after = bisect_left(held, beside.station, key=lambda h: h.motion.station_m)
    after = min(max(after, 1), max(len(held) - 1, 1))
    pose = held[min(after, len(held) - 1)].motion.pose
    ahead = pose.rotation[:, 2]
    if len(held) > 1:
        travelled = pose.centre - held[after - 1].motion.pose.centre
        length = float(np.linalg.norm(travelled))
        ahead = travelled / length if length > 0 else ahead
    return PanelPlane.across(point, ahead, -pose.rotation[:, 1])


def solve_panel(
    fit: LandmarkFit, registered: RegisteredViews, outline: FaceOutline, held: Sequence[WindowFrame]
) -> Panel | None:
    """Position, size and facing from the outline in all views; None where they are too far from those of the boxes."""
    plane, step = registered.plane, registered.step
    views, alignments = zip(*registered.views, strict=True)
    frames = np.array([view.image.frame for view in views], np.int64)
    poses = rotations, centres = WindowPoses.of([held[k] for k in frames])[1:]
    focal, depth = np.array([[view.image.focal, view.depth] for view in views]).T
    shift = np.array([a.shift for a in alignments])
    stretch = np.array([a.stretch for a in alignments])
    deviations = COVARIANCE_SCALE * np.sqrt([np.diag(a.covariance) for a in alignments])
    middle = (np.array(views[0].rgb.shape[1::-1]) - 1) / 2
    offset = ((outline.box[:2] + outline.box[2:]) / 2 - middle) * step
    size = (outline.box[2:] - outline.box[:2]) * step
    points = plane.points(offset * stretch + shift * step)
    rays = _rays(poses, points)
    shift_px = deviations[:, :2].mean(axis=1) * step / depth * focal
    ray_sigma = np.hypot(CENTRE_SIGMA_PX, shift_px) / focal
    weight_sigma = np.hypot(ray_sigma, DRIFT_RAD * np.sqrt(frames.max() - frames))
    if len(frames) > 1:
        point, _ = triangulate_views(rotations, centres, rays, weight_sigma)
        centre_views = (frames, rays, weight_sigma, ray_sigma)
    else:  # the depth is that of the boxes
        point, used = points[0], fit.used
        own = WindowPoses.of([held[k] for k in fit.frames[used]])[1:]
        shifted = fit.seen["ray"][used] + _rays(own, point) - _rays(own, fit.point)
        centre_views = (fit.frames[used], shifted, fit.weight_sigma[used], fit.ray_sigma[used])
    residuals = (_rays(poses, point) - rays) * focal[:, None]
    off = float(np.linalg.norm(point - fit.point))
    farther = ((point - centres) @ plane.ahead) / ((plane.point - centres) @ plane.ahead)
    sizes = size * stretch * farther[:, None]
    # an outline may be fitted inside out, and a point may lie behind a camera
    if not (off < max(FARTHEST_OFF_M, FARTHEST_OFF * depth.min())) or (sizes.min() <= 0):
        return None
    stretch_sigma = np.hypot(STRETCH_SIGMA, BLUR_SIGMA * (depth / depth[0] - 1))
    sigmas, aspect = np.hypot(stretch_sigma[:, None], deviations[:, 2:]), ASPECT.get(outline.shape)
    seen, plane = (centres, sizes, sigmas), plane._replace(point=point)
    facing = solve_facing(plane, *seen, cauchy=CAUCHY_SIGMAS, aspect=aspect)
    true_size = np.exp(facing.log_size)
    size_sigma = true_size * np.sqrt(np.diag(facing.covariance)[1:])
    return Panel(
        point,
        *centre_views,
        centre_sigma=outline.centre_sigma * step,
        size=true_size,
        sigma_size=np.hypot(outline.size_sigma * step, size_sigma),
        facing_deg=float(np.degrees(facing.angle)),
        sigma_facing_deg=float(np.degrees(np.sqrt(facing.covariance[0, 0]))),
        shape=outline.shape,
        residual_px=float(np.sqrt((residuals**2).sum(axis=1).mean())),
    )


def _rays(poses: tuple[Array, Array], points: Array) -> Array:
    """Rays (v, 2) of one point (3,) of the world, or of another (v, 3) in each view, by rotations and centres."""
    rotations, centres = poses
    local = ((points - centres)[:, None] @ rotations)[:, 0]
    return np.ascontiguousarray(local[:, :2] / local[:, 2:])
