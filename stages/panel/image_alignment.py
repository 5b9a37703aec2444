"""Register two rectified views of one flat face: shift, stretch along both axes, gain and bias.

Forward-additive Gauss-Newton on grey levels (Lucas and Kanade, 1981; Baker and Matthews, 2004). Unlike the small
patches of tie points, a face is compared as a whole and has a stretch for each axis: the horizontal one depends on its
facing.
"""

from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.measurement import Alignment
from wayside.stages.geometry import cholesky_solve
from wayside.stages.kernels import Array, compiled, compiled_within, require_array

ITERATIONS = 12
"""Gauss-Newton steps at most, whole or halved."""
CONVERGED = 0.05
"""Steps that move all samples by less than this, in samples, end the registration; it is then within 0.01."""
STRETCH_SIGMA = 0.03
"""Scatter of the stretches about 1 (prior)."""
LARGEST_STRETCH = 0.2
"""A stretch that differs more from 1 is refused."""
LARGEST_SHIFT = 4.0
"""A shift, in samples, that moves farther from its start is refused."""
INSIDE = 0.5
"""Fraction of the weighted samples that lies in the other view at least."""
LEAST_ZNCC = 0.8
"""Correlation (ZNCC) above which a template counts as found."""
SHARED_SAMPLES = 3.0
"""So many neighbouring samples share a pixel and count as one."""
SMALLEST_VARIANCE = 1.0
"""Least variance of a sample, in grey levels squared."""


SINGLE = np.float32
Samples = NDArray[np.float32]
"""Grey levels or weights (rows, columns)."""


def align(template: Samples, weight: Samples, patch: Samples, start: Array) -> Alignment | None:
    """Find the template in the patch; None where it diverges, leaves the patch, or does not correlate.

    `template`, `weight`, `patch`: of one shape. Samples of weight 0 are not compared. `start` (2,): shift to begin
    with, samples right and down.

    Raises ValueError if the arrays are of other types or shapes.
    """
    for name, samples in (("template", template), ("weight", weight), ("patch", patch)):
        require_array(samples, name, np.float32, template.shape)
    x, normal = np.array([start[0], start[1], 1.0, 1.0, 1.0, 0.0]), np.empty((7, 7))
    spread = _gauss_newton(template, weight, patch, x, normal)
    zncc = float(np.sqrt(max(0.0, 1 - normal[6, 6] / spread))) if spread > 0 else 0.0
    if zncc <= LEAST_ZNCC or x[4] <= 0:
        return None
    try:
        inverse = np.asarray(np.linalg.inv(normal[:6, :6]), np.float64)
    except np.linalg.LinAlgError:
        return None
    covariance = inverse[:4, :4] * variance_of(normal[6, 6], normal[5, 5])
    return Alignment(x[:2].copy(), x[2:4].copy(), float(x[4]), float(x[5]), zncc, covariance)


@compiled
def variance_of(squares: float, inside: float) -> float:
    """Variance of a sample; neighbouring samples share a pixel of the image and are not independent."""
    independent = max(inside / SHARED_SAMPLES, 1.0)
    return max(squares / independent, SMALLEST_VARIANCE)


@partial(compiled_within, reorder=True)
def _normal_equations(
    samples: Samples, count: int, patch: Samples, x: Array, normal: Array
) -> None:
    # Fills the products (7, 7) of derivatives by shift, stretch, gain, bias x, and of the residual, with the weights.
    width, grey, one, zero = np.uint32(patch.shape[1]), patch.reshape(-1), np.uint32(1), SINGLE(0)
    end_u, end_v = SINGLE(patch.shape[1] - 1), SINGLE(patch.shape[0] - 1)
    first_u, wide, gain = SINGLE(end_u / 2 + x[0]), SINGLE(x[2]), SINGLE(x[4])
    first_v, tall, bias = SINGLE(end_v / 2 + x[1]), SINGLE(x[3]), SINGLE(x[5])
    # nothing is stored within the loop, which lets the compiler compute several samples at a time
    gg = gh = gi = gj = gp = gw = gr = hh = hi = hj = hp = hw = hr = ii = ij = zero
    ip = iw = ir = jj = jp = jw = jr = pp = pw = pr = ww = wr = rr = zero
    for n in range(count):
        right, down, value, weight = samples[0, n], samples[1, n], samples[2, n], samples[3, n]
        u, v = first_u + wide * right, first_v + tall * down
        within = (u >= zero) & (u < end_u) & (v >= zero) & (v < end_v)
        u, v, w = u if within else zero, v if within else zero, weight if within else zero
        left, top = np.uint32(u), np.uint32(v)
        a, b, at = u - SINGLE(left), v - SINGLE(top), width * top + left
        p, q = grey[at], grey[at + one] - grey[at]
        r, s = grey[at + width], grey[at + width + one] - grey[at + width]
        above, below = p + a * q, r + a * s
        seen = above + b * (below - above)
        g, h, p = w * gain * (q + b * (s - q)), w * gain * (below - above), w * seen
        i, j, r = g * right, h * down, w * (value - (gain * seen + bias))
        gg, gh, gi, gj = gg + g * g, gh + g * h, gi + g * i, gj + g * j
        gp, gw, gr = gp + g * p, gw + g * w, gr + g * r
        hh, hi, hj = hh + h * h, hi + h * i, hj + h * j
        hp, hw, hr = hp + h * p, hw + h * w, hr + h * r
        ii, ij, ip, iw, ir = ii + i * i, ij + i * j, ip + i * p, iw + i * w, ir + i * r
        jj, jp, jw, jr = jj + j * j, jp + j * p, jw + j * w, jr + j * r
        pp, pw, pr = pp + p * p, pw + p * w, pr + p * r
        ww, wr, rr = ww + w * w, wr + w * r, rr + r * r
    first, n = (gg, gh, gi, gj, gp, gw, gr, hh, hi, hj, hp, hw, hr, ii, ij, ip, iw, ir), 0
    sums = (*first, jj, jp, jw, jr, pp, pw, pr, ww, wr, rr)
    for k in range(7):
        for m in range(k, 7):
            normal[k, m] = normal[m, k] = sums[n]
            n += 1


