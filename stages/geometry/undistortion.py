"""Undistortion of points (report chapter 6: points are undistorted, never images).

Three kinds of coordinates: pixels as recorded (distorted), ideal pixels (same camera matrix, no distortion) and
rays (x/z, y/z) of the camera frame.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera
from wayside.stages.kernels import Array, compiled, shaped

ITERATIONS = 20
"""Of the undistortion of a point; each leaves a tenth of its error, at the border of wide lenses a third."""


def ideal_points(camera: Camera, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Ideal pixels (n, 2) of recorded pixels (n, 2).

    Raises ValueError where `points` is not (n, 2).
    """
    pixels = shaped(points, (-1, 2))
    ideal = pixels.copy()
    if any(camera.distortion[12:]):  # the sensor is tilted
        for _ in range(ITERATIONS):
            ideal += pixels - distort_points(camera, ideal)
    elif camera.distortion:
        lens = np.array([*camera.distortion, *[0.0] * 12][:12])
        _undistort((camera.fx, camera.fy, camera.cx, camera.cy), lens, ideal)
    return ideal


def distort_points(camera: Camera, ideal: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Recorded pixels (n, 2) of ideal pixels (n, 2): the inverse of `ideal_points`, in closed form."""
    pixels = shaped(ideal, (-1, 2)).copy()
    if len(pixels) == 0 or not camera.distortion:
        return pixels
    rays = np.concatenate([rays_of_ideal(camera, pixels), np.ones((len(pixels), 1))], axis=1)
    still, lens = np.zeros(3), (camera.matrix, np.array(camera.distortion))
    projected, _ = cv2.projectPoints(rays[:, None], still, still, *lens)
    return np.asarray(projected, np.float64).reshape(-1, 2)


def rays_of_ideal(camera: Camera, ideal: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Rays (n, 2) as (x/z, y/z) of ideal pixels (n, 2)."""
    return (shaped(ideal, (-1, 2)) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)


def ideal_of_rays(camera: Camera, rays: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Ideal pixels (n, 2) of rays (n, 2)."""
    return shaped(rays, (-1, 2)) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def to_rays(camera: Camera, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Rays (n, 2) as (x/z, y/z) of recorded pixels (n, 2)."""
    return rays_of_ideal(camera, ideal_points(camera, points))


@compiled
def _undistort(matrix: tuple[float, ...], lens: Array, points: Array) -> None:
    # Fixed-point iteration on OpenCV's model of a lens, as in its undistortPoints.
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = lens
    fx, fy, cx, cy = matrix
    u, v = (points[:, 0] - cx) / fx, (points[:, 1] - cy) / fy
    across, below = u.copy(), v.copy()
    for _ in range(ITERATIONS):
        for i in range(len(u)):
            x, y = across[i], below[i]
            r = x * x + y * y
            scale = (1 + r * (k4 + r * (k5 + r * k6))) / (1 + r * (k1 + r * (k2 + r * k3)))
            du = 2 * p1 * x * y + p2 * (r + 2 * x * x) + r * (s1 + r * s2)
            dv = p1 * (r + 2 * y * y) + 2 * p2 * x * y + r * (s3 + r * s4)
            if not 0.0 < scale < 9.0:  # of no lens: beyond its border, the point stays as recorded
                du, dv, scale = 0.0, 0.0, 1.0
            across[i], below[i] = (u[i] - du) * scale, (v[i] - dv) * scale
    points[:, 0], points[:, 1] = across * fx + cx, below * fy + cy
