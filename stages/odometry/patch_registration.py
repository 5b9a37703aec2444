"""Sub-pixel registration of small patches between two images.

The patch of the farther view is the template. Translation, scale, gain and bias in the nearer one are solved by
inverse-compositional Gauss-Newton (Baker and Matthews, 2004), with the template's gradients in all iterations. The
error is a seventh of that of the corners (measured).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import invert_symmetric
from wayside.stages.kernels import Array, compiled, compiled_within, require_array

FARTHEST_SHIFT_PX = 3.0
"""Largest shift from where a patch is expected, besides the search."""
SCALE_CHANGE = 1.3
"""Largest change of scale by the fit."""
ITERATIONS = 12
"""Of the registration of a patch at most."""
CONVERGED_PX = 0.02
"""A smaller step ends the registration."""
LEAST_TEXTURE = 2.0
"""Smallest standard deviation of a patch, grey levels."""
ABANDONED_CORRELATION = 0.5
"""A registration that starts below it is abandoned."""
SMALLEST_CORRELATION = 0.85
"""Smallest correlation of a registered patch."""
SCALE_STEP = 0.2
"""Relative change of scale in one step of the fit at most."""
RADIUS = 7
SIDE, ROW, LONG = 2 * RADIUS + 1, 2 * RADIUS + 3, 256
"""Array layout: a patch is (SIDE, SIDE) pixels, in rows of ROW, the last two of which are zero, padded to LONG."""
_PLACE = np.arange(LONG, dtype=np.int32)
OFF_U, OFF_V = _PLACE % ROW - RADIUS, _PLACE // ROW - RADIUS
INSIDE = ((OFF_U <= RADIUS) & (OFF_V <= RADIUS)).astype(np.int32)
PIXELS = SIDE * SIDE
FREEDOM = PIXELS - 5.0
"""Pixels of a patch less the unknowns: two of position, scale, gain, bias."""

Pixels = NDArray[np.int32]
Images = tuple[NDArray[np.uint8], NDArray[np.uint8]]


class PatchRegistration(NamedTuple):
    """Registered patches: point (n, 2) px, scale (n,) on top of the warp, zncc (n,) correlation, 0 where it is low.

    `sigma` (n,): standard deviation of the point along its worst direction, px of the far image, by the residual noise
    between the patches. It is large along an edge, where only the ends fix the position.
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
) -> PatchRegistration:
    """Register the 15 x 15 px patches round `corners` of the far image in the near one.

    `far`, `near`: grey images (height, width). `corners`: centre of each patch, (n, 2) whole pixels. `starts`: where
    the patches are expected in the near image, (n, 2) px. `warps`: their expected warp, (n, 3): stretch along u, shear
    of u by v, stretch along v. A plate seen from nearer has (s, 0, s), the road about (s, k, s * s). `search_px`: whole
    pixels searched round the start before the fit.

    `zncc` is 0 and the point nan where the patch leaves an image, has no texture, the fit exceeds its limits, or the
    correlation is low.

    Raises ValueError where an array has another shape or type.
    """
    n = len(corners)
    require_array(far, "far", np.uint8, (None, None))
    require_array(near, "near", np.uint8, (None, None))
    require_array(corners, "corners", np.int64, (n, 2))
    require_array(starts, "starts", np.float64, (n, 2))
    require_array(warps, "warps", np.float64, (n, 3))
    found = PatchRegistration(np.full((n, 2), np.nan), np.ones(n), np.zeros(n), np.full(n, np.inf))
    _register((far, near), corners, starts, warps, search_px, found)
    return found


class _Work(NamedTuple):
    """Of one patch: far pixels with derivatives (4, LONG), near pixels; sums (2, 4), normal matrix, position, scale."""

    template: Pixels
    patch: Pixels
    window: NDArray[np.uint8]
    sums: Array
    normal: Array
    inverse: Array
    position: Array
    columns: NDArray[np.int64]


@compiled_within
def _inside(
    image: NDArray[np.uint8], u: float, v: float, warp: Array, scale: float, margin: float
) -> bool:
    # Whether a warped patch and the pixel after it lie in the image; False for nan too.
    reach_u = RADIUS * scale * (abs(warp[0]) + abs(warp[1])) + margin
    reach_v = RADIUS * scale * abs(warp[2]) + margin
    height, width = image.shape
    inside: bool = u - reach_u >= 0 and v - reach_v >= 0
    return inside and u + reach_u < width - 1 and v + reach_v < height - 1


