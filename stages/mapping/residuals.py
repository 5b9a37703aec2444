"""Residuals of a window of frames with their derivatives: sights of points, ties between frames, known steps.

A tie is a registered patch. It does not say where a point is; it says which place of one picture another shows: a map,
to first order an affine one. So its residual is where the point lies in the later frame less where the map sends its
place in the earlier one. That is what carries a point over three frames, though each step is registered from a whole
pixel and ends between pixels: the next step starts at the nearest corner, a pixel or less beside, and its map takes the
difference along. Errors of a chain of ties stay those of its links, independent of each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import rotation_from_vector, vector_from_rotation
from wayside.stages.kernels import Array, compiled, require_array

QUADRATIC = 1e6
"""Scale of a cost that does not flatten."""
BEHIND = 1e12
NEAREST = 1e-3


class ResidualBlocks(NamedTuple):
    """Residuals of points: ties, and plain sights, which have no earlier place.

    frames (m, 2): earlier and later frame (a sight: twice its own); point (m,); source, target (m, 2): rays (x/z, y/z)
    of the patch in both; warp (m, 3): stretch along u, shear of u by v, stretch along v from the earlier to the later
    picture (a sight: 0); sigma (m,): of the target, unit of the rays; scale (m,): sigmas where the Cauchy cost starts
    to flatten.
    """

    frames: NDArray[np.int64]
    point: NDArray[np.int64]
    source: Array
    target: Array
    warp: Array
    sigma: Array
    scale: Array

    @staticmethod
    def sights(
        frame: NDArray[np.int64], point: NDArray[np.int64], ray: Array, sigma: Array, scale: float
    ) -> ResidualBlocks:
        """Plain sights of points in frames."""
        n = len(frame)
        return ResidualBlocks(
            np.column_stack([frame, frame]),
            point,
            np.zeros((n, 2)),
            np.ascontiguousarray(ray, np.float64),
            np.zeros((n, 3)),
            np.ascontiguousarray(sigma, np.float64),
            np.full(n, scale),
        )

    @staticmethod
    def joined(parts: list[ResidualBlocks]) -> ResidualBlocks:
        """All rows of some parts, in order."""
        return ResidualBlocks(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def checked(self, frames: int, points: int) -> ResidualBlocks:
        """The same, refused where compiled code would read beside an array."""
        m = len(self.frames)
        require_array(self.frames, "frames", np.int64, (m, 2))
        require_array(self.point, "point", np.int64, (m,))
        require_array(self.source, "source", np.float64, (m, 2))
        require_array(self.target, "target", np.float64, (m, 2))
        require_array(self.warp, "warp", np.float64, (m, 3))
        require_array(self.sigma, "sigma", np.float64, (m,))
        require_array(self.scale, "scale", np.float64, (m,))
        _require_below(self.frames, "frames", frames)
        _require_below(self.point, "point", points)
        return self


class StepConstraints(NamedTuple):
    """What is known of steps beforehand, as in `numerics.epipolar.Prior`, and how long they are.

    frames (l, 2): from, to; rotation (l, 3, 3), sigma_rotation (l,) rad, inf: unknown; direction (l, 3) of travel,
    sigma_direction (l, 2) as slopes; halfway (l,): in the axes half way through the turn; length, sigma_length (l,) m.
    """

    frames: NDArray[np.int64]
    rotation: Array
    sigma_rotation: Array
    direction: Array
    sigma_direction: Array
    halfway: NDArray[np.bool_]
    length: Array
    sigma_length: Array

    def checked(self, frames: int) -> StepConstraints:
        """The same, refused where compiled code would read beside an array."""
        n = len(self.frames)
        require_array(self.frames, "frames", np.int64, (n, 2))
        require_array(self.rotation, "rotation", np.float64, (n, 3, 3))
        require_array(self.sigma_rotation, "sigma_rotation", np.float64, (n,))
        require_array(self.direction, "direction", np.float64, (n, 3))
        require_array(self.sigma_direction, "sigma_direction", np.float64, (n, 2))
        require_array(self.halfway, "halfway", np.bool_, (n,))
        require_array(self.length, "length", np.float64, (n,))
        require_array(self.sigma_length, "sigma_length", np.float64, (n,))
        _require_below(self.frames, "frames", frames)
        return self


class PointAnchors(NamedTuple):
    """Where the coordinates of points start from: rotation (p, 3, 3) and centre (p, 3) of a camera that sees each.

    A point is (a, b, rho): the ray (a, b, 1) of that camera, as it stood at the start, and one over its depth there.
    The camera moves on while the chart stays, so a point depends on no pose.
    """

    rotation: Array
    centre: Array


def _require_below(numbers: NDArray[np.int64], name: str, count: int) -> None:
    if len(numbers) and not (0 <= numbers.min() and numbers.max() < count):
        raise ValueError(
            f"{name}: wanted numbers from 0 to {count - 1}, found {numbers.min()} to {numbers.max()}"
        )


@compiled
def project(
    rotation: Array, centre: Array, chart_r: Array, chart_c: Array, point: Array, ray: Array
) -> bool:
    """Ray (2,) of a point in a camera (eq. 7.6); False where it lies behind."""
    v0 = chart_r[0, 0] * point[0] + chart_r[0, 1] * point[1] + chart_r[0, 2]
    v1 = chart_r[1, 0] * point[0] + chart_r[1, 1] * point[1] + chart_r[1, 2]
    v2 = chart_r[2, 0] * point[0] + chart_r[2, 1] * point[1] + chart_r[2, 2]
    v0 += point[2] * (chart_c[0] - centre[0])
    v1 += point[2] * (chart_c[1] - centre[1])
    v2 += point[2] * (chart_c[2] - centre[2])
    z = rotation[0, 2] * v0 + rotation[1, 2] * v1 + rotation[2, 2] * v2
    ahead: bool = z > NEAREST
    z = max(z, NEAREST)
    ray[0] = (rotation[0, 0] * v0 + rotation[1, 0] * v1 + rotation[2, 0] * v2) / z
    ray[1] = (rotation[0, 1] * v0 + rotation[1, 1] * v1 + rotation[2, 1] * v2) / z
    return ahead


@compiled
def project_jacobian(
    rotation: Array, centre: Array, chart_r: Array, chart_c: Array, point: Array, slopes: Array
) -> None:
    """Derivatives (2, 9) of `project`: by a turn (rad, world axes), by the centre, by the point."""
    r, rho = rotation, point[2]
    a0, a1, a2 = chart_c[0] - centre[0], chart_c[1] - centre[1], chart_c[2] - centre[2]
    v0 = chart_r[0, 0] * point[0] + chart_r[0, 1] * point[1] + chart_r[0, 2] + rho * a0
    v1 = chart_r[1, 0] * point[0] + chart_r[1, 1] * point[1] + chart_r[1, 2] + rho * a1
    v2 = chart_r[2, 0] * point[0] + chart_r[2, 1] * point[1] + chart_r[2, 2] + rho * a2
    z = max(r[0, 2] * v0 + r[1, 2] * v1 + r[2, 2] * v2, NEAREST)
    for i in range(2):
        # by the point's place v, world axes; a turn w of the camera moves it against the axes by v x w
        slope = (r[0, i] * v0 + r[1, i] * v1 + r[2, i] * v2) / z
        g0 = (r[0, i] - slope * r[0, 2]) / z
        g1 = (r[1, i] - slope * r[1, 2]) / z
        g2 = (r[2, i] - slope * r[2, 2]) / z
        slopes[i, 0], slopes[i, 1], slopes[i, 2] = (
            g1 * v2 - g2 * v1,
            g2 * v0 - g0 * v2,
            g0 * v1 - g1 * v0,
        )
        slopes[i, 3], slopes[i, 4], slopes[i, 5] = -rho * g0, -rho * g1, -rho * g2
        slopes[i, 6] = g0 * chart_r[0, 0] + g1 * chart_r[1, 0] + g2 * chart_r[2, 0]
        slopes[i, 7] = g0 * chart_r[0, 1] + g1 * chart_r[1, 1] + g2 * chart_r[2, 1]
        slopes[i, 8] = g0 * a0 + g1 * a1 + g2 * a2


@compiled
def block_residuals(
    rotations: Array,
    centres: Array,
    charts: PointAnchors,
    points: Array,
    rows: ResidualBlocks,
    gaps: Array,
) -> None:
    """Residuals (m, 2) in sigmas; very large where a point lies behind a camera."""
    before, now = np.empty(2), np.empty(2)
    for i in range(rows.point.shape[0]):
        n, first, second = rows.point[i], rows.frames[i, 0], rows.frames[i, 1]
        chart_r, chart_c = charts.rotation[n], charts.centre[n]
        seen = project(rotations[second], centres[second], chart_r, chart_c, points[n], now)
        seen &= project(rotations[first], centres[first], chart_r, chart_c, points[n], before)
        if not seen:
            gaps[i] = BEHIND
            continue
        u, v = before[0] - rows.source[i, 0], before[1] - rows.source[i, 1]
        w = rows.warp[i]
        gaps[i, 0] = (now[0] - rows.target[i, 0] - w[0] * u - w[1] * v) / rows.sigma[i]
        gaps[i, 1] = (now[1] - rows.target[i, 1] - w[2] * v) / rows.sigma[i]


@compiled
def block_jacobian(
    rotations: Array,
    centres: Array,
    charts: PointAnchors,
    points: Array,
    rows: ResidualBlocks,
    i: int,
    work: Array,
    slopes: Array,
    by_point: Array,
) -> None:
    """Derivatives of residual i, in sigmas: (2, 12) by both its poses, earlier first, and (2, 3) by its point.

    work (2, 2, 9): scratch.
    """
    n, first, second = rows.point[i], rows.frames[i, 0], rows.frames[i, 1]
    chart_r, chart_c = charts.rotation[n], charts.centre[n]
    early, late = work[0], work[1]
    project_jacobian(rotations[second], centres[second], chart_r, chart_c, points[n], late)
    if first == second:
        early[:] = 0.0
    else:
        project_jacobian(rotations[first], centres[first], chart_r, chart_c, points[n], early)
    w0, w1, w2 = rows.warp[i, 0], rows.warp[i, 1], rows.warp[i, 2]
    weight = 1.0 / rows.sigma[i]
    for k in range(6):
        slopes[0, k] = -weight * (w0 * early[0, k] + w1 * early[1, k])
        slopes[1, k] = -weight * w2 * early[1, k]
        slopes[0, 6 + k] = weight * late[0, k]
        slopes[1, 6 + k] = weight * late[1, k]
    for k in range(3):
        by_point[0, k] = weight * (late[0, 6 + k] - w0 * early[0, 6 + k] - w1 * early[1, 6 + k])
        by_point[1, k] = weight * (late[1, 6 + k] - w2 * early[1, 6 + k])


@compiled
def constraint_residuals(
    rotations: Array, centres: Array, links: StepConstraints, gaps: Array
) -> None:
    """Distances (l, 6) to what is known of each step, in sigmas: turn, direction sideways and up, length."""
    travel, half = np.empty(3), np.empty(3)
    for i in range(links.frames.shape[0]):
        first, second = links.frames[i, 0], links.frames[i, 1]
        turned = _product(rotations[first].T, rotations[second])
        _travel(rotations[first], centres[first], centres[second], travel)
        turn = vector_from_rotation(_product(turned, links.rotation[i].T))
        expected = links.direction[i].copy()
        if links.halfway[i]:
            whole = vector_from_rotation(turned)
            for k in range(3):
                half[k] = 0.5 * whole[k]
            _turn(rotation_from_vector(half), expected)
        for k in range(3):
            gaps[i, k] = turn[k] / links.sigma_rotation[i]
        for k in range(2):
            slope = travel[k] / travel[2] - expected[k] / expected[2]
            gaps[i, 3 + k] = slope / links.sigma_direction[i, k]
        length = np.sqrt(travel[0] ** 2 + travel[1] ** 2 + travel[2] ** 2)
        gaps[i, 5] = (length - links.length[i]) / links.sigma_length[i]


@compiled
def constraint_jacobian(
    rotations: Array, centres: Array, links: StepConstraints, i: int, slopes: Array
) -> None:
    """Derivatives (6, 12) of the distances of link i by both poses, first one first.

    A turn d of the later camera against the earlier one moves the logarithm e of their rotation by Jl(e)^-1 d, Jl
    being the left Jacobian, and the rotation half way, H, by (1 + H)^-1 d, which is (1 - [c]x) / 2 with c the axis
    times the tangent of a quarter of the angle (Cayley).
    """
    first, second = links.frames[i, 0], links.frames[i, 1]
    back = rotations[first].T.copy()
    turned = _product(back, rotations[second])
    travel, away, half, bent = np.empty(3), np.empty(3), np.empty(3), np.zeros((3, 3))
    _travel(rotations[first], centres[first], centres[second], travel)
    for k in range(3):
        away[k] = centres[second, k] - centres[first, k]
    swung = _product(back, cross_matrix(away))  # how the travel turns with the first camera
    gap = vector_from_rotation(_product(turned, links.rotation[i].T))
    turning = _product(_inverse_left(gap), back)
    expected = links.direction[i].copy()
    if links.halfway[i]:
        whole = vector_from_rotation(turned)
        angle = np.sqrt(whole[0] ** 2 + whole[1] ** 2 + whole[2] ** 2)
        quarter = np.tan(angle / 4) / angle if angle > 1e-8 else 0.25
        for k in range(3):
            half[k] = 0.5 * whole[k]
            whole[k] *= quarter
        _turn(rotation_from_vector(half), expected)
        halved = cross_matrix(whole)
        for k in range(3):
            for j in range(3):
                halved[k, j] = 0.5 * ((1.0 if k == j else 0.0) - halved[k, j])
        bent = _product(_product(cross_matrix(expected), halved), back)
    length = np.sqrt(travel[0] ** 2 + travel[1] ** 2 + travel[2] ** 2)
    slopes[:] = 0.0
    for k in range(3):
        for j in range(3):
            slopes[j, 6 + k] = turning[j, k] / links.sigma_rotation[i]
            slopes[j, k] = -slopes[j, 6 + k]
        for j in range(2):
            weight = 1.0 / links.sigma_direction[i, j]
            slope, law = travel[j] / travel[2], expected[j] / expected[2]
            # the turn moves the expectation by -bent
            by_turn = -(bent[j, k] - law * bent[2, k]) / expected[2]
            by_swing = (swung[j, k] - slope * swung[2, k]) / travel[2]
            by_centre = (back[j, k] - slope * back[2, k]) / travel[2]
            slopes[3 + j, k] = weight * (by_swing + by_turn)
            slopes[3 + j, 6 + k] = -weight * by_turn
            slopes[3 + j, 9 + k] = weight * by_centre
            slopes[3 + j, 3 + k] = -weight * by_centre
        along = travel[0] * back[0, k] + travel[1] * back[1, k] + travel[2] * back[2, k]
        slopes[5, 9 + k] = along / length / links.sigma_length[i]
        slopes[5, 3 + k] = -slopes[5, 9 + k]


@compiled
def _travel(rotation: Array, start: Array, end: Array, travel: Array) -> None:
    for k in range(3):
        travel[k] = 0.0
        for j in range(3):
            travel[k] += rotation[j, k] * (end[j] - start[j])


@compiled
def _turn(rotation: Array, vector: Array) -> None:
    # The vector turned, in place.
    x, y, z = vector[0], vector[1], vector[2]
    for k in range(3):
        vector[k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z


@compiled
def _product(a: Array, b: Array) -> Array:
    result = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            result[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return result


@compiled
def cross_matrix(v: Array) -> Array:
    """Matrix (3, 3) of v x."""
    result = np.zeros((3, 3))
    result[0, 1], result[0, 2] = -v[2], v[1]
    result[1, 0], result[1, 2] = v[2], -v[0]
    result[2, 0], result[2, 1] = -v[1], v[0]
    return result


@compiled
def _inverse_left(vector: Array) -> Array:
    # Inverse of the left Jacobian (3, 3) of a rotation vector.
    angle = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if angle < 1e-4:
        share = 1.0 / 12.0
    else:
        share = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
    cross = cross_matrix(vector)
    result = _product(cross, cross)
    for i in range(3):
        for j in range(3):
            result[i, j] = share * result[i, j] - 0.5 * cross[i, j] + (1.0 if i == j else 0.0)
    return result
