"""The unknowns of a lens, and projection with its derivatives by the ray and by these."""

from __future__ import annotations

from dataclasses import replace
from math import exp
from typing import NamedTuple

import cv2
import numpy as np

from wayside.schemas.frame import Camera
from wayside.stages.kernels import Array

LENS = ("focal", "cx", "cy", "k1", "k2")
"""Changes of a lens: logarithm of the factor of both focal lengths; principal point, px; radial distortion."""

_STEP = 1e-6
_NEAREST = 1e-3


def changed_camera(camera: Camera, lens: Array) -> Camera:
    """The camera after a change of its lens by `lens` (5,), in the order of `LENS`."""
    focal, cx, cy, k1, k2 = lens.tolist()
    d = [*camera.distortion, *[0.0] * (5 - len(camera.distortion))]
    return replace(
        camera,
        fx=camera.fx * exp(focal),
        fy=camera.fy * exp(focal),
        cx=camera.cx + cx,
        cy=camera.cy + cy,
        distortion=(d[0] + k1, d[1] + k2, *d[2:]),
    )


class Projection(NamedTuple):
    """Recorded pixels (n, 2), and their Jacobians by the ray (n, 2, 3) and by the lens (n, 2, 5)."""

    pixels: Array
    by_ray: Array
    by_lens: Array


def project(camera: Camera, rays: Array) -> Projection:
    """Project rays (n, 3) of the camera frame; those beside or behind the camera as if just ahead of it.

    The distortion has at least the two coefficients k1 and k2; differences serve as its derivatives, whatever its form.
    """
    depth = np.maximum(rays[:, 2], _NEAREST)
    plain = rays[:, :2] / depth[:, None]
    coefficients, focal = np.array(camera.distortion), np.array([camera.fx, camera.fy])
    lens = _distorted(plain, coefficients)
    by_ray = np.empty((len(rays), 2, 3))
    for i in range(2):
        moved = plain + _STEP * np.eye(2)[i]
        slope = (_distorted(moved, coefficients) - lens) / _STEP * focal
        by_ray[:, :, i] = slope / depth[:, None]
    by_ray[:, :, 2] = -(by_ray[:, :, :2] @ plain[:, :, None])[:, :, 0]
    by_lens = np.zeros((len(rays), 2, len(LENS)))
    by_lens[:, :, 0] = lens * focal
    by_lens[:, 0, 1] = by_lens[:, 1, 2] = 1.0
    for i in range(2):
        moved = coefficients + _STEP * np.eye(len(coefficients))[i]
        by_lens[:, :, 3 + i] = (_distorted(plain, moved) - lens) / _STEP * focal
    return Projection(lens * focal + (camera.cx, camera.cy), by_ray, by_lens)


def _distorted(plain: Array, coefficients: Array) -> Array:
    solid = np.column_stack([plain, np.ones(len(plain))])
    still = np.zeros(3)
    projected, _ = cv2.projectPoints(solid[:, None], still, still, np.eye(3), coefficients)
    return np.asarray(projected, np.float64).reshape(-1, 2)