@compiled_within
def _coarse(
    images: Images, u: int, v: int, start: Array, warp: Array, search: int, work: _Work
) -> tuple[float, float]:
    # The whole-pixel shift of best correlation, by every second pixel of the patch: sums of whole numbers.
    (far, near), columns = images, work.columns
    best, best_u, best_v = -1.0, start[0], start[1]
    if not _inside(near, start[0], start[1], warp, 1.0, search + 1.0):
        return best_u, best_v
    count, total_t, squares_t = 0, 0, 0
    for i in range(0, SIDE, 2):
        begin = start[0] + warp[1] * (i - RADIUS) + 0.5
        for j in range(0, SIDE, 2):
            columns[i, j] = int(begin + warp[0] * (j - RADIUS))
            expected = int(far[v + i - RADIUS, u + j - RADIUS])
            total_t, squares_t, count = total_t + expected, squares_t + expected**2, count + 1
    spread_t = float(count * squares_t - total_t**2)
    for dv in range(-search, search + 1):
        for du in range(-search, search + 1):
            total, squares, product = 0, 0, 0
            for i in range(0, SIDE, 2):
                row = int(start[1] + warp[2] * (i - RADIUS) + 0.5) + dv
                for j in range(0, SIDE, 2):
                    value = int(near[row, columns[i, j] + du])
                    total, squares = total + value, squares + value**2
                    product += value * int(far[v + i - RADIUS, u + j - RADIUS])
            spread = (count * squares - total**2) * spread_t
            if spread <= 0:
                continue
            zncc = (count * product - total * total_t) / np.sqrt(spread)
            if zncc > best:
                best, best_u, best_v = zncc, start[0] + du, start[1] + dv
    return best_u, best_v


@compiled_within
def _template(far: NDArray[np.uint8], u: int, v: int, work: _Work) -> float:
    # The patch round a whole pixel, and twice its derivatives by position and scale; their sums with the mean and the
    # patch, and the upper half of their normal matrix. There they are orthogonal to gain and bias, which then need no
    # unknowns of their own. Returns the sum of squares of the patch less its mean. Whole numbers add up in any order,
    # so the processor adds several at a time; none of the sums exceeds 32 bits.
    template, window, sums, normal = work.template, work.window, work.sums, work.normal
    for i in range(SIDE + 2):
        row = far[v + i - RADIUS - 1, u - RADIUS - 1 :]
        for j in range(ROW):
            window[i * ROW + j] = row[j]
    for n in range(LONG):
        inside = int(INSIDE[n])
        by_u = inside * (int(window[n + ROW + 2]) - int(window[n + ROW]))
        by_v = inside * (int(window[n + 2 * ROW + 1]) - int(window[n + 1]))
        template[0, n], template[1, n], template[2, n] = inside * window[n + ROW + 1], by_u, by_v
        template[3, n] = by_u * OFF_U[n] + by_v * OFF_V[n]
    for k in range(4):
        total, product = np.int32(0), np.int32(0)
        for n in range(LONG):
            total = np.int32(total + template[k, n])
            product = np.int32(product + template[k, n] * template[0, n])
        sums[0, k], sums[1, k] = total / PIXELS, product
    square: float = sums[1, 0] - sums[0, 0] ** 2 * PIXELS
    for k in range(1, 4):
        sums[1, k] = (sums[1, k] - sums[0, k] * sums[0, 0] * PIXELS) / square
        for m in range(1, k + 1):
            product = np.int32(0)
            for n in range(LONG):
                product = np.int32(product + template[k, n] * template[m, n])
            normal[m - 1, k - 1] = 0.25 * (
                product - sums[0, k] * sums[0, m] * PIXELS - sums[1, k] * sums[1, m] * square
            )
    return square


