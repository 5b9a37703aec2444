"""Register two rectified views of one flat face: shift, stretch along both axes, gain and bias.

Forward-additive Gauss-Newton on grey levels (Lucas and Kanade, 1981; Baker and Matthews, 2004). Unlike the small
patches of tie points, a face is compared as a whole and has a stretch for each axis: the horizontal one depends on its
facing.
"""

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
SAMPLES_PER_INDEPENDENT = 3.0
"""Neighbouring samples that share a pixel count as one."""
SMALLEST_VARIANCE = 1.0
"""Least variance of a sample, in grey levels squared."""


def align(template: Array, weight: Array, patch: Array, start: Array) -> Alignment | None:
    """Find the template in the patch; None where it diverges or leaves the patch.

    `template`, `weight`, `patch`: grey levels and weights, `(rows, columns)` float64. Samples of weight 0 are not
    compared. `start` (2,): shift to begin with, samples right and down.

    Raises ValueError if the arrays are of other types or shapes.
    """
    shape = template.shape
    require_array(template, "template", np.float64, (None, None))
    require_array(weight, "weight", np.float64, shape)
    require_array(patch, "patch", np.float64, shape)
    total = float(weight.sum())
    if total <= 0:
        return None
    mean = float((weight * template).sum()) / total
    spread = float((weight * (template - mean) ** 2).sum())
    x, normal = np.array([start[0], start[1], 1.0, 1.0, 1.0, 0.0]), np.zeros((6, 6))
    inside, squares = _gauss_newton(template, weight, patch, total, x, normal)
    if inside < INSIDE * total:
        return None
    try:
        inverse = np.asarray(np.linalg.inv(normal), np.float64)
    except np.linalg.LinAlgError:
        return None
    if x[4] <= 0 or spread <= 0:
        return None
    zncc = float(np.sqrt(max(0.0, 1 - squares / spread)))
    covariance = inverse[:4, :4] * _variance(squares, inside)
    return Alignment(x[:2].copy(), x[2:4].copy(), float(x[4]), float(x[5]), zncc, covariance)


@compiled
def _variance(squares: float, inside: float) -> float:
    """Variance of a sample; neighbouring samples share a pixel of the image and are not independent."""
    independent = max(inside / SAMPLES_PER_INDEPENDENT, 1.0)
    return max(squares / independent, SMALLEST_VARIANCE)


@compiled_within
def _normal_equations(
    template: Array, weight: Array, patch: Array, x: Array, normal: Array, right: Array
) -> tuple[float, float]:
    # Fills normal (6, 6) and right (6,) at shift, stretch, gain, bias x; returns sum of weights and of squares.
    rows, columns = template.shape
    middle_u, middle_v = (columns - 1) / 2, (rows - 1) / 2
    normal[:] = 0
    right[:] = 0
    inside, squares = 0.0, 0.0
    jacobian = np.empty(6)
    for i in range(rows):
        v = middle_v + x[3] * (i - middle_v) + x[1]
        if not 0 <= v < rows - 1:
            continue
        top = int(v)
        b = v - top
        for j in range(columns):
            w = weight[i, j]
            if w <= 0:
                continue
            u = middle_u + x[2] * (j - middle_u) + x[0]
            if not 0 <= u < columns - 1:
                continue
            left = int(u)
            a = u - left
            p, q = patch[top, left], patch[top, left + 1]
            r, s = patch[top + 1, left], patch[top + 1, left + 1]
            above, below = p + a * (q - p), r + a * (s - r)
            value = above + b * (below - above)
            jacobian[0] = x[4] * ((q - p) + b * ((s - r) - (q - p)))
            jacobian[1] = x[4] * (below - above)
            jacobian[2] = jacobian[0] * (j - middle_u)
            jacobian[3] = jacobian[1] * (i - middle_v)
            jacobian[4] = value
            jacobian[5] = 1.0
            residual = template[i, j] - (x[4] * value + x[5])
            for k in range(6):
                right[k] += w * jacobian[k] * residual
                for m in range(k, 6):
                    normal[k, m] += w * jacobian[k] * jacobian[m]
            inside += w
            squares += w * residual * residual
    for k in range(6):
        for m in range(k):
            normal[k, m] = normal[m, k]
    return inside, squares


@compiled
def _gauss_newton(
    template: Array, weight: Array, patch: Array, total: float, x: Array, normal: Array
) -> tuple[float, float]:
    # Moves x (6,) to the minimum; `normal`, weights and squares there, or 0, 0 where it fails.
    start_u, start_v, right, step, least = x[0], x[1], np.empty(6), np.empty(6), np.inf
    half_u, half_v = (template.shape[1] - 1) / 2, (template.shape[0] - 1) / 2
    for _ in range(ITERATIONS):
        inside, squares = _normal_equations(template, weight, patch, x, normal, right)
        if inside < INSIDE * total:
            return 0.0, 0.0
        if squares > least * inside:
            # too far: between samples the slope of a patch jumps, and full steps go to and fro across such a place
            for k in range(6):
                step[k] *= 0.5
                x[k] -= step[k]
        else:
            least = squares / inside
            prior = _variance(squares, inside) / STRETCH_SIGMA**2
            for k in (2, 3):
                normal[k, k] += prior
                right[k] -= prior * (x[k] - 1.0)
            if not cholesky_solve(normal, right):
                return 0.0, 0.0
            for k in range(6):
                step[k] = right[k]
                x[k] += step[k]
        if max(abs(x[0] - start_u), abs(x[1] - start_v)) > LARGEST_SHIFT:
            return 0.0, 0.0
        if max(abs(x[2] - 1), abs(x[3] - 1)) > LARGEST_STRETCH:
            return 0.0, 0.0
        across = abs(step[0]) + half_u * abs(step[2])
        if max(across, abs(step[1]) + half_v * abs(step[3])) < CONVERGED:
            break
    return _normal_equations(template, weight, patch, x, normal, right)


def warp_to_template(view: NDArray[np.float32], found: Alignment) -> NDArray[np.float32]:
    """A view (rows, columns, 3) resampled into the template, with the template's gain and bias."""
    rows, columns = view.shape[:2]
    middle = (np.array([columns, rows]) - 1) / 2
    move = middle - found.stretch * middle + found.shift
    warp = np.array([[found.stretch[0], 0, move[0]], [0, found.stretch[1], move[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(
        view, warp, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(warped * np.float32(found.gain) + np.float32(found.bias), np.float32)