@compiled_within
def _compared(template: Samples, weight: Samples, samples: Samples) -> tuple[int, float, float]:
    # Fills place from the middle, value, and root of the weight (4, n); n, sum of weights and squares about the mean.
    rows, columns = template.shape
    count, total, first, second = 0, 0.0, 0.0, 0.0
    for i in range(rows):
        for j in range(columns):
            w, value = weight[i, j], template[i, j]
            if w > 0:
                samples[0, count], samples[1, count] = j - (columns - 1) / 2, i - (rows - 1) / 2
                samples[2, count], samples[3, count] = value, np.sqrt(w)
                count, total = count + 1, total + w
                first, second = first + w * value, second + w * value * value
    return count, total, second - first * first / total


@compiled_within
def _solve(normal: Array, prior: float, x: Array, factor: Array, step: Array) -> bool:
    # Fills the step (6,) from x, with a prior of the stretches.
    for c in range(6):
        step[c] = normal[6, c]
        for m in range(6):
            factor[c, m] = normal[c, m]
    for c in (2, 3):
        factor[c, c] += prior
        step[c] -= prior * (x[c] - 1.0)
    return cholesky_solve(factor, step)


@compiled
def _gauss_newton(
    template: Samples, weight: Samples, patch: Samples, x: Array, normal: Array
) -> float:
    # Moves x (6,) to the minimum, with its normal equations (7, 7); sum of squares about the mean, or 0 where it fails.
    half_u, half_v = (template.shape[1] - 1) / 2, (template.shape[0] - 1) / 2
    samples, factor = np.empty((4, template.size), SINGLE), np.empty((6, 6))
    count, total, spread = _compared(template, weight, samples)
    start_u, start_v, step, least = x[0], x[1], np.zeros(6), np.inf
    for k in range(ITERATIONS + 1):
        _normal_equations(samples, count, patch, x, normal)
        inside, squares = normal[5, 5], normal[6, 6]
        if inside < INSIDE * total:
            return 0.0
        moved = max(abs(step[0]) + half_u * abs(step[2]), abs(step[1]) + half_v * abs(step[3]))
        if k == ITERATIONS or (k and moved < CONVERGED):
            break
        if squares > least * inside:
            # too far: between samples the slope of a patch jumps, and full steps go to and fro across such a place
            for c in range(6):
                step[c] *= 0.5
                x[c] -= step[c]
        else:
            least = squares / inside
            prior = variance_of(squares, inside) / STRETCH_SIGMA**2
            if not _solve(normal, prior, x, factor, step):
                return 0.0
            for c in range(6):
                x[c] += step[c]
        if max(abs(x[0] - start_u), abs(x[1] - start_v)) > LARGEST_SHIFT:
            return 0.0
        if max(abs(x[2] - 1), abs(x[3] - 1)) > LARGEST_STRETCH:
            return 0.0
    return spread


def warp_to_template(view: NDArray[Any], found: Alignment) -> NDArray[np.float32]:
    """A view (rows, columns, 3) resampled into the template, with the template's gain and bias."""
    rows, columns = view.shape[:2]
    middle = (np.array([columns, rows]) - 1) / 2
    move = middle - found.stretch * middle + found.shift
    warp = np.array([[found.stretch[0], 0, move[0]], [0, found.stretch[1], move[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(
        view.astype(np.float32), warp, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(warped * np.float32(found.gain) + np.float32(found.bias), np.float32)
