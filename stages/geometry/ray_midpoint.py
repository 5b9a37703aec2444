"""Midpoint triangulation of two rays and its reprojection residuals in both images (report chapter 7)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, shaped

Floats = NDArray[np.floating[Any]]

SMALLEST_SINE = 1e-6
"""Rays whose angle has a smaller sine count as parallel (numerical guard)."""


class Midpoints(NamedTuple):
    """Midpoints of ray pairs.

    `point` (n, 3), nan where the rays are parallel. `gap` (n,): length of the shortest segment between the rays, same
    unit. `along` (n, 2): distances of its ends along the two rays, not positive where the point lies behind the camera.
    """

    point: Array
    gap: Array
    along: Array

    @property
    def ahead(self) -> NDArray[np.bool_]:
        """Points (n,) that exist and lie ahead of both cameras."""
        return np.asarray((self.along > 0).all(axis=1))


def pair_midpoint(previous: Floats, current: Floats, rotation: Floats, centre: Floats) -> Midpoints:
    """Midpoints of the shortest segments between rays (n, 2), as (x/z, y/z), of two images (report eqs. 7.1 to 7.4).

    In the axes of the first camera. `rotation` (3, 3) and `centre` (3,): pose of the second camera in them. nan where
    the rays are parallel (q1 x q2 = 0), as at the focus of expansion. Without a baseline all meet at the common centre.
    Raises ValueError where the shapes do not fit.
    """
    n, ones = len(previous), np.ones((len(previous), 1))
    first, second = (np.hstack([shaped(rays, (n, 2)), ones]) for rays in (previous, current))
    second = second @ shaped(rotation, (3, 3)).T
    point, gap, along = np.empty((n, 3)), np.empty(n), np.empty((n, 2))
    meet_rays(np.zeros(3), shaped(centre, (3,)), first, second, point, gap, along)
    return Midpoints(point, gap, along)


def points_of_second(previous: Floats, current: Floats, rotation: Floats, centre: Floats) -> Array:
    """Midpoints (n, 3) of `pair_midpoint` in the axes of the second camera, nan where not ahead of both."""
    found = pair_midpoint(previous, current, rotation, centre)
    points = (found.point - centre) @ rotation
    points[~found.ahead] = np.nan
    return np.asarray(points)


def pair_residual(
    previous: Floats,
    current: Floats,
    rotation: Floats,
    direction: Floats,
    focal_px: tuple[float, float],
) -> Array:
    """Sum of the four squared pixel differences of each midpoint's projections (report eqs. 7.5, 7.6).

    `previous`, `current`: rays (n, 2) as (x/z, y/z). `rotation` (3, 3), `direction` (3,): of the current camera in the
    previous one's frame; the direction may have any length. `focal_px`: fx and fy. The report's single f assumes
    square, undistorted pixels.

    Returns (n,) px squared. Where the rays do not meet ahead of both cameras the point is taken at infinity, the
    nearest valid position, with its residual divided between both images.
    """
    first, second = np.asarray(previous, np.float64), np.asarray(current, np.float64)
    axes = np.asarray(rotation, np.float64)
    found = pair_midpoint(first, second, axes, direction)
    local = (found.point - direction) @ axes
    with np.errstate(divide="ignore", invalid="ignore"):
        residuals = np.hstack(
            [found.point[:, :2] / found.point[:, 2:] - first, local[:, :2] / local[:, 2:] - second]
        )
        far = first @ axes[:2] + axes[2]
        far_residual = far[:, :2] / far[:, 2:] - second
    near = found.ahead & (found.point[:, 2] > 0) & (local[:, 2] > 0)
    squares = ((residuals * (*focal_px, *focal_px)) ** 2).sum(axis=1)
    distant = 0.5 * ((far_residual * focal_px) ** 2).sum(axis=1)
    return np.asarray(np.where(near, squares, distant))


@compiled
def meet_rays(
    c0: Array, c1: Array, d0: Array, d1: Array, point: Array, gap: Array, along: Array
) -> None:
    """Kernel of `pair_midpoint`, for other kernels: fills point (n, 3), gap (n,), along (n, 2)."""
    x, y, z = c1[0] - c0[0], c1[1] - c0[1], c1[2] - c0[2]
    for i in range(d0.shape[0]):
        p, q = d0[i], d1[i]
        # (7.1) q3 = q1 x q2, at right angles to both rays
        n0 = p[1] * q[2] - p[2] * q[1]
        n1 = p[2] * q[0] - p[0] * q[2]
        n2 = p[0] * q[1] - p[1] * q[0]
        square = n0 * n0 + n1 * n1 + n2 * n2
        pp = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
        qq = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
        if not square > SMALLEST_SINE * SMALLEST_SINE * pp * qq:
            point[i] = np.nan
            along[i] = np.nan
            gap[i] = np.nan
            continue
        # (7.2), (7.3) C1 + g1 q1 + g3 q3 = C2 + g2 q2, solved by Cramer's rule
        g1 = (
            (y * q[2] - z * q[1]) * n0 + (z * q[0] - x * q[2]) * n1 + (x * q[1] - y * q[0]) * n2
        ) / square
        g2 = (
            (y * p[2] - z * p[1]) * n0 + (z * p[0] - x * p[2]) * n1 + (x * p[1] - y * p[0]) * n2
        ) / square
        g3 = (x * n0 + y * n1 + z * n2) / square
        # (7.4) f = C1 + g1 q1 + (g3 / 2) q3
        point[i, 0] = c0[0] + g1 * p[0] + 0.5 * g3 * n0
        point[i, 1] = c0[1] + g1 * p[1] + 0.5 * g3 * n1
        point[i, 2] = c0[2] + g1 * p[2] + 0.5 * g3 * n2
        gap[i] = abs(g3) * np.sqrt(square)
        along[i, 0] = g1 * np.sqrt(pp)
        along[i, 1] = g2 * np.sqrt(qq)
