"""Images of a panel resampled on its plane (rectified views)."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera, Pose
from wayside.stages.geometry import cross_matrices, distort_points, ideal_of_rays
from wayside.stages.kernels import Array

MOST_VIEWS = 6
"""Nearest views that measure a panel."""
SMALLEST_PX = 9.0
"""Views with a smaller side are left out."""
NEAREST_M, FARTHEST_M = 4.0, 90.0
"""Nearer and farther views are left out."""
BORDER = 1.05
"""The box times this lies within a usable image."""
BORDER_PX = 1.0
"""Least distance of that box from the edge of the image."""
FULL_SIZE_SAMPLES = 60
"""Longer views, in samples, are registered at half size."""
_CELLS = 8
"""Cells of the grid, each way, whose knots are projected exactly; samples between are interpolated."""
_KNOTS = np.arange(_CELLS + 1)


class PanelPlane(NamedTuple):
    """A plane: a point (3,), metres, and the axes right, down and ahead (3,), its normal, in the world frame."""

    point: Array
    right: Array
    down: Array
    ahead: Array

    @classmethod
    def across(cls, point: Array, ahead: Array, up: Array) -> "PanelPlane":
        """The plane through a point with the unit normal `ahead`; `up` need not be perpendicular to it."""
        up = up - (up @ ahead) * ahead
        up /= np.linalg.norm(up)
        return cls(point, cross_matrices(ahead) @ up, -up, ahead)

    def meet(self, centre: Array, points: Array) -> Array:
        """Where lines from a camera centre (3,) through points (n, 3) meet the plane: right and down (n, 2), metres."""
        rays = points - centre
        fraction = ((self.point - centre) @ self.ahead) / (rays @ self.ahead)
        offset = centre + fraction[:, None] * rays - self.point
        return np.column_stack([offset @ self.right, offset @ self.down])

    def points(self, offsets: Array) -> Array:
        """World points (n, 3) at offsets (n, 2) right and down in the plane, metres."""
        return np.asarray(
            self.point + offsets[:, :1] * self.right + offsets[:, 1:] * self.down, np.float64
        )


class PosedImage(NamedTuple):
    """An image `rgb` (height, width, 3) with its camera and pose; frame: its number, larger where later."""

    frame: int
    pose: Pose
    camera: Camera
    rgb: NDArray[np.uint8]

    @property
    def focal(self) -> float:
        """Mean focal length, px."""
        return (self.camera.fx + self.camera.fy) / 2


class RectifiedView(NamedTuple):
    """An image resampled on the plane: depth of the panel in it, metres; rgb (rows, columns, 3), grey as registered."""

    image: PosedImage
    depth: float
    rgb: NDArray[np.uint8]
    grey: NDArray[np.float32]


def pixels_of(images: Iterable[PosedImage], points: Array) -> Array:
    """Recorded (distorted) pixels (v, n, 2) of world points (n, 3) in images."""
    found = []
    for camera, own in groupby(images, key=lambda image: image.camera):
        poses = [(image.pose.centre, image.pose.rotation) for image in own]
        centres, rotations = (np.array(parts) for parts in zip(*poses, strict=True))
        local = ((points - centres[:, None]) @ rotations).reshape(-1, 3)
        found.append(distort_points(camera, ideal_of_rays(camera, local[:, :2] / local[:, 2:])))
    return np.concatenate(found).reshape(-1, len(points), 2)


def usable_views(
    plane: PanelPlane, size: Array, images: Sequence[PosedImage]
) -> list[tuple[float, PosedImage]]:
    """Depth and image of the views that show all of a panel of this width and height (2,), metres; nearest first."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2 * BORDER
    poses = (image.pose for image in images)
    depths = [float((plane.point - pose.centre) @ pose.rotation[:, 2]) for pose in poses]
    near = [view for view in zip(depths, images, strict=True) if NEAREST_M < view[0] < FARTHEST_M]
    if not near:
        return []
    pixels = pixels_of((image for _, image in near), plane.points(corners))
    least, most = pixels.min(axis=1), pixels.max(axis=1)
    ends = [(i.rgb.shape[1] - 1 - BORDER_PX, i.rgb.shape[0] - 1 - BORDER_PX) for _, i in near]
    shown = (least >= BORDER_PX).all(axis=1) & (most < ends).all(axis=1)
    shown &= (most - least).min(axis=1) >= SMALLEST_PX
    found = [view for view, whole in zip(near, shown, strict=True) if whole]
    found.sort(key=lambda view: (view[0], view[1].frame))
    return found[:MOST_VIEWS]


def rectify(
    plane: PanelPlane, columns: Array, rows: Array, views: Sequence[tuple[float, PosedImage]]
) -> list[RectifiedView]:
    """Resample images, each with its depth, at offsets right and down in the plane, metres, evenly spaced.

    `columns`: (m,), rows: (n,). The projection varies slowly over a panel: it is computed on a grid and interpolated
    linearly between.
    """
    knots = [at[0] + (at[-1] - at[0]) / _CELLS * _KNOTS for at in (columns, rows)]
    grid = plane.points(np.stack(np.meshgrid(*knots), axis=-1).reshape(-1, 2))
    across, down = _interpolation(len(columns)).T, _interpolation(len(rows))
    pixels = pixels_of((image for _, image in views), grid).astype(np.float32)
    maps = down @ pixels.reshape(-1, _CELLS + 1, _CELLS + 1, 2).transpose(0, 3, 1, 2) @ across
    found = []
    for (depth, image), (u, v) in zip(views, maps, strict=True):
        rgb: Any = cv2.remap(image.rgb, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        grey: Any = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
        if max(grey.shape) > FULL_SIZE_SAMPLES:
            half = (grey.shape[1] // 2, grey.shape[0] // 2)
            grey = cv2.resize(grey, half, interpolation=cv2.INTER_AREA)
        found.append(RectifiedView(image, depth, rgb, grey))
    return found


def _interpolation(count: int) -> NDArray[np.float32]:
    """Weights (count, knots) of linear interpolation between the knots of the grid."""
    at = np.arange(count) * (_CELLS / (count - 1))
    return np.asarray(np.maximum(0.0, 1 - np.abs(at[:, None] - _KNOTS)), np.float32)
