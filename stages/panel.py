"""The panel of a place as a plane, from the pictures of all its views together.

The views are drawn on one plane across the path and brought into register to a few hundredths of a pixel; in register
they show the outer outline of the face; where it lies in each view is the place again, seven times as exact as boxes;
and how its width and height change from view to view tells the size and the facing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.numerics.align import Alignment, align, stretched
from wayside.stages.numerics.compiled import Array
from wayside.stages.numerics.facefit import Face, fit_face
from wayside.stages.numerics.faces import ASPECT
from wayside.stages.numerics.facing import Plane, solve_facing
from wayside.stages.numerics.path import Beside
from wayside.stages.numerics.places import DRIFT_RAD, Fit
from wayside.stages.numerics.triangulate import triangulate_views
from wayside.stages.numerics.undistort import distort_points, ideal_of_rays
from wayside.stages.window import Held

MOST_VIEWS, FEWEST_PX = 6, 9.0
NEAREST_M, FARTHEST_M = 4.0, 90.0
"""Views of use: how many, how small the face may be, how far."""
FINEST = 150
"""Samples across a panel at most."""
MARGIN = 0.35
"""What is drawn around the box, as a share of the panel's size."""
COARSER, OUTLINE_COARSER, OUTLINE_VIEWS = 3.2, 2.3, 3
"""Views up to so many times farther than the template are registered; of them the outline is seen."""
ENOUGH_VIEWS = 2
"""With fewer in register the next view becomes the template: the nearest may be half hidden."""
ALIKE = 0.8
"""Likeness from which a view counts as registered."""
ALIGN_SIDE = 90
"""Longer patches are registered at half size."""
LEAST_STRENGTH = 0.4
"""Edge strength all round below which an outline is not believed."""
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
_CELLS = 8


@dataclass(frozen=True, slots=True)
class Panel:
    """A measured panel: centre (3,) in the world, size in metres, facing in degrees, with standard deviations.

    frames (v,), rays (v, 2), weight_sigma, ray_sigma (v,): the views of the centre as in `Fit`; centre_sigma (2,):
    scatter of the centre across the face that all views share, metres; registered: pictures that look alike; gap_px:
    RMS distance of their centres from the point they were fitted to.
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
    registered: int
    gap_px: float


class _Drawn(NamedTuple):
    """A view on the plane: frame in the window, depth, picture (rows, columns, 3) and its grey."""

    frame: int
    depth: float
    rgb: NDArray[np.float32]
    grey: Array


class _Registered(NamedTuple):
    """Views in register with the first of them; `step` metres a sample."""

    plane: Plane
    step: float
    views: list[tuple[_Drawn, Alignment]]


def measure_panel(fit: Fit, held: Sequence[Held], beside: Beside) -> Panel | None:
    """Measure the panel of a place; None where its pictures are gone or do not agree."""
    plane = across_path(fit.point, held, beside)
    seen = usable_views(plane, fit.metric, held)
    if not seen:
        return None
    group = register_views(plane, fit.metric, seen, held)
    face = outline_of(group, fit.metric)
    if face is None or face.strength < LEAST_STRENGTH:
        return None
    return solve_panel(fit, group, face, held)


def across_path(point: Array, held: Sequence[Held], beside: Beside) -> Plane:
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


def box_rays(fit: Fit, held: Sequence[Held]) -> Array:
    """Rays (v, 2) of the centres of the boxes that a place was fitted to."""
    first = np.cumsum([0, *(len(h.open) for h in held)])
    used = zip(fit.rows[fit.used], fit.frames[fit.used], strict=True)
    return np.array([held[frame].ray[row - first[frame]] for row, frame in used])


def projected(point: Array, fit: Fit, held: Sequence[Held]) -> Array:
    """Rays (v, 2) of a point of the world in the frames that a place was fitted to."""
    local = np.array([held[frame].motion.pose.to_camera(point) for frame in fit.frames[fit.used]])
    return np.asarray(local[:, :2] / local[:, 2:])


def usable_views(plane: Plane, metric: Array, held: Sequence[Held]) -> list[tuple[float, int]]:
    """Depth and frame of the views that show all of the panel, nearest first."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * metric / 2 * 1.05
    found = []
    for k, home in enumerate(held):
        depth = float(home.motion.pose.to_camera(plane.point)[2])
        if home.rgb is None or not NEAREST_M < depth < FARTHEST_M:
            continue
        pixels = pixels_of(home, plane.points(corners))
        height, width = home.rgb.shape[:2]
        inside = (pixels >= 1).all() and (pixels < (width - 2, height - 2)).all()
        if inside and np.ptp(pixels, axis=0).min() >= FEWEST_PX:
            found.append((depth, k))
    return sorted(found)[:MOST_VIEWS]


def pixels_of(home: Held, points: Array) -> Array:
    """Recorded pixels (n, 2) of points (n, 3) of the world."""
    camera = home.frame.camera
    local = home.motion.pose.to_camera(points)
    if camera is None:
        return np.full((len(points), 2), np.nan)
    return distort_points(camera, ideal_of_rays(camera, local[:, :2] / local[:, 2:]))


