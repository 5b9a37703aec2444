"""One textured quad as it falls on the canvas."""

from dataclasses import dataclass

import cv2
import numpy as np

from recordings.drives.arrays import Floats, Singles
from recordings.drives.camera import CameraModel
from recordings.drives.geometry import clip_near, polygon_area
from recordings.drives.parts import Quad
from recordings.drives.poses import TimedPose

NEAR_M = 0.4
_BORDER = 2  # empty texels around a texture, so that its edges are blended
_SMALLEST_PX = 0.02


@dataclass(frozen=True, slots=True)
class Layer:
    """Where a quad lies on the canvas, its premultiplied RGBA there, and its projected area (px^2)."""

    rows: slice
    columns: slice
    rgba: Singles
    area: float


@dataclass(frozen=True, slots=True)
class Air:
    """Haze between the camera and a quad: its colour (3,) and the distance of 1/e visibility (m)."""

    haze: Singles
    haze_m: float


@dataclass(frozen=True, slots=True)
class _Sheet:
    """A quad made at least one pixel wide and tall, the more transparent the more it was widened."""

    origin: Floats
    u: Floats
    v: Floats
    wide: float
    tall: float
    opacity: float


def _widened(quad: Quad, wide: float, tall: float, thin: bool) -> _Sheet:
    """Keep thin things, like wires, visible; `wide` and `tall` are their size in pixels."""
    origin, u, v, opacity = quad.origin, quad.u, quad.v, 1.0
    if thin and wide < 1.0:
        origin, u, opacity, wide = origin - u * (1 / wide - 1) / 2, u / wide, opacity * wide, 1.0
    if thin and tall < 1.0:
        origin, v, opacity, tall = origin - v * (1 / tall - 1) / 2, v / tall, opacity * tall, 1.0
    return _Sheet(origin, u, v, wide, tall, opacity)


def _size(pixels: Floats, whole: bool) -> tuple[float, float]:
    """Width and height of a projected quad; the longest edge for both if it was clipped."""
    edges = np.linalg.norm(np.diff(pixels, axis=0, append=pixels[:1]), axis=1)
    if whole:
        return max(edges[0], edges[2]), max(edges[1], edges[3])
    return float(edges.max()), float(edges.max())


def make_layer(
    camera: CameraModel, pose: TimedPose, quad: Quad, light: Singles, air: Air, *, thin: bool
) -> Layer | None:
    """A quad warped to the canvas, lit and hazy; None where it is out of view."""
    local = pose.to_camera(quad.corners())
    if local[:, 2].max() < NEAR_M:
        return None
    whole = bool(local[:, 2].min() > NEAR_M)
    outline = local if whole else clip_near(local, NEAR_M)
    if len(outline) < 3:
        return None
    pixels = camera.on_canvas(outline)
    x0, y0 = (int(v) for v in np.floor(np.clip(pixels.min(axis=0) - 2, 0, 1e6)))
    x1 = int(min(camera.canvas_width, np.ceil(pixels[:, 0].max()) + 3))
    y1 = int(min(camera.canvas_height, np.ceil(pixels[:, 1].max()) + 3))
    if x1 <= x0 or y1 <= y0:
        return None
    wide, tall = _size(pixels, whole)
    if min(wide, tall) < _SMALLEST_PX:
        return None
    sheet = _widened(quad, wide, tall, thin)
    distance = np.linalg.norm(local.mean(axis=0))
    clear = np.float32(np.exp(-distance / air.haze_m))
    texels = _shaded(quad, sheet, light * clear, air.haze * (1 - clear))
    inverse = _texels_from_canvas(camera, pose, sheet, texels)
    if inverse is None:
        return None
    patch = cv2.warpPerspective(
        texels,
        inverse @ np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1.0]]),
        (x1 - x0, y1 - y0),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
    )
    rgba = np.asarray(patch, np.float32)
    return Layer(slice(y0, y1), slice(x0, x1), rgba, polygon_area(pixels))


def _shaded(quad: Quad, sheet: _Sheet, light: Singles, haze: Singles) -> Singles:
    """Texture of a quad with an empty border, reduced to its size, lit, with haze before it."""
    texels = quad.texture.sized(max(1, int(np.ceil(sheet.wide))), max(1, int(np.ceil(sheet.tall))))
    opacity = np.float32(sheet.opacity)
    rows, columns = texels.shape[:2]
    shaded = np.zeros((rows + 2 * _BORDER, columns + 2 * _BORDER, 4), np.float32)
    inner = shaded[_BORDER:-_BORDER, _BORDER:-_BORDER]
    inner[..., 3] = texels[..., 3] * opacity
    inner[..., :3] = texels[..., :3] * (light * opacity)
    inner[..., :3] += inner[..., 3:] * haze
    return shaded


def _texels_from_canvas(
    camera: CameraModel, pose: TimedPose, sheet: _Sheet, texels: Singles
) -> Floats | None:
    """Homography from canvas pixels to texels with border, None for a quad seen from its edge."""
    to_camera = pose.rotation.T
    axes = (to_camera @ sheet.u, to_camera @ sheet.v, to_camera @ (sheet.origin - pose.position))
    to_canvas = camera.canvas_matrix @ np.column_stack(axes)
    if abs(np.linalg.det(to_canvas)) < 1e-9:
        return None
    rows, columns = (n - 2 * _BORDER for n in texels.shape[:2])
    shift = _BORDER - 0.5
    to_texels = np.array([[columns, 0, shift], [0, rows, shift], [0, 0, 1.0]])
    homography: Floats = to_texels @ np.linalg.inv(to_canvas)
    return homography
