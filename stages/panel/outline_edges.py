"""Strength of edges along the segments of an outline, in registered views (rows, columns, 3).

What belongs to a face is at the same samples in all views; its background moves from view to view. An edge of gradient
e counts as e^2 / (e^2 + c^2), so that a faint rim all along an outline outweighs a strong letter. Lengths are in
samples of the template.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, require_array
from wayside.stages.panel.outline_shapes import Segments, placed

OFFSET_STEP = 0.25
"""Distance between the places where an edge is sought."""
EDGE_LEVEL = 12.0
"""Gradient of an edge of strength one half, grey levels a sample."""
SEGMENT_SAMPLES, STRIP_SAMPLES = 12, 3
"""Points of a segment, one a sample, at which it is compared at most, and those of the mean colour of its strip."""
INSIDE = 0.6
"""Fraction of a segment that lies in the views at least."""
TRIAL_STEP = 0.5
"""Distance between the places and the boxes that are tried for the strongest outline, before it is sought near by."""
TRIAL_RANGES = (np.inf, 2.0, 2.0)
"""Range of a side, either way, in each sweep over the sides of a box."""
MOVES = np.array([[-1, -1, 1, 1, np.inf], *([*s, r] for r in TRIAL_RANGES for s in np.eye(4))])
"""How a box changes, and how far (d, 5): it grows, then its sides move one by one in every sweep."""
SEARCH = 3.0
"""The strongest outline is sought so far, either way, at least."""

Gradients = NDArray[np.float32]
"""Gradient right and down of each view, of the channel that changes most, (views, rows, columns, 2)."""


def gradients_of(views: NDArray[np.float32]) -> Gradients:
    """Gradients of views (n, rows, columns, 3), grey levels a sample; raises ValueError for other arrays."""
    require_array(views, "views", np.float32, (None, None, None, 3))
    gradients = np.zeros((*views.shape[:3], 2), np.float32)
    for view, gradient in zip(views, gradients, strict=True):
        _gradients(view.reshape(len(view), -1), gradient)
    return gradients


@compiled
def _gradients(view: NDArray[np.float32], gradient: NDArray[np.float32]) -> None:
    half, (across, along, square) = np.float32(0.5), np.empty((3, view.shape[1]), np.float32)
    for i in range(1, gradient.shape[0] - 1):
        for k in range(3, view.shape[1] - 3):
            across[k] = half * (view[i, k + 3] - view[i, k - 3])
            along[k] = half * (view[i + 1, k] - view[i - 1, k])
            square[k] = across[k] * across[k] + along[k] * along[k]
        for j in range(1, gradient.shape[1] - 1):
            right, down, most = across[3 * j], along[3 * j], square[3 * j]
            for k in (3 * j + 1, 3 * j + 2):
                more = square[k] > most
                right, down = across[k] if more else right, along[k] if more else down
                most = square[k] if more else most
            gradient[i, j, 0], gradient[i, j, 1] = right, down


@compiled
def edge_profiles(
    gradients: Gradients, segments: Segments, low: float, high: float, step: float
) -> Array:
    """Strength of the edge along each segment at offsets low, low + step, ... (k, m), 0 to 1, over the views.

    Segments that leave the views have strength 0.
    """
    profiles = np.empty((len(segments.normal), round((high - low) / step) + 1))
    # Over the offsets innermost, without a branch: the compiler computes several at a time. It loads single numbers, so
    # gradients are gathered first, both components as one number.
    (views, rows, columns), (begin, end, normal, _) = gradients.shape[:3], segments
    size, pixels, level = profiles.shape[1], gradients.view(np.float64), EDGE_LEVEL * EDGE_LEVEL
    at, (across, along, inside, total) = np.empty(size, np.uint32), np.empty((4, size), np.float32)
    one, row, near = np.uint32(1), np.uint32(columns), np.empty((4, size))
    taps = near.view(np.float32)
    for k in range(profiles.shape[0]):
        right, down = np.float32(normal[k, 0]), np.float32(normal[k, 1])
        total[:] = profiles[k] = 0
        wide, tall = end[k, 0] - begin[k, 0], end[k, 1] - begin[k, 1]
        count = min(int(np.ceil(np.sqrt(wide * wide + tall * tall))), SEGMENT_SAMPLES)
        for s in range(count):
            part = (s + 0.5) / count
            for m in range(size):
                offset = low + step * m
                u = begin[k, 0] + part * wide + offset * normal[k, 0]
                v = begin[k, 1] + part * tall + offset * normal[k, 1]
                inside[m] = within = 1 <= u < columns - 2 and 1 <= v < rows - 2
                profiles[k, m] += within
                # numbers with a sign would cost a test each
                i, j = np.uint32(v if within else 1.0), np.uint32(u if within else 1.0)
                at[m], across[m], along[m] = row * i + j, u - j, v - i
            for g in pixels.reshape(views, -1):
                for m in range(size):
                    i = at[m]
                    near[0, m], near[1, m] = g[i], g[i + one]
                    near[2, m], near[3, m] = g[i + row], g[i + row + one]
                for m in range(size):
                    n = 2 * m
                    above = right * taps[0, n] + down * taps[0, n + 1]
                    above += across[m] * (right * taps[1, n] + down * taps[1, n + 1] - above)
                    below = right * taps[2, n] + down * taps[2, n + 1]
                    below += across[m] * (right * taps[3, n] + down * taps[3, n + 1] - below)
                    square = (above + along[m] * (below - above)) ** 2
                    total[m] += inside[m] * square / (square + np.float32(level))
        for m in range(size):
            enough = profiles[k, m] >= INSIDE * count
            profiles[k, m] = total[m] / (profiles[k, m] * views) if enough else 0.0
    return profiles


def strip_unevenness(
    views: NDArray[np.float32], segments: Segments, low: float, high: float
) -> NDArray[np.float32]:
    """Median difference from the median colour of the colours along all segments in all views.

    Grey levels, (m,), at offsets low, low + `TRIAL_STEP`, ...
    """
    offsets = low + TRIAL_STEP * np.arange(round((high - low) / TRIAL_STEP) + 1)
    along = (np.arange(STRIP_SAMPLES) + 0.5) / STRIP_SAMPLES
    begin, side = segments.begin[:, None], (segments.end - segments.begin)[:, None]
    moved = offsets[:, None, None, None] * segments.normal[:, None]
    points = (begin + along[:, None] * side + moved).astype(np.float32)
    u, v = np.moveaxis(points.reshape(len(offsets), -1, 2), -1, 0)
    around = cv2.BORDER_REPLICATE
    each = [cv2.remap(view, u, v, cv2.INTER_LINEAR, borderMode=around) for view in views]
    seen = np.concatenate(each, axis=1, dtype=np.float32)
    colors = seen.reshape(len(offsets), -1, STRIP_SAMPLES, 3).sum(axis=2) / STRIP_SAMPLES
    colors = np.ascontiguousarray(colors.transpose(0, 2, 1))
    return _median(np.abs(colors - _median(colors)[..., None]).max(axis=1))


def _median(few: NDArray[np.float32]) -> NDArray[np.float32]:
    """Along the last axis; `np.median` takes several times as long for few values."""
    ordered, last = np.sort(few, axis=-1), few.shape[-1] - 1
    return np.asarray((ordered[..., last // 2] + ordered[..., (last + 1) // 2]) / 2, np.float32)


@compiled
def strongest_outline(
    gradients: Gradients, template: Array, start: Array, inward: float, outward: float, step: float
) -> tuple[Array, float, float]:
    """Box (4,) of the strongest outline with the segments of a template near a box; mean strength, standard error.

    `inward`, `outward`: how far, as fractions of the smaller side. `step`: distance of the places. Coordinate ascent
    along `MOVES`, one after the other.
    """
    change, count, strongest, error = np.zeros(4), len(template), -1.0, 0.0
    side = min(start[2] - start[0], start[3] - start[1])
    low = -step * np.ceil(max(inward * side + 1, SEARCH) / step)
    high = step * np.ceil(max(outward * side + 1, SEARCH) / step)
    segments, limit = placed(template, start, 0.0), max(-low, high)
    profiles = edge_profiles(gradients, segments, low, high, step)
    last = (high - low) / step - 0.001
    origin, slope = np.empty(count), np.empty(count)
    for d in range(MOVES.shape[0]):
        for k in range(count):
            origin[k], slope[k] = -low / step, 0.0
            for c in range(4):
                origin[k] += segments.jacobian[k, c] * change[c] / step
                slope[k] += segments.jacobian[k, c] * MOVES[d, c] / step
        first, best = max(low, -MOVES[d, 4]), 0.0
        for n in range(int(np.ceil((min(high, MOVES[d, 4]) - first) / TRIAL_STEP))):
            size, total, squares = first + n * TRIAL_STEP, 0.0, 0.0
            for k in range(count):
                at = min(max(origin[k] + size * slope[k], 0.0), last)
                i = int(at)
                strength = profiles[k, i] + (at - i) * (profiles[k, i + 1] - profiles[k, i])
                total, squares = total + strength, squares + strength * strength
            for c in range(4):
                if abs(change[c] + size * MOVES[d, c]) > limit:
                    total = -1.0
            if total > strongest * count:
                strongest, best = total / count, size
                error = np.sqrt(max(squares / count - strongest**2, 0.0) / (count - 1))
        for c in range(4):
            change[c] += best * MOVES[d, c]
    for c in range(4):
        change[c] += start[c]
    return change, strongest, error
