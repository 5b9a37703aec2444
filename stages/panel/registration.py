"""Registration of the rectified views of a panel, and the outline that they show together.

The background of a panel moves from view to view and fills half of the box of a diamond. Where boxes do not correlate,
the face inside its outline is compared alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.measurement import Alignment
from wayside.schemas.models import LinearModel
from wayside.stages.kernels import Array
from wayside.stages.panel.image_alignment import SHARED_SAMPLES, Samples, align, warp_to_template
from wayside.stages.panel.outline import FaceOutline, fit_face_outline
from wayside.stages.panel.outline_shapes import segments_of
from wayside.stages.panel.rectification import PanelPlane, PosedImage, RectifiedView, rectify

SMALLEST_STRENGTH = 0.4
"""Edge strength all round (0 to 1) below which an outline is refused."""
MOST_SAMPLES = 150
"""Samples across the longer side of a panel at most."""
MARGIN, MARGIN_LONGER = 0.35, 0.6
"""Margin round the box, as a fraction of the shorter side; of so much of the longer side where that is more."""
DEPTH_RATIO = 3.2
"""Views up to so many times farther than the template are registered."""
ENOUGH_VIEWS, MOST_TEMPLATES = 2, 3
"""With fewer registered, the next view becomes the template, of so many: the nearest may be half hidden."""
FEWEST_SAMPLES = 64
"""Samples that are compared at least: a far view mixes a small face with its background."""
BLUR = 0.45
"""Blur (sigma), in samples, of the template for a view sqrt(2) times as far."""
OUTLINE_DEPTH_RATIO, OUTLINE_VIEWS = 2.3, 3
"""Views up to so many times farther than the template show the outline, and so many of them, the nearest."""


@dataclass(frozen=True)
class RegisteredViews:
    """Rectified views registered to the first, the template. `step`: metres a sample. `size`: as detected."""

    plane: PanelPlane
    step: float
    views: list[tuple[RectifiedView, Alignment]]
    size: Array
    model: LinearModel

    def stacked(self) -> NDArray[np.float32]:
        """The views (n, rows, columns, 3) that show the outline, resampled into the template."""
        farthest = OUTLINE_DEPTH_RATIO * self.views[0][0].depth
        near = [view for view in self.views if view[0].depth <= farthest]
        (template, _), *others = near[:OUTLINE_VIEWS]
        return np.array(
            [template.rgb, *(warp_to_template(v.rgb, a) for v, a in others)], np.float32
        )

    @property
    def box(self) -> Array:
        """The box [left, top, right, bottom] of the detected panel in samples of the template."""
        middle = (np.array(self.views[0][0].rgb.shape[1::-1]) - 1) / 2
        half = self.size / self.step / 2
        return np.concatenate([middle - half, middle + half])

    @cached_property
    def outline(self) -> FaceOutline | None:
        """The outline of the face in samples of the template, or None if it is weak."""
        outline = fit_face_outline(self.stacked(), self.box, self.model)
        strong = outline is not None and outline.strength >= SMALLEST_STRENGTH
        return outline if strong else None


def register_views(
    plane: PanelPlane,
    size: Array,
    usable: Sequence[tuple[float, PosedImage]],
    detected: NDArray[np.int64],
    model: LinearModel,
) -> RegisteredViews:
    """Register the views to the nearest one that enough others correlate with.

    `plane`, `size` (2,): where the panel is, and its width and height, metres. `usable`: depth and image of the usable
    views, nearest first. `detected`: numbers of the frames in which the panel was detected. In others something may be
    in front of it. `model`: chooses outlines.
    """
    templates = [i for i, (_, image) in enumerate(usable) if image.frame in detected]
    first, *others = templates[:MOST_TEMPLATES] or [0]
    best = _registered_to(plane, size, usable[first:], model)
    for i in others:
        if len(best.views) >= ENOUGH_VIEWS or i == len(usable) - 1:
            break
        registered = _registered_to(plane, size, usable[i:], model)
        if len(registered.views) > len(best.views):
            best = registered
    return best


def _registered_to(
    plane: PanelPlane, size: Array, usable: Sequence[tuple[float, PosedImage]], model: LinearModel
) -> RegisteredViews:
    """The first of the usable views as template, and those that correlate with it: by the box, or else by the face."""
    nearest, image = usable[0]
    step = max(nearest / image.focal, float(size.max()) / MOST_SAMPLES)
    margin = MARGIN * max(float(size.min()), MARGIN_LONGER * float(size.max()))
    count = np.ceil((size / 2 + margin) / step)
    columns, rows = (np.arange(0.5 - n, n) * step for n in count)
    near = [view for view in usable if view[0] <= DEPTH_RATIO * nearest]
    template, *others = rectify(plane, columns, rows, near)
    inside = [np.abs(at) <= m / 2 + step for at, m in zip((columns, rows), size, strict=True)]
    box = np.outer(inside[1], inside[0]).astype(np.float32)
    identity = Alignment(np.zeros(2), np.ones(2), 1.0, 0.0, 1.0, np.zeros((4, 4)))
    alone = RegisteredViews(plane, step, [(template, identity)], size, model)
    found = _correlated(template, others, [box] * len(others))
    if len(found) + 1 < ENOUGH_VIEWS and others and (outline := alone.outline) is not None:
        weights = [inside_outline(outline, box.shape, o.depth / nearest) for o in others]
        found = _correlated(template, others, weights)
    return replace(alone, views=[*alone.views, *found]) if found else alone


def _correlated(
    template: RectifiedView, others: Sequence[RectifiedView], weights: Sequence[Samples]
) -> list[tuple[RectifiedView, Alignment]]:
    """The views that correlate with the template where their weight is, with their alignment."""
    found = [(v, align_view(template, v, w)) for v, w in zip(others, weights, strict=True)]
    return [(view, alignment) for view, alignment in found if alignment is not None]


def inside_outline(outline: FaceOutline, shape: tuple[int, ...], margin: float) -> Samples:
    """1 on the samples inside an outline, farther from it than the margin, and 0 elsewhere: (rows, columns).

    A view so many times coarser mixes the face with its background over so many samples.
    """
    sides = segments_of(outline.shape, outline.box, outline.rotation)
    corners = cv2.convexHull(np.concatenate([sides.begin, sides.end]).astype(np.float32))
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(corners * 16).astype(np.int32), 1, shift=4)
    narrow = cv2.erode(mask, np.ones((3, 3), np.uint8), iterations=int(np.ceil(margin)))
    return np.asarray(narrow, np.float32)


def align_view(template: RectifiedView, view: RectifiedView, weight: Samples) -> Alignment | None:
    """Alignment of a view with the template where the weight is; None where it fails or too little is compared."""
    if np.count_nonzero(weight) < FEWEST_SAMPLES:
        return None
    scale, size = len(template.rgb) // len(template.grey), template.grey.shape[::-1]
    weight = np.asarray(cv2.resize(weight, size, interpolation=cv2.INTER_AREA), np.float32)
    blur = BLUR / scale * np.sqrt(max((view.depth / template.depth) ** 2 - 1, 1e-6))
    first = np.asarray(cv2.GaussianBlur(template.grey, (0, 0), blur), np.float32)
    # at first in whole samples: the weighted part of the template in all of the view
    left, top, wide, high = cv2.boundingRect((weight > 0).astype(np.uint8))
    part = first[top : top + high, left : left + wide]
    places = cv2.matchTemplate(view.grey, part, cv2.TM_CCOEFF_NORMED)
    _, most, _, place = cv2.minMaxLoc(places)
    start = np.subtract(place, (left, top), dtype=np.float64)
    # of so many places, one correlates as well by chance
    chance = np.sqrt(2 * np.log(places.size) * SHARED_SAMPLES / part.size)
    found = align(first, weight, view.grey, start) if most > chance else None
    if found is None:
        return None
    unit = np.array([scale, scale, 1, 1])
    covariance = unit[:, None] * found.covariance * unit
    return found._replace(shift=found.shift * scale, covariance=covariance)
