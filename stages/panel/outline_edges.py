"""Strength of edges along the segments of an outline, in registered views (rows, columns, 3).

What belongs to a face is at the same samples in all views; its background moves from view to view. An edge of gradient
e counts as e^2 / (e^2 + c^2), so that a faint rim all along an outline outweighs a strong letter. Lengths are in
samples of the template.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, require_array
from wayside.stages.panel.outline_shapes import Segments

OFFSET_STEP = 0.25
"""Distance between the places where an edge is sought."""
EDGE_LEVEL = 12.0
"""Gradient of an edge of strength one half, grey levels a sample."""
SEGMENT_SAMPLES, STRIP_SAMPLES = 12, 3
"""Points of a segment at which it is compared, and those whose mean is the colour of its strip."""
INSIDE = 0.6
"""Fraction of a segment that lies in the views at least."""
TRIAL_STEP = 0.5
"""Distance between the places and the boxes that are tried for the strongest outline, before it is sought near by."""

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
    for i in range(1, gradient.shape[0] - 1):
        for j in range(1, gradient.shape[1] - 1):
            most = -1.0
            for k in range(3 * j, 3 * j + 3):
                across = 0.5 * (view[i, k + 3] - view[i, k - 3])
                along = 0.5 * (view[i + 1, k] - view[i - 1, k])
                square = across * across + along * along
                if square > most:
                    most = square
                    gradient[i, j, 0], gradient[i, j, 1] = across, along


def edge_profiles(
    gradients: Gradients, segments: Segments, low: float, high: float, step: float = OFFSET_STEP
) -> Array:
    """Strength of the edge along each segment at offsets low, low + step, ... (k, m), 0 to 1, over the views.

    Segments that leave the views have strength 0.
    """
    profiles = np.empty((len(segments.normal), round((high - low) / step) + 1))
    _edge_profiles(gradients, segments, low, step, profiles)
    return profiles


@compiled
def _edge_profiles(
    gradients: Gradients, segments: Segments, low: float, step: float, profiles: Array
) -> None:
    # Over the offsets innermost, without a branch: the compiler computes several at a time.
    (views, rows, columns), (begin, end, normal, _) = gradients.shape[:3], segments
    size, pixels, level = profiles.shape[1], gradients.reshape(views, -1), EDGE_LEVEL * EDGE_LEVEL
    at, (across, along, inside, total) = np.empty(size, np.uint32), np.empty((4, size), np.float32)
    one, two, row = np.uint32(1), np.uint32(2), np.uint32(2 * columns)
    for k in range(profiles.shape[0]):
        right, down = np.float32(normal[k, 0]), np.float32(normal[k, 1])
        total[:] = profiles[k] = 0
        for s in range(SEGMENT_SAMPLES):
            part = (s + 0.5) / SEGMENT_SAMPLES
            for m in range(size):
                offset = low + step * m
                u = begin[k, 0] + part * (end[k, 0] - begin[k, 0]) + offset * normal[k, 0]
                v = begin[k, 1] + part * (end[k, 1] - begin[k, 1]) + offset * normal[k, 1]
                inside[m] = within = 1 <= u < columns - 2 and 1 <= v < rows - 2
                profiles[k, m] += within
                # numbers with a sign would cost a test each
                i, j = np.uint32(v if within else 1.0), np.uint32(u if within else 1.0)
                at[m], across[m], along[m] = row * i + two * j, u - j, v - i
            for g in pixels:
                for m in range(size):
                    i = at[m]
                    above = right * g[i] + down * g[i + one]
                    above += across[m] * (right * g[i + two] + down * g[i + two + one] - above)
                    i += row
                    below = right * g[i] + down * g[i + one]
                    below += across[m] * (right * g[i + two] + down * g[i + two + one] - below)
                    square = (above + along[m] * (below - above)) ** 2
                    total[m] += inside[m] * square / (square + np.float32(level))
        for m in range(size):
            enough = profiles[k, m] >= INSIDE * SEGMENT_SAMPLES
            profiles[k, m] = total[m] / (profiles[k, m] * views) if enough else 0.0


def strip_colors(
    views: NDArray[np.float32], segments: Segments, low: float, high: float
) -> NDArray[np.float32]:
    """Mean colour along each segment at offsets low, low + `OFFSET_STEP`, ...: (k, views, m, 3)."""
    points = _points(segments, low, high, STRIP_SAMPLES)
    return np.stack([_sampled(view, points).mean(axis=2) for view in views], axis=1)


@compiled
def strongest_box(
    profiles: Array, jacobian: Array, low: float, moves: Array, step: float
) -> tuple[Array, float]:
    """Change (4,) of a box whose segments lie on the strongest edges, and their mean strength.

    Coordinate ascent along `moves` (d, 5), one after the other: changes of the sides, and how far they may go.
    """
    change = np.zeros(4)
    count, last = profiles.shape[0], profiles.shape[1] - 1.001
    high, strongest = low + step * (profiles.shape[1] - 1), -1.0
    limit = max(-low, high)
    start, slope = np.empty(count), np.empty(count)
    for d in range(moves.shape[0]):
        for k in range(count):
            start[k], slope[k] = -low / step, 0.0
            for c in range(4):
                start[k] += jacobian[k, c] * change[c] / step
                slope[k] += jacobian[k, c] * moves[d, c] / step
        first, best = max(low, -moves[d, 4]), 0.0
        for n in range(int(np.ceil((min(high, moves[d, 4]) - first) / TRIAL_STEP))):
            size, total = first + n * TRIAL_STEP, 0.0
            for k in range(count):
                at = min(max(start[k] + size * slope[k], 0.0), last)
                i = int(at)
                total += profiles[k, i] + (at - i) * (profiles[k, i + 1] - profiles[k, i])
            for c in range(4):
                if abs(change[c] + size * moves[d, c]) > limit:
                    total = -1.0
            if total > strongest * count:
                strongest, best = total / count, size
        for c in range(4):
            change[c] += best * moves[d, c]
    return change, strongest


def _points(segments: Segments, low: float, high: float, count: int) -> NDArray[np.float32]:
    """Points (k, m, count, 2) along each segment, moved along its normal by low, low + `OFFSET_STEP`, ..."""
    offsets = low + OFFSET_STEP * np.arange(round((high - low) / OFFSET_STEP) + 1)
    along = (np.arange(count) + 0.5) / count
    begin, side = segments.begin[:, None], (segments.end - segments.begin)[:, None]
    on = begin + along[:, None] * side
    moved = on[:, None] + offsets[:, None, None] * segments.normal[:, None, None]
    return moved.astype(np.float32)


def _sampled(image: NDArray[np.float32], points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values (..., channels) of an image at points (..., 2), linear between samples, its border repeated."""
    u, v = np.moveaxis(points.reshape(len(points), -1, 2), -1, 0)
    found = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32).reshape(*points.shape[:-1], -1)
