"""The unknowns of a lens, and projection with its derivatives by the ray and by these."""

from __future__ import annotations

from dataclasses import replace
from math import exp
from typing import NamedTuple

import cv2
import numpy as np

from wayside.schemas.frame import Camera
from wayside.stages.geometry import to_rays
from wayside.stages.kernels import Array

LENS = ("focal", "cx", "cy", "k1", "k2")
"""Changes of a lens: logarithm of the factor of both focal lengths; principal point, px; radial distortion."""

RADIAL = [0, 3, 4]
"""Of `LENS`, what moves points along their radius. Motion in the images says little of the principal point."""

_NEAREST = 1e-3

_RAYS = 20
"""From the axis to a corner."""


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


def displacement(camera: Camera, lens: Array) -> float:
    """Largest displacement of a point of the image by the radial part of a change of its lens (5,), to first order.

    Relative to its distance from the principal point; of rays from the axis to the farthest corner.
    """
    centre = np.array([camera.cx, camera.cy])
    corners = np.array([[x, y] for x in (0, camera.width - 1) for y in (0, camera.height - 1)])
    farthest = max(corners - centre, key=np.linalg.norm)
    arms = np.linspace(0.05, 1, _RAYS)[:, None] * farthest
    rays = np.column_stack([to_rays(camera, centre + arms), np.ones(_RAYS)])
    by_lens = project(changed_camera(camera, np.zeros(len(LENS))), rays).by_lens
    moved = by_lens[:, :, RADIAL] @ lens[RADIAL]
    return float((np.linalg.norm(moved, axis=1) / np.linalg.norm(arms, axis=1)).max())


class Projection(NamedTuple):
    """Recorded pixels (n, 2), and their Jacobians.

    `by_turn` (n, 2, 3): by a rotation of the camera (rad, its axes). `by_ray` (n, 2, 3). `by_lens` (n, 2, 5).
    """

    pixels: Array
    by_turn: Array
    by_ray: Array
    by_lens: Array


def project(camera: Camera, rays: Array) -> Projection:
    """Project rays (n, 3) of the camera frame; those beside or behind the camera as if just ahead of it.

    The distortion has at least the two coefficients k1 and k2.
    """
    solid = np.column_stack([rays[:, :2], np.maximum(rays[:, 2], _NEAREST)])
    still, coefficients = np.zeros(3), np.array(camera.distortion)
    found, slopes = cv2.projectPoints(solid, still, still, camera.matrix, coefficients)
    # Columns of OpenCV: rotation and position of the points, focal lengths, principal point, distortion.
    by: Array = np.asarray(slopes, np.float64).reshape(len(rays), 2, -1)
    scale = by[:, :, 6:8] @ np.array([[camera.fx], [camera.fy]])
    by_lens = np.concatenate([scale, by[:, :, 8 : 7 + len(LENS)]], axis=2)
    pixels = np.asarray(found, np.float64).reshape(-1, 2)
    return Projection(pixels, -by[:, :, :3], by[:, :, 3:6], by_lens)
