"""Undistortion of points (report chapter 6: points are undistorted, never images).

Three kinds of coordinates: pixels as recorded (distorted), ideal pixels (same camera matrix, no distortion) and
rays (x/z, y/z) of the camera frame.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera

_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 1e-6)


def ideal_points(camera: Camera, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Ideal pixels (n, 2) of recorded pixels (n, 2).

    Raises ValueError where `points` is not (n, 2).
    """
    pixels = _columns(points)
    if len(pixels) == 0 or not camera.distortion:
        return pixels
    return _undistort(pixels, camera).reshape(-1, 2)


def distort_points(camera: Camera, ideal: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Recorded pixels (n, 2) of ideal pixels (n, 2): the inverse of `ideal_points`, in closed form."""
    pixels = _columns(ideal)
    if len(pixels) == 0 or not camera.distortion:
        return pixels
    rays = np.concatenate([rays_of_ideal(camera, pixels), np.ones((len(pixels), 1))], axis=1)
    still = np.zeros(3)
    projected, _ = cv2.projectPoints(
        rays[:, None], still, still, camera.matrix, np.array(camera.distortion)
    )
    return np.asarray(projected, np.float64).reshape(-1, 2)


def rays_of_ideal(camera: Camera, ideal: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Rays (n, 2) as (x/z, y/z) of ideal pixels (n, 2)."""
    return (_columns(ideal) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)


def ideal_of_rays(camera: Camera, rays: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Ideal pixels (n, 2) of rays (n, 2)."""
    return _columns(rays) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def to_rays(camera: Camera, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Rays (n, 2) as (x/z, y/z) of recorded pixels (n, 2)."""
    return rays_of_ideal(camera, ideal_points(camera, points))


def _undistort(pixels: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    arguments = (pixels[:, None], camera.matrix, np.array(camera.distortion))
    # OpenCV 4 takes the termination criteria in a function of its own, version 5 in undistortPoints.
    if hasattr(cv2, "undistortPointsIter"):
        result = cv2.undistortPointsIter(*arguments, None, camera.matrix, _STOP)
    else:
        result = cv2.undistortPoints(*arguments, R=None, P=camera.matrix, criteria=_STOP)
    return np.asarray(result, np.float64)


def _columns(points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    array = np.array(points, np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"points of shape {array.shape} instead of (n, 2)")
    return array