def register_views(
    plane: Plane, metric: Array, seen: Sequence[tuple[float, int]], held: Sequence[Held]
) -> _Registered:
    """Bring the views into register with the nearest that enough others look like."""
    best = _registered_with(plane, metric, seen, held)
    for first in range(1, min(3, len(seen) - 1)):
        if len(best.views) >= ENOUGH_VIEWS:
            break
        group = _registered_with(plane, metric, seen[first:], held)
        if len(group.views) > len(best.views):
            best = group
    return best


def _registered_with(
    plane: Plane, metric: Array, seen: Sequence[tuple[float, int]], held: Sequence[Held]
) -> _Registered:
    """Views in register with the first of `seen`."""
    nearest, frame = seen[0]
    step = max(nearest / held[frame].focal, float(metric.max()) / FINEST)
    margin = MARGIN * max(float(metric.min()), 0.6 * float(metric.max()))
    count = np.ceil((metric / 2 + margin) / step)
    reach = [np.arange(-n, n + 1) * step for n in count]
    inside = [np.abs(r) <= m / 2 + step for r, m in zip(reach, metric, strict=True)]
    weight = np.outer(inside[1], inside[0]).astype(np.float64)
    template = _draw(plane, reach, nearest, frame, held[frame])
    still = Alignment(np.zeros(2), np.ones(2), 1.0, 0.0, 1.0, np.zeros((4, 4)))
    views = [(template, still)]
    for depth, k in seen[1:]:
        if depth > COARSER * nearest:
            break
        drawn = _draw(plane, reach, depth, k, held[k])
        found = _aligned(template, drawn, weight)
        if found is not None and found.zncc > ALIKE:
            views.append((drawn, found))
    return _Registered(plane, step, views)


def _draw(plane: Plane, reach: Sequence[Array], depth: float, frame: int, home: Held) -> _Drawn:
    """What a view shows on the plane; the way from plane to pixels is bent little, so a grid of cells carries it."""
    knots = [np.linspace(r[0], r[-1], _CELLS + 1) for r in reach]
    grid = np.stack(np.meshgrid(*knots), axis=-1).reshape(-1, 2)
    pixels = pixels_of(home, plane.points(grid)).reshape(_CELLS + 1, _CELLS + 1, 2)
    across, down = (_between(len(r)) for r in reach)
    u, v = ((down @ pixels[..., c] @ across.T).astype(np.float32) for c in (0, 1))
    if home.rgb is None:
        raise ValueError(
            "wanted a frame with its picture, found one without; choose views by usable_views"
        )
    rgb = cv2.remap(home.rgb, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return _Drawn(frame, depth, rgb.astype(np.float32), grey.astype(np.float64))


def _between(count: int) -> Array:
    """Linear interpolation from the knots to so many samples, (count, knots)."""
    at = np.linspace(0, _CELLS, count)
    return np.asarray(np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(_CELLS + 1))))


def _aligned(template: _Drawn, drawn: _Drawn, weight: Array) -> Alignment | None:
    blur = 0.45 * np.sqrt(max((drawn.depth / template.depth) ** 2 - 1, 0.0))
    sharp = template.grey
    first: Array = np.asarray(cv2.GaussianBlur(sharp, (0, 0), blur) if blur > 0.2 else sharp)
    other, mask = drawn.grey, weight
    halved = max(weight.shape) > ALIGN_SIDE
    if halved:
        first, other, mask = (_half(image) for image in (first, other, mask))
    found = align(first, mask, other, _coarse(first, other, mask))
    if found is None or not halved:
        return found
    ratio = np.array(weight.shape[::-1]) / (weight.shape[1] // 2, weight.shape[0] // 2)
    spread = np.diag([*ratio, 1.0, 1.0])
    return found._replace(shift=found.shift * ratio, covariance=spread @ found.covariance @ spread)


def _half(image: Array) -> Array:
    size = (image.shape[1] // 2, image.shape[0] // 2)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float64)


def _coarse(template: Array, patch: Array, weight: Array) -> Array:
    """Whole-sample shift (2,) of best likeness: the weighted part of the template in all of the patch."""
    rows, columns = np.flatnonzero(weight.any(axis=1)), np.flatnonzero(weight.any(axis=0))
    part = template[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    likeness = cv2.matchTemplate(
        patch.astype(np.float32), part.astype(np.float32), cv2.TM_CCOEFF_NORMED
    )
    _, _, _, (left, top) = cv2.minMaxLoc(likeness)
    return np.array([left - columns[0], top - rows[0]], np.float64)


def outline_of(group: _Registered, metric: Array) -> Face | None:
    """Outline of the face in samples of the template."""
    nearest = group.views[0][0].depth
    near = [view for view in group.views if view[0].depth <= OUTLINE_COARSER * nearest]
    views = np.stack([stretched(drawn.rgb, found) for drawn, found in near[:OUTLINE_VIEWS]])
    middle = (np.array(views.shape[2:0:-1]) - 1) / 2
    half = metric / group.step / 2
    return fit_face(np.ascontiguousarray(views), [np.concatenate([middle - half, middle + half])])


def solve_panel(fit: Fit, group: _Registered, face: Face, held: Sequence[Held]) -> Panel | None:
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
    weight_sigma = np.hypot(ray_sigma, DRIFT_RAD * np.sqrt(frames.max() - frames))
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
        registered=len(frames),
        gap_px=float(np.sqrt((gaps**2).sum(axis=1).mean())),
    )
