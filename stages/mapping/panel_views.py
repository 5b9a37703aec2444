"""The pictures of a panel, drawn on its plane and brought into register: which of them show one and the same face.

What lies behind a panel moves from picture to picture and makes up half of the box of a diamond: where boxes do not
look alike, the face itself is compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.kernels import Array
from wayside.stages.mapping.facing import Plane
from wayside.stages.mapping.image_alignment import Alignment, align, stretched
from wayside.stages.mapping.outline_edges import segments_of
from wayside.stages.mapping.outline_fit import Face, fit_face
from wayside.stages.mapping.window import WindowFrame

MOST_VIEWS, FEWEST_PX = 6, 9.0
NEAREST_M, FARTHEST_M = 4.0, 90.0
"""Views of use: how many, how small the face may be, how far."""
FINEST = 150
"""Samples across a panel at most."""
MARGIN = 0.35
"""What is drawn around the box, as a share of the panel's size."""
COARSER, OUTLINE_COARSER, OUTLINE_VIEWS = 3.2, 2.3, 3
"""Views up to so many times farther than the template are registered; of them the outline is seen."""
ENOUGH_VIEWS, MOST_TEMPLATES = 2, 3
"""With fewer in register the next view becomes the template: the nearest may be half hidden; so many are tried."""
ALIKE = 0.8
"""Likeness from which a view counts as registered."""
FEWEST_SAMPLES = 64
"""Samples of a face that are compared at least: a far view mixes all of a small face with what lies behind it."""
ALIGN_SIDE = 90
"""Longer patches are registered at half size."""
LEAST_STRENGTH = 0.4
"""Edge strength all round below which an outline is not believed."""
_CELLS = 8


class Drawn(NamedTuple):
    """A view on the plane: frame in the window, depth, picture (rows, columns, 3) and its grey."""

    frame: int
    depth: float
    rgb: NDArray[np.float32]
    grey: Array


class Registered(NamedTuple):
    """Views in register with the first of them; `step` metres a sample."""

    plane: Plane
    step: float
    views: list[tuple[Drawn, Alignment]]


def usable_views(
    plane: Plane, metric: Array, held: Sequence[WindowFrame]
) -> list[tuple[float, int]]:
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


def pixels_of(home: WindowFrame, points: Array) -> Array:
    """Recorded pixels (n, 2) of points (n, 3) of the world."""
    camera = home.frame.camera
    local = home.motion.pose.to_camera(points)
    if camera is None:
        return np.full((len(points), 2), np.nan)
    return distort_points(camera, ideal_of_rays(camera, local[:, :2] / local[:, 2:]))


def register_views(
    plane: Plane,
    metric: Array,
    seen: Sequence[tuple[float, int]],
    shown: NDArray[np.int64],
    held: Sequence[WindowFrame],
) -> Registered:
    """Bring the views into register with the nearest that enough others look like.

    Parameters
    ----------
    plane, metric
        Where the panel is, and its width and height (2,), metres.
    seen
        Depth and frame of the views of use, nearest first.
    shown
        Frames in which the panel was found: where it was not, something may stand in front of it.
    held
        The window.
    """
    first = [i for i, (_, frame) in enumerate(seen) if frame in shown][:MOST_TEMPLATES] or [0]
    best = _registered_with(plane, metric, seen[first[0] :], held)
    for i in first[1:]:
        if len(best.views) >= ENOUGH_VIEWS or i == len(seen) - 1:
            break
        group = _registered_with(plane, metric, seen[i:], held)
        if len(group.views) > len(best.views):
            best = group
    return best


def _registered_with(
    plane: Plane, metric: Array, seen: Sequence[tuple[float, int]], held: Sequence[WindowFrame]
) -> Registered:
    """Views in register with the first of `seen`, by the whole box or else by the face alone."""
    nearest, frame = seen[0]
    step = max(nearest / held[frame].focal, float(metric.max()) / FINEST)
    margin = MARGIN * max(float(metric.min()), 0.6 * float(metric.max()))
    count = np.ceil((metric / 2 + margin) / step)
    reach = [np.arange(-n, n + 1) * step for n in count]
    inside = [np.abs(r) <= m / 2 + step for r, m in zip(reach, metric, strict=True)]
    template = _draw(plane, reach, nearest, frame, held[frame])
    others = [
        _draw(plane, reach, depth, k, held[k])
        for depth, k in seen[1:]
        if depth <= COARSER * nearest
    ]
    box = np.outer(inside[1], inside[0]).astype(np.float64)
    views = _alike(template, others, [box] * len(others))
    alone = Registered(plane, step, views[:1])
    if len(views) < ENOUGH_VIEWS and others:
        face = outline_of(alone, metric)
        if face is not None and face.strength >= LEAST_STRENGTH:
            weights = [within(face, box.shape, o.depth / nearest) for o in others]
            views = _alike(template, others, weights)
    return alone._replace(views=views)


def _alike(
    template: Drawn, others: Sequence[Drawn], weights: Sequence[Array]
) -> list[tuple[Drawn, Alignment]]:
    """The template and the views that look like it where their weight is."""
    still = Alignment(np.zeros(2), np.ones(2), 1.0, 0.0, 1.0, np.zeros((4, 4)))
    pairs = zip(others, weights, strict=True)
    found = [(drawn, aligned(template, drawn, weight)) for drawn, weight in pairs]
    return [(template, still), *((d, f) for d, f in found if f is not None and f.zncc > ALIKE)]


def within(face: Face, shape: tuple[int, ...], margin: float) -> Array:
    """1 on the samples within an outline, farther from it than the margin, and 0 elsewhere: (rows, columns).

    A picture so many times coarser mixes the face with what lies behind it so many samples wide.
    """
    sides = segments_of(face.shape, face.box, face.turn)
    corners = cv2.convexHull(np.concatenate([sides.begin, sides.end]).astype(np.float32))
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(corners * 16).astype(np.int32), 1, shift=4)
    narrow = cv2.erode(mask, np.ones((3, 3), np.uint8), iterations=int(np.ceil(margin)))
    return np.asarray(narrow, np.float64)


def _draw(
    plane: Plane, reach: Sequence[Array], depth: float, frame: int, home: WindowFrame
) -> Drawn:
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
    return Drawn(frame, depth, rgb.astype(np.float32), grey.astype(np.float64))


def _between(count: int) -> Array:
    """Linear interpolation from the knots to so many samples, (count, knots)."""
    at = np.linspace(0, _CELLS, count)
    return np.asarray(np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(_CELLS + 1))))


def aligned(template: Drawn, drawn: Drawn, weight: Array) -> Alignment | None:
    """Where a view shows the template, compared where its weight is; None where nowhere, or too little is compared."""
    if np.count_nonzero(weight) < FEWEST_SAMPLES:
        return None
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


def outline_of(group: Registered, metric: Array) -> Face | None:
    """Outline of the face in samples of the template."""
    nearest = group.views[0][0].depth
    near = [view for view in group.views if view[0].depth <= OUTLINE_COARSER * nearest]
    views = np.stack([stretched(drawn.rgb, found) for drawn, found in near[:OUTLINE_VIEWS]])
    middle = (np.array(views.shape[2:0:-1]) - 1) / 2
    half = metric / group.step / 2
    return fit_face(np.ascontiguousarray(views), [np.concatenate([middle - half, middle + half])])
