"""Sub-pixel registration of small patches between two pictures.

The patch of the farther view is the template; translation, scale, gain and bias are solved in the nearer one by
inverse-compositional Gauss-Newton (Baker and Matthews, 2004): the template's gradients serve all iterations. Seven
times as exact as the corners themselves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.numerics.compiled import Array, compiled
from wayside.stages.numerics.guards import require_array

RADIUS = 7
SIDE = 2 * RADIUS + 1
ITERATIONS = 12
CONVERGED_PX = 0.01
FARTHEST_PX = 5.0
SCALE_CHANGE = 1.3


class Registered(NamedTuple):
    """Where patches were found: point (n, 2) px, scale (n,), zncc (n,) likeness in -1 to 1, 0 where it failed."""

    point: Array
    scale: Array
    zncc: Array


def register_patches(
    far: NDArray[np.uint8],
    near: NDArray[np.uint8],
    corners: NDArray[np.int64],
    starts: Array,
    scales: Array,
    *,
    search_px: int = 2,
) -> Registered:
    """Find the 15 x 15 px patches round `corners` of the far picture in the near one.

    Parameters
    ----------
    far, near
        Grey pictures (height, width).
    corners
        Middle of each patch, (n, 2) whole pixels.
    starts, scales
        Where and how much larger the patch is expected in the near picture: (n, 2) px and (n,).
    search_px
        Whole pixels searched round the start before the fit.

    Returns
    -------
    Registered
        zncc is 0 and the point nan where the patch leaves a picture, has no texture, or the fit runs away.
    """
    n = len(corners)
    require_array(far, "far", np.uint8, (None, None))
    require_array(near, "near", np.uint8, (None, None))
    require_array(corners, "corners", np.int64, (n, 2))
    require_array(starts, "starts", np.float64, (n, 2))
    require_array(scales, "scales", np.float64, (n,))
    point, scale, zncc = np.full((n, 2), np.nan), np.ones(n), np.zeros(n)
    _register(far, near, corners, starts, scales, search_px, point, scale, zncc)
    return Registered(point, scale, zncc)


@compiled
def _sample(
    picture: NDArray[np.uint8],
    u: float,
    v: float,
    scale: float,
    columns: NDArray[np.int64],
    shares: Array,
    patch: Array,
) -> tuple[float, float]:
    # Bilinear (SIDE, SIDE) patch round u, v; returns mean and root of the sum of squares about it, or -1 outside.
    reach = RADIUS * scale
    height, width = picture.shape
    if not (u - reach >= 0 and v - reach >= 0 and u + reach < width - 1 and v + reach < height - 1):
        return 0.0, -1.0
    for j in range(SIDE):
        x = u + scale * (j - RADIUS)
        columns[j] = int(x)
        shares[j] = x - int(x)
    total, squares = 0.0, 0.0
    for i in range(SIDE):
        y = v + scale * (i - RADIUS)
        row = int(y)
        fy = y - row
        for j in range(SIDE):
            c, fx = columns[j], shares[j]
            a, b = float(picture[row, c]), float(picture[row + 1, c])
            a += fx * (float(picture[row, c + 1]) - a)
            b += fx * (float(picture[row + 1, c + 1]) - b)
            value = a + fy * (b - a)
            patch[i, j] = value
            total += value
            squares += value * value
    mean = total / (SIDE * SIDE)
    return mean, np.sqrt(max(0.0, squares - total * mean))


@compiled
def _coarse(
    near: NDArray[np.uint8], template: Array, start: Array, scale: float, search: int
) -> tuple[float, float]:
    # The whole-pixel shift of best correlation, every second pixel of the patch.
    height, width = near.shape
    reach = RADIUS * scale + search + 1
    best, best_u, best_v = -1.0, start[0], start[1]
    if not (
        start[0] - reach >= 0
        and start[1] - reach >= 0
        and start[0] + reach < width - 1
        and start[1] + reach < height - 1
    ):
        return best_u, best_v
    count = 0
    total_t, squares_t = 0.0, 0.0
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
                row = int(start[1] + dv + scale * (i - RADIUS) + 0.5)
                for j in range(0, SIDE, 2):
                    value = float(near[row, int(start[0] + du + scale * (j - RADIUS) + 0.5)])
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
def _invert3(matrix: Array, inverse: Array) -> bool:
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * m0 + b * m1 + c * m2
    if not determinant > 1e-9 * a * d * f:
        return False
    q = 1.0 / determinant
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = m0 * q, m1 * q, m2 * q
    inverse[1, 0], inverse[1, 1], inverse[1, 2] = m1 * q, (a * f - c * c) * q, (b * c - a * e) * q
    inverse[2, 0], inverse[2, 1], inverse[2, 2] = m2 * q, (b * c - a * e) * q, (a * d - b * b) * q
    return True


@compiled
def _register(
    far: NDArray[np.uint8],
    near: NDArray[np.uint8],
    corners: NDArray[np.int64],
    starts: Array,
    scales: Array,
    search: int,
    points: Array,
    found_scales: Array,
    znccs: Array,
) -> None:
    height, width = far.shape
    template, patch = np.empty((SIDE, SIDE)), np.empty((SIDE, SIDE))
    slopes = np.empty((3, SIDE, SIDE))
    normal, inverse = np.empty((3, 3)), np.empty((3, 3))
    columns, shares = np.empty(SIDE, np.int64), np.empty(SIDE)
    for n in range(corners.shape[0]):
        cu, cv = corners[n, 0], corners[n, 1]
        edge = RADIUS + 1
        if cu < edge or cv < edge or cu >= width - edge or cv >= height - edge:
            continue
        if not (np.isfinite(starts[n, 0]) and np.isfinite(starts[n, 1]) and scales[n] > 0):
            continue
        mean_t = 0.0
        for i in range(SIDE):
            for j in range(SIDE):
                template[i, j] = float(far[cv + i - RADIUS, cu + j - RADIUS])
                mean_t += template[i, j]
        mean_t /= SIDE * SIDE
        square_t = 0.0
        for i in range(SIDE):
            for j in range(SIDE):
                template[i, j] -= mean_t
                square_t += template[i, j] ** 2
        norm_t = np.sqrt(square_t)
        if norm_t < 2.0 * SIDE:  # less than 2 grey levels of texture
            continue
        # Gradients by position and scale, freed of what gain and bias explain: those need no unknowns of their own.
        for i in range(SIDE):
            for j in range(SIDE):
                v, u = cv + i - RADIUS, cu + j - RADIUS
                gu = 0.5 * (float(far[v, u + 1]) - float(far[v, u - 1]))
                gv = 0.5 * (float(far[v + 1, u]) - float(far[v - 1, u]))
                slopes[0, i, j] = gu
                slopes[1, i, j] = gv
                slopes[2, i, j] = gu * (j - RADIUS) + gv * (i - RADIUS)
        for k in range(3):
            mean, share = 0.0, 0.0
            for i in range(SIDE):
                for j in range(SIDE):
                    mean += slopes[k, i, j]
                    share += slopes[k, i, j] * template[i, j]
            mean /= SIDE * SIDE
            share /= square_t
            for i in range(SIDE):
                for j in range(SIDE):
                    slopes[k, i, j] -= mean + share * template[i, j]
        for k in range(3):
            for m in range(k, 3):
                total = 0.0
                for i in range(SIDE):
                    for j in range(SIDE):
                        total += slopes[k, i, j] * slopes[m, i, j]
                normal[k, m] = total
        if not _invert3(normal, inverse):
            continue
        scale = scales[n]
        u, v = _coarse(near, template, starts[n], scale, search)
        zncc = 0.0
        for _ in range(ITERATIONS):
            mean, norm = _sample(near, u, v, scale, columns, shares, patch)
            if norm <= 1e-6:
                zncc = 0.0
                break
            product, r0, r1, r2 = 0.0, 0.0, 0.0, 0.0
            for i in range(SIDE):
                for j in range(SIDE):
                    value = patch[i, j] - mean
                    product += value * template[i, j]
                    r0 += slopes[0, i, j] * value
                    r1 += slopes[1, i, j] * value
                    r2 += slopes[2, i, j] * value
            zncc = product / (norm * norm_t)
            if zncc < 0.3:
                break
            # gain of the near patch against the template
            gain = product / square_t
            r0, r1, r2 = r0 / gain, r1 / gain, r2 / gain
            du = inverse[0, 0] * r0 + inverse[0, 1] * r1 + inverse[0, 2] * r2
            dv = inverse[1, 0] * r0 + inverse[1, 1] * r1 + inverse[1, 2] * r2
            ds = inverse[2, 0] * r0 + inverse[2, 1] * r1 + inverse[2, 2] * r2
            ds = min(0.2, max(-0.2, ds))
            # the template moved by (d, 1 + ds) fits the patch: compose the inverse of that with the warp so far
            scale /= 1.0 + ds
            u -= scale * du
            v -= scale * dv
            if abs(du) + abs(dv) + RADIUS * abs(ds) < CONVERGED_PX:
                break
        away = max(abs(u - starts[n, 0]), abs(v - starts[n, 1]))
        change = scale / scales[n]
        if away > FARTHEST_PX or not 1 / SCALE_CHANGE < change < SCALE_CHANGE:
            continue
        points[n, 0], points[n, 1] = u, v
        found_scales[n], znccs[n] = scale, zncc
