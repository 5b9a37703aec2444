"""Camera model and the undistorted canvas that images are drawn on.

Camera frame: x right, y down, z forward. Pixel centres lie at integers.
"""

import numpy as np
from numpy.typing import NDArray

from recordings.drives.arrays import Floats
from recordings.drives.spec import CameraSpec

CANVAS_SCALE = 1.1
_MARGIN_PX = 3.0


class CameraModel:
    """Intrinsics, distortion and the larger pinhole canvas (`canvas_*`) that images are drawn on.

    `map_x`, `map_y` (height, width) give the canvas position of every image pixel.
    """

    def __init__(self, spec: CameraSpec) -> None:
        self.spec = spec
        columns, rows = np.meshgrid(np.arange(float(spec.width)), np.arange(float(spec.height)))
        x, y = self.undistort((columns - spec.cx) / spec.fx, (rows - spec.cy) / spec.fy)
        focal = CANVAS_SCALE * max(spec.fx, spec.fy)
        self.canvas_focal = focal
        self.canvas_cx = float(_MARGIN_PX - x.min() * focal)
        self.canvas_cy = float(_MARGIN_PX - y.min() * focal)
        self.canvas_width = int(np.ceil(x.max() * focal + self.canvas_cx + _MARGIN_PX))
        self.canvas_height = int(np.ceil(y.max() * focal + self.canvas_cy + _MARGIN_PX))
        self.map_x = (x * focal + self.canvas_cx).astype(np.float32)
        self.map_y = (y * focal + self.canvas_cy).astype(np.float32)
        self.canvas_matrix = np.array(
            [[focal, 0, self.canvas_cx], [0, focal, self.canvas_cy], [0, 0, 1]]
        )

    def canvas_columns(self) -> Floats:
        """Normalised x of the canvas columns."""
        return (np.arange(float(self.canvas_width)) - self.canvas_cx) / self.canvas_focal

    def canvas_rows(self) -> Floats:
        """Normalised y of the canvas rows."""
        return (np.arange(float(self.canvas_height)) - self.canvas_cy) / self.canvas_focal

    def on_canvas(self, points: Floats) -> Floats:
        """Canvas pixels (n, 2) of camera-frame points (n, 3) with z > 0."""
        centre = (self.canvas_cx, self.canvas_cy)
        return points[:, :2] / points[:, 2:] * self.canvas_focal + centre

    def distort(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Brown distortion of normalised coordinates (Brown 1966, as `plumb_bob`)."""
        k1, k2, p1, p2, k3 = self.spec.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def undistort(self, xd: Floats, yd: Floats) -> tuple[Floats, Floats]:
        """Inverse of `distort` by fixed-point iteration."""
        x, y = xd.astype(float), yd.astype(float)
        for _ in range(30):
            again_x, again_y = self.distort(x, y)
            x, y = x + (xd - again_x), y + (yd - again_y)
        return x, y

    def project(self, points: Floats) -> Floats:
        """Distorted pixel coordinates (n, 2) of camera-frame points (n, 3) with z > 0."""
        x, y = self.distort(points[:, 0] / points[:, 2], points[:, 1] / points[:, 2])
        return np.column_stack([x * self.spec.fx + self.spec.cx, y * self.spec.fy + self.spec.cy])

    def in_field(self, points: Floats) -> NDArray[np.bool_]:
        """Which camera-frame points (n, 3) lie where the distortion model holds, near the image."""
        z = np.maximum(points[:, 2], 1e-6)
        reach_x = max(self.canvas_cx, self.canvas_width - self.canvas_cx) / self.canvas_focal
        reach_y = max(self.canvas_cy, self.canvas_height - self.canvas_cy) / self.canvas_focal
        return (
            (points[:, 2] > 0.3)
            & (np.abs(points[:, 0]) < 1.1 * reach_x * z)
            & (np.abs(points[:, 1]) < 1.1 * reach_y * z)
        )

    def unseen(self) -> NDArray[np.bool_]:
        """Canvas pixels (canvas rows, canvas columns) that no image pixel shows."""
        x, y = np.meshgrid(self.canvas_columns(), self.canvas_rows())
        xd, yd = self.distort(x, y)
        u, v = xd * self.spec.fx + self.spec.cx, yd * self.spec.fy + self.spec.cy
        return (u < -0.5) | (v < -0.5) | (u > self.spec.width - 0.5) | (v > self.spec.height - 0.5)
