"""Sub-pixel registration of small patches between two images.

The patch of the farther view is the template; translation, scale, gain and bias in the nearer one are solved by
inverse-compositional Gauss-Newton (Baker and Matthews, 2004): the template's gradients serve all iterations. The error
is a seventh of that of the corners (measured).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import TieSettings
from wayside.stages.geometry import invert_symmetric
from wayside.stages.kernels import Array, compiled, require_array

RADIUS = 7
SIDE = 2 * RADIUS + 1
"""Array layout: a patch is (SIDE, SIDE) pixels."""
FREEDOM = SIDE * SIDE - 5.0
"""Pixels of a patch less the unknowns: two of position, scale, gain, bias."""


class _Limits(NamedTuple):
    """Settings of the registration, as of `TieSettings`."""

    iterations: int
    converged_px: float
    farthest_px: float
    scale_change: float
    least_texture: float
    abandoned_correlation: float
    scale_step: float


class PatchRegistration(NamedTuple):
    """Registered patches: point (n, 2) px, scale (n,) on top of the warp, zncc (n,) correlation, 0 if it failed.

    sigma (n,): standard deviation of the point along its worst direction, px of the far image, by the residual noise
    between the patches: large along an edge, where only its ends fix the position.
    """

    point: Array
    scale: Array
    zncc: Array
    sigma: Array


def register_patches(
    far: NDArray[np.uint8],
    near: NDArray[np.uint8],
    corners: NDArray[np.int64],
    starts: Array,
    warps: Array,
    search_px: int,
    settings: TieSettings,
) -> PatchRegistration:
    """Register the 15 x 15 px patches round `corners` of the far image in the near one.

    Parameters
    ----------
    far, near
        Grey images (height, width).
    corners
        Centre of each patch, (n, 2) whole pixels.
    starts
        Where the patches are expected in the near image, (n, 2) px.
    warps
        Their expected warp, (n, 3): stretch along u, shear of u by v, stretch along v. A plate seen from nearer has
        (s, 0, s), the road about (s, k, s * s).
    search_px
        Whole pixels searched round the start before the fit.
    settings
        Limits of the fit.

    Returns
    -------
    Registered
        zncc is 0 and the point nan where the patch leaves an image, has no texture, or the fit exceeds its limits.

    Raises
    ------
    ValueError
        Where an array has another shape or type.
    """
    n = len(corners)
    require_array(far, "far", np.uint8, (None, None))
    require_array(near, "near", np.uint8, (None, None))
    require_array(corners, "corners", np.int64, (n, 2))
    require_array(starts, "starts", np.float64, (n, 2))
    require_array(warps, "warps", np.float64, (n, 3))
    point, scale, zncc = np.full((n, 2), np.nan), np.ones(n), np.zeros(n)
    sigma = np.full(n, np.inf)
    limits = _Limits(
        settings.registration_iterations,
        settings.converged_px,
        settings.farthest_px,
        settings.scale_change,
        settings.least_texture,
        settings.abandoned_correlation,
        settings.scale_step,
    )
    _register(far, near, corners, starts, warps, search_px, limits, point, scale, zncc, sigma)
    return PatchRegistration(point, scale, zncc, sigma)


@compiled
def _inside(
    image: NDArray[np.uint8], u: float, v: float, warp: Array, scale: float, margin: float
) -> bool:
    # Whether a warped patch and the pixel after it lie in the image; False for nan too.
    reach_u = RADIUS * scale * (abs(warp[0]) + abs(warp[1])) + margin
    reach_v = RADIUS * scale * abs(warp[2]) + margin
    height, width = image.shape
    inside: bool = u - reach_u >= 0 and v - reach_v >= 0
    return inside and u + reach_u < width - 1 and v + reach_v < height - 1


@compiled
def _sample(
    image: NDArray[np.uint8], u: float, v: float, warp: Array, scale: float, patch: Array
) -> tuple[float, float]:
    # Bilinear (SIDE, SIDE) patch round u, v; returns its mean and the root of its sum of squares about the mean.
    total, squares = 0.0, 0.0
    step = scale * warp[0]
    for i in range(SIDE):
        y = v + scale * warp[2] * (i - RADIUS)
        row = int(y)
        fy = y - row
        start = u + scale * warp[1] * (i - RADIUS) - step * RADIUS
        for j in range(SIDE):
            x = start + step * j
            column = int(x)
            fx = x - column
            a, b = float(image[row, column]), float(image[row + 1, column])
            a += fx * (float(image[row, column + 1]) - a)
            b += fx * (float(image[row + 1, column + 1]) - b)
            value = a + fy * (b - a)
            patch[i, j] = value
            total += value
            squares += value * value
    mean = total / (SIDE * SIDE)
    return mean, np.sqrt(max(0.0, squares - total * mean))


@compiled
def _coarse(
    near: NDArray[np.uint8], template: Array, start: Array, warp: Array, search: int
) -> tuple[float, float]:
    # The whole-pixel shift of best correlation, by every second pixel of the patch.
    best, best_u, best_v = -1.0, start[0], start[1]
    if not _inside(near, start[0], start[1], warp, 1.0, search + 1.0):
        return best_u, best_v
    count, total_t, squares_t = 0, 0.0, 0.0
    for i in range(0, SIDE, 2):
        for j in range(0, SIDE, 2):
            total_t += template[i, j]
            squares_t += template[i, j] * template[i, j]
            count += 1
    spread_t = squares_t - total_t * total_t / count
    for dv in range(-search, search + 1):
        for du in range(-search, search + 1):
            total, squares, product = 0.0, 0.0, 0.0
            for i in range(0, SIDE, 2):
                row = int(start[1] + dv + warp[2] * (i - RADIUS) + 0.5)
                begin = start[0] + du + warp[1] * (i - RADIUS) + 0.5
                for j in range(0, SIDE, 2):
                    value = float(near[row, int(begin + warp[0] * (j - RADIUS))])
                    total += value
                    squares += value * value
                    product += value * template[i, j]
            spread = (squares - total * total / count) * spread_t
            if spread <= 0:
                continue
            zncc = (product - total * total_t / count) / np.sqrt(spread)
            if zncc > best:
                best, best_u, best_v = zncc, start[0] + du, start[1] + dv
    return best_u, best_v


@compiled
def _template(far: NDArray[np.uint8], u: int, v: int, template: Array) -> float:
    # The patch round a whole pixel less its mean; returns the sum of its squares.
    mean, square = 0.0, 0.0
    for i in range(SIDE):
        for j in range(SIDE):
            template[i, j] = float(far[v + i - RADIUS, u + j - RADIUS])
            mean += template[i, j]
    mean /= SIDE * SIDE
    for i in range(SIDE):
        for j in range(SIDE):
            template[i, j] -= mean
            square += template[i, j] ** 2
    return square


@compiled
def _derivatives(
    far: NDArray[np.uint8], u: int, v: int, template: Array, square: float, jacobian: Array
) -> None:
    # Derivatives by position and scale, made orthogonal to gain and bias, which then need no unknowns of their own.
    for i in range(SIDE):
        for j in range(SIDE):
            y, x = v + i - RADIUS, u + j - RADIUS
            jacobian[0, i, j] = 0.5 * (float(far[y, x + 1]) - float(far[y, x - 1]))
            jacobian[1, i, j] = 0.5 * (float(far[y + 1, x]) - float(far[y - 1, x]))
            jacobian[2, i, j] = jacobian[0, i, j] * (j - RADIUS) + jacobian[1, i, j] * (i - RADIUS)
    for k in range(3):
        mean, fraction = 0.0, 0.0
        for i in range(SIDE):
            for j in range(SIDE):
                mean += jacobian[k, i, j]
                fraction += jacobian[k, i, j] * template[i, j]
        mean /= SIDE * SIDE
        fraction /= square
        for i in range(SIDE):
            for j in range(SIDE):
                jacobian[k, i, j] -= mean + fraction * template[i, j]


@compiled
def _inverse(jacobian: Array, inverse: Array) -> bool:
    # Inverse (3, 3) of the normal matrix of the Jacobian; False where it is singular.
    normal = np.empty((3, 3))
    for k in range(3):
        for m in range(k, 3):
            total = 0.0
            for i in range(SIDE):
                for j in range(SIDE):
                    total += jacobian[k, i, j] * jacobian[m, i, j]
            normal[k, m] = total
    return invert_symmetric(normal, 0.0, 0.0, inverse) > 1e-9


@compiled
def _largest_variance(inverse: Array) -> float:
    # Larger eigenvalue of the position's part (2, 2).
    half = 0.5 * (inverse[0, 0] - inverse[1, 1])
    middle = 0.5 * (inverse[0, 0] + inverse[1, 1])
    larger: float = middle + np.sqrt(half * half + inverse[0, 1] ** 2)
    return larger


@compiled
def _fit(
    near: NDArray[np.uint8],
    template: Array,
    square: float,
    jacobian: Array,
    inverse: Array,
    warp: Array,
    position: Array,
    patch: Array,
    limits: _Limits,
) -> float:
    # Gauss-Newton on position (u, v, scale), in position; returns the correlation, 0 where the patch leaves the image.
    zncc, norm_t = 0.0, float(np.sqrt(square))
    for _ in range(limits.iterations):
        if not _inside(near, position[0], position[1], warp, position[2], 0.0):
            return 0.0
        mean, norm = _sample(near, position[0], position[1], warp, position[2], patch)
        if norm <= 1e-6:
            return 0.0
        product, r0, r1, r2 = 0.0, 0.0, 0.0, 0.0
        for i in range(SIDE):
            for j in range(SIDE):
                value = patch[i, j] - mean
                product += value * template[i, j]
                r0 += jacobian[0, i, j] * value
                r1 += jacobian[1, i, j] * value
                r2 += jacobian[2, i, j] * value
        zncc = product / (norm * norm_t)
        if zncc < limits.abandoned_correlation:
            return zncc
        gain = product / square  # of the near patch against the template
        r0, r1, r2 = r0 / gain, r1 / gain, r2 / gain
        du = inverse[0, 0] * r0 + inverse[0, 1] * r1 + inverse[0, 2] * r2
        dv = inverse[1, 0] * r0 + inverse[1, 1] * r1 + inverse[1, 2] * r2
        ds = inverse[2, 0] * r0 + inverse[2, 1] * r1 + inverse[2, 2] * r2
        ds = min(limits.scale_step, max(-limits.scale_step, ds))
        # The template warped by (du, dv, 1 + ds) fits the patch: compose its inverse with the current warp.
        position[2] /= 1.0 + ds
        position[0] -= position[2] * (warp[0] * du + warp[1] * dv)
        position[1] -= position[2] * warp[2] * dv
        if abs(du) + abs(dv) + RADIUS * abs(ds) < limits.converged_px:
            break
    return zncc


@compiled
def _register(
    far: NDArray[np.uint8],
    near: NDArray[np.uint8],
    corners: NDArray[np.int64],
    starts: Array,
    warps: Array,
    search: int,
    limits: _Limits,
    points: Array,
    scales: Array,
    znccs: Array,
    sigmas: Array,
) -> None:
    height, width = far.shape
    template, patch = np.empty((SIDE, SIDE)), np.empty((SIDE, SIDE))
    jacobian, inverse, position = np.empty((3, SIDE, SIDE)), np.empty((3, 3)), np.empty(3)
    edge = RADIUS + 1
    for n in range(corners.shape[0]):
        u, v = corners[n, 0], corners[n, 1]
        if u < edge or v < edge or u >= width - edge or v >= height - edge:
            continue
        if not _inside(near, starts[n, 0], starts[n, 1], warps[n], 1.0, 0.0):
            continue
        square = _template(far, u, v, template)
        if square < (limits.least_texture * SIDE) ** 2:
            continue
        _derivatives(far, u, v, template, square, jacobian)
        if not _inverse(jacobian, inverse):
            continue
        position[0], position[1] = _coarse(near, template, starts[n], warps[n], search)
        position[2] = 1.0
        zncc = _fit(near, template, square, jacobian, inverse, warps[n], position, patch, limits)
        shift = max(abs(position[0] - starts[n, 0]), abs(position[1] - starts[n, 1]))
        if (
            shift > limits.farthest_px + search
            or not 1 / limits.scale_change < position[2] < limits.scale_change
        ):
            continue
        points[n, 0], points[n, 1] = position[0], position[1]
        scales[n], znccs[n] = position[2], zncc
        sigmas[n] = np.sqrt(_largest_variance(inverse) * square * (1.0 - zncc * zncc) / FREEDOM)