@compiled_within
def _fit(near: NDArray[np.uint8], square: float, warp: Array, work: _Work) -> float:
    # Gauss-Newton on position (u, v, scale), in position; returns the correlation, 0 where the patch leaves the image.
    # It ends where the correlation falls: a patch that has no place, or slides along an edge, goes on to the limit.
    template, patch, sums, inverse = work.template, work.patch, work.sums, work.inverse
    zncc, last, position = 0.0, 0.0, work.position
    for _ in range(ITERATIONS):
        u, v, scale = position
        if not _inside(near, u, v, warp, scale, 0.0):
            return 0.0
        across = int(scale * warp[0] * 65536)
        for i in range(SIDE):
            y = int((v + scale * warp[2] * (i - RADIUS)) * 256)
            row, below, fy = near[y >> 8], near[(y >> 8) + 1], y & 255
            x = int((u + scale * (warp[1] * (i - RADIUS) - warp[0] * RADIUS)) * 65536)
            for j in range(SIDE):
                column, fx = np.uint64(x >> 16), (x >> 8) & 255
                a, b = int(row[column]), int(below[column])
                a = 256 * a + fx * (int(row[column + np.uint64(1)]) - a)
                b = 256 * b + fx * (int(below[column + np.uint64(1)]) - b)
                patch[i * ROW + j] = 256 * a + fy * (b - a)
                x += across
        total, squares, p0, p1, p2, p3 = 0, 0, 0, 0, 0, 0
        for n in range(LONG):
            value = int(patch[n])
            total, squares = total + value, squares + value * value
            p0, p1 = p0 + template[0, n] * value, p1 + template[1, n] * value
            p2, p3 = p2 + template[2, n] * value, p3 + template[3, n] * value
        norm = np.sqrt(max(0.0, squares - float(total) * total / PIXELS))
        if norm <= 1e-6:
            return 0.0
        product = p0 - total * sums[0, 0]
        zncc = float(product / (norm * np.sqrt(square)))
        if zncc < max(ABANDONED_CORRELATION, last):
            break
        last = zncc
        gain = 2 * product / square  # of the near patch against the template
        r0 = (p1 - total * sums[0, 1] - product * sums[1, 1]) / gain
        r1 = (p2 - total * sums[0, 2] - product * sums[1, 2]) / gain
        r2 = (p3 - total * sums[0, 3] - product * sums[1, 3]) / gain
        du = inverse[0, 0] * r0 + inverse[0, 1] * r1 + inverse[0, 2] * r2
        dv = inverse[1, 0] * r0 + inverse[1, 1] * r1 + inverse[1, 2] * r2
        ds = inverse[2, 0] * r0 + inverse[2, 1] * r1 + inverse[2, 2] * r2
        ds = min(SCALE_STEP, max(-SCALE_STEP, ds))
        # The template warped by (du, dv, 1 + ds) fits the patch: compose its inverse with the current warp.
        position[2] /= 1.0 + ds
        position[0] -= position[2] * (warp[0] * du + warp[1] * dv)
        position[1] -= position[2] * warp[2] * dv
        if abs(du) + abs(dv) + RADIUS * abs(ds) < CONVERGED_PX:
            break
    return zncc


@compiled
def _register(
    images: Images,
    corners: NDArray[np.int64],
    starts: Array,
    warps: Array,
    search: int,
    found: PatchRegistration,
) -> None:
    (far, near), (height, width) = images, images[0].shape
    template, patch = np.empty((4, LONG), np.int32), np.zeros(LONG, np.int32)
    window, columns = np.zeros(LONG + 2 * ROW + 2, np.uint8), np.empty((SIDE, SIDE), np.int64)
    sums, position, (normal, inverse) = np.empty((2, 4)), np.empty(3), np.empty((2, 3, 3))
    work = _Work(template, patch, window, sums, normal, inverse, position, columns)
    edge = RADIUS + 1
    for n in range(corners.shape[0]):
        u, v = corners[n, 0], corners[n, 1]
        if u < edge or v < edge or u >= width - edge or v >= height - edge:
            continue
        if not _inside(near, starts[n, 0], starts[n, 1], warps[n], 1.0, 0.0):
            continue
        square = _template(far, u, v, work)
        if square < (LEAST_TEXTURE * SIDE) ** 2:
            continue
        if invert_symmetric(normal, 0.0, 0.0, inverse) <= 1e-9:
            continue  # singular
        position[0], position[1] = _coarse(images, u, v, starts[n], warps[n], search, work)
        position[2] = 1.0
        zncc = _fit(near, square, warps[n], work)
        shift = max(abs(position[0] - starts[n, 0]), abs(position[1] - starts[n, 1]))
        if (
            zncc < SMALLEST_CORRELATION
            or shift > FARTHEST_SHIFT_PX + search
            or not 1 / SCALE_CHANGE < position[2] < SCALE_CHANGE
        ):
            continue
        found.point[n, 0], found.point[n, 1] = position[0], position[1]
        found.scale[n], found.zncc[n] = position[2], zncc
        half = 0.5 * (inverse[0, 0] - inverse[1, 1])
        middle = 0.5 * (inverse[0, 0] + inverse[1, 1])
        largest = middle + np.sqrt(half * half + inverse[0, 1] ** 2)  # eigenvalue of the position
        found.sigma[n] = np.sqrt(largest * square * (1.0 - zncc * zncc) / FREEDOM)
