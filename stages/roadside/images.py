"""Images without lens distortion, from the horizon down, and samples of them on the ground."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from wayside.schemas.frame import Camera, Pose
from wayside.schemas.motion import Motion
from wayside.stages.geometry import ideal_points
from wayside.stages.kernels import Array, Bytes, Floats, compiled, require_array

LEVELS = 3
"""Sizes of an image, each half of the one before: near ground is sampled in a small one, without aliasing."""
WIDEST = 1.6
"""Largest width of the image without distortion over that of the recorded one."""
FEWEST_SEEN = 0.6
"""Part of a patch that both images must show."""
_EDGE = 9
"""Points along an edge of the image that its bounds are taken from."""


@dataclass(frozen=True, slots=True)
class GroundImage:
    """An image from the horizon down, without distortion; grey 0 lies outside of the recorded image."""

    frame: int
    """Index in the log."""
    motion: Motion
    """Of the camera."""
    matrix: Array
    """From rays of the camera to pixels of the largest size, (3, 3)."""
    sizes: tuple[Bytes, ...] = field(repr=False)
    """Grey, (rows, columns) each, the largest first."""

    def ahead(self, place: Pose) -> float:
        """How far a place, its axis along the road first, lies ahead of the camera, metres."""
        return float((place.centre - self.motion.pose.centre) @ place.rotation[:, 0])

    def level(self, metres: float, wanted: float) -> int:
        """The smallest size in which a pixel covers at most `wanted` metres; `metres`: with a focal length of 1 px."""
        covered = metres / float(self.matrix[1, 1])
        return int(np.clip(np.log2(wanted / covered), 0, len(self.sizes) - 1))

    def samples(self, place: Pose, along: Array, right: Array, up: Array, level: int) -> Floats:
        """Grey (k, m) at k lines along the road of m points each; nan outside of the image.

        `place`: origin, metres, and columns of the axes along, right and up, in the frame of the drive.
        `along` (m,), `right`, `up` (k,): offsets along these axes, metres. `level`: which of the sizes.
        """
        to_camera = self.motion.pose.rotation.T
        shift = to_camera @ (place.centre - self.motion.pose.centre)
        outer = np.column_stack([to_camera @ place.rotation, shift])
        scale, half = 0.5**level, (0.5**level - 1) / 2
        smaller = np.array([[scale, 0, half], [0, scale, half], [0, 0, 1]])
        projection = np.ascontiguousarray(smaller @ self.matrix @ outer)
        require_array(along, "along", np.float64, (None,))
        require_array(right, "right", np.float64, (None,))
        require_array(up, "up", np.float64, right.shape)
        return _samples(self.sizes[level], projection, along, right, up)


def ground_image(grey: Bytes, camera: Camera, frame: int, motion: Motion) -> GroundImage:
    """The lower part of a recorded image (height, width), without distortion, in `LEVELS` sizes."""
    first, second, matrix = _maps(camera)
    inside = np.maximum(grey, 1)
    whole = cv2.remap(inside, first, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    sizes = [np.asarray(whole, np.uint8)]
    while len(sizes) < LEVELS:
        rows, columns = (n // 2 for n in sizes[-1].shape)
        even = sizes[-1][: 2 * rows, : 2 * columns]
        half = cv2.resize(even, (columns, rows), interpolation=cv2.INTER_AREA)
        sizes.append(np.asarray(half, np.uint8))
    return GroundImage(frame, motion, matrix, tuple(sizes))


@lru_cache(maxsize=4)
def _maps(camera: Camera) -> tuple[Any, Any, Array]:
    """Maps of `cv2.remap` from a recorded image, and the matrix (3, 3) of the image that they make."""
    right, bottom = camera.width - 1.0, camera.height - 1.0
    rows = np.linspace(np.clip(camera.cy, 0, bottom - LEVELS), bottom, _EDGE)
    edges = (0.0, rows), (right, rows), (np.linspace(0, right, _EDGE), bottom)
    left, last, foot = (
        ideal_points(camera, np.stack(np.broadcast_arrays(*edge), axis=-1)) for edge in edges
    )
    spare = (WIDEST - 1) / 2 * camera.width
    x0 = np.floor(max(left[:, 0].min(), -spare))
    x1 = np.ceil(min(last[:, 0].max(), right + spare))
    y0, y1 = np.floor(rows[0]), np.ceil(min(foot[:, 1].max(), bottom + spare))
    matrix = np.array([[1, 0, -x0], [0, 1, -y0], [0, 0, 1]]) @ camera.matrix
    lens, size = np.array(camera.distortion or (0.0,) * 4), (int(x1 - x0) + 1, int(y1 - y0) + 1)
    maps = cv2.initUndistortRectifyMap(camera.matrix, lens, None, matrix, size, cv2.CV_16SC2)
    return maps[0], maps[1], matrix


@compiled
def _samples(image: Bytes, projection: Array, along: Array, right: Array, up: Array) -> Floats:
    rows, columns = image.shape
    out = np.full((len(right), len(along)), np.nan, np.float32)
    for i in range(len(right)):
        line = projection[:, 1] * right[i] + projection[:, 2] * up[i] + projection[:, 3]
        for j in range(len(along)):
            depth = line[2] + projection[2, 0] * along[j]
            if depth < 1.0:
                continue
            u = (line[0] + projection[0, 0] * along[j]) / depth
            v = (line[1] + projection[1, 0] * along[j]) / depth
            if not (0 <= u < columns - 1 and 0 <= v < rows - 1):
                continue
            x, y = int(u), int(v)
            a, b = np.float32(image[y, x]), np.float32(image[y, x + 1])
            c, d = np.float32(image[y + 1, x]), np.float32(image[y + 1, x + 1])
            if min(a, b, c, d) == 0:
                continue
            s, t = np.float32(u - x), np.float32(v - y)
            upper, lower = a + (b - a) * s, c + (d - c) * s
            out[i, j] = upper + (lower - upper) * t
    return out


def agreement(first: Floats, second: Floats) -> Floats:
    """Correlation (p,) of the samples of p patches in two images; nan where too few are seen in both.

    `first`, `second` (p, k, m): k lines along the road of m points. The mean of each line is taken out of it: an error
    of the height moves a patch along the road, so that lines painted along it say nothing.
    """
    require_array(first, "first", np.float32, (None, None, None))
    require_array(second, "second", np.float32, first.shape)
    return _agreement(first, second)


@compiled
def _agreement(first: Floats, second: Floats) -> Floats:
    patches, lines, points = first.shape
    out = np.full(patches, np.nan, np.float32)
    for p in range(patches):
        seen, ab, aa, bb = 0, 0.0, 0.0, 0.0
        for k in range(lines):
            n, sa, sb, sab, saa, sbb = 0, 0.0, 0.0, 0.0, 0.0, 0.0
            for m in range(points):
                a, b = first[p, k, m], second[p, k, m]
                if np.isnan(a) or np.isnan(b):
                    continue
                n += 1
                sa, sb = sa + a, sb + b
                sab, saa, sbb = sab + a * b, saa + a * a, sbb + b * b
            if n > 0:
                seen += n
                ab, aa, bb = ab + sab - sa * sb / n, aa + saa - sa * sa / n, bb + sbb - sb * sb / n
        if seen >= FEWEST_SEEN * lines * points and aa > 0 and bb > 0:
            out[p] = ab / np.sqrt(aa * bb)
    return out
