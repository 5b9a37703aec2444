"""Strength of edges along the segments of an outline, in registered views (rows, columns, 3).

What belongs to a face is at the same samples in all views; its background moves from view to view. An edge of gradient
e counts as e^2 / (e^2 + c^2), so that a faint rim all along an outline outweighs a strong letter. Lengths are in
samples of the template.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, compiled, require_array
from wayside.stages.panel.outline_shapes import Segments

OFFSET_STEP = 0.25
"""Distance between the places where an edge is sought."""
EDGE_LEVEL = 12.0
"""Gradient of an edge of strength one half, grey levels a sample."""
SEGMENT_SAMPLES = 16
"""Points at which a segment is compared at most."""
LEAST_SEGMENT_SAMPLES = 4
"""Points at which a segment is compared at least."""
INSIDE = 0.6
"""Fraction of a segment that lies in the views at least."""
TRIAL_STEP = 0.5
"""Distance between the boxes that are tried for the strongest outline."""
TRIAL_SWEEPS = 3
"""Sweeps over the sides of a box, the first of them over the whole range."""
TRIAL_RANGE = 2.0
"""Range of a side, either way, in the further sweeps."""
STRIP_SAMPLES = 3
"""Samples along a segment whose mean is the colour of its strip."""


class Gradients(NamedTuple):
    """Gradient right and down of each view, (views, rows, columns) each, of the channel that changes most."""

    right: NDArray[np.float32]
    down: NDArray[np.float32]

    def nearest(self, count: int) -> Gradients:
        """Those of the first views alone."""
        return Gradients(self.right[:count], self.down[:count])


def gradients_of(views: NDArray[np.float32]) -> Gradients:
    """Gradients of views (n, rows, columns, 3), grey levels a sample; raises ValueError for other arrays."""
    require_array(views, "views", np.float32, (None, None, None, 3))
    half = np.float32(0.5)
    across = (views[:, 1:-1, 2:] - views[:, 1:-1, :-2]) * half
    along = (views[:, 2:, 1:-1] - views[:, :-2, 1:-1]) * half
    most = (across**2 + along**2).argmax(axis=3)[..., None]
    border = ((0, 0), (1, 1), (1, 1))
    fields = (np.take_along_axis(part, most, axis=3)[..., 0] for part in (across, along))
    return Gradients(*(np.pad(part, border) for part in fields))


def edge_profiles(gradients: Gradients, segments: Segments, low: float, high: float) -> Array:
    """Strength of the edge along each segment at offsets low, low + `OFFSET_STEP`, ... (k, m), 0 to 1, over the views.

    Segments that leave the views have strength 0.
    """
    right, down = gradients
    require_array(right, "right", np.float32, (None, None, None))
    require_array(down, "down", np.float32, right.shape)
    count = round((high - low) / OFFSET_STEP) + 1
    profiles = np.zeros((len(segments.begin), count))
    samples = (LEAST_SEGMENT_SAMPLES, SEGMENT_SAMPLES)
    ends = (segments.begin, segments.end, segments.normal)
    _profiles(right, down, *ends, low, OFFSET_STEP, samples, EDGE_LEVEL, INSIDE, profiles)
    return profiles


def strip_colors(
    views: NDArray[np.float32], segments: Segments, low: float, high: float
) -> NDArray[np.float32]:
    """Mean colour along each segment at offsets low, low + `OFFSET_STEP`, ...: (k, views, m, 3)."""
    require_array(views, "views", np.float32, (None, None, None, 3))
    step, samples = OFFSET_STEP, STRIP_SAMPLES
    ends = (segments.begin, segments.end, segments.normal)
    colors = np.zeros((len(segments.begin), len(views), round((high - low) / step) + 1, 3))
    _strips(views, *ends, low, step, samples, colors)
    return (colors / samples).astype(np.float32)


def strongest_box(
    profiles: Array, jacobian: Array, low: float, directions: Array, limit: float
) -> tuple[Array, float]:
    """Change (4,) of a box whose segments lie on the strongest edges, and their mean strength.

    Coordinate ascent: the whole box grows first, then each of the `directions` (d, 4) is changed alone.
    """
    change = np.zeros(4)
    trials = OFFSET_STEP, TRIAL_STEP, TRIAL_SWEEPS, TRIAL_RANGE
    sides = np.ascontiguousarray(jacobian[:, :4])
    best = _ascend(profiles, sides, low, directions, limit, *trials, change)
    return change, float(best)


@compiled
def _profiles(
    right: NDArray[np.float32],
    down: NDArray[np.float32],
    begin: Array,
    end: Array,
    normal: Array,
    low: float,
    step: float,
    samples_of: tuple[int, int],
    level: float,
    inside: float,
    profiles: Array,
) -> None:
    views, rows, columns = right.shape
    for k in range(begin.shape[0]):
        du, dv = end[k, 0] - begin[k, 0], end[k, 1] - begin[k, 1]
        samples = min(max(samples_of[0], int(np.sqrt(du * du + dv * dv))), samples_of[1])
        for m in range(profiles.shape[1]):
            offset = low + m * step
            total, count = 0.0, 0
            for n in range(samples):
                fraction = (n + 0.5) / samples
                u = begin[k, 0] + fraction * du + offset * normal[k, 0]
                v = begin[k, 1] + fraction * dv + offset * normal[k, 1]
                if not (u >= 1 and v >= 1 and u < columns - 2 and v < rows - 2):
                    continue
                x, y = int(u), int(v)
                a, b = u - x, v - y
                w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
                for q in range(views):
                    gx = w00 * right[q, y, x] + w01 * right[q, y, x + 1]
                    gx += w10 * right[q, y + 1, x] + w11 * right[q, y + 1, x + 1]
                    gy = w00 * down[q, y, x] + w01 * down[q, y, x + 1]
                    gy += w10 * down[q, y + 1, x] + w11 * down[q, y + 1, x + 1]
                    edge = gx * normal[k, 0] + gy * normal[k, 1]
                    total += edge * edge / (edge * edge + level * level)
                    count += 1
            if count >= inside * samples * views:
                profiles[k, m] = total / count


@compiled
def _strips(
    views: NDArray[np.float32],
    begin: Array,
    end: Array,
    normal: Array,
    low: float,
    step: float,
    samples: int,
    colors: Array,
) -> None:
    count, rows, columns, _ = views.shape
    for k in range(begin.shape[0]):
        du, dv = end[k, 0] - begin[k, 0], end[k, 1] - begin[k, 1]
        for m in range(colors.shape[2]):
            offset = low + m * step
            for n in range(samples):
                fraction = (n + 0.5) / samples
                u = begin[k, 0] + fraction * du + offset * normal[k, 0]
                v = begin[k, 1] + fraction * dv + offset * normal[k, 1]
                u, v = min(max(u, 0.0), columns - 1.001), min(max(v, 0.0), rows - 1.001)
                x, y = int(u), int(v)
                a, b = u - x, v - y
                for q in range(count):
                    for c in range(3):
                        above = (1 - a) * views[q, y, x, c] + a * views[q, y, x + 1, c]
                        below = (1 - a) * views[q, y + 1, x, c] + a * views[q, y + 1, x + 1, c]
                        colors[k, q, m, c] += (1 - b) * above + b * below


@compiled
def _strength(profiles: Array, jacobian: Array, low: float, step: float, change: Array) -> float:
    total = 0.0
    last = profiles.shape[1] - 1.001
    for k in range(profiles.shape[0]):
        offset = 0.0
        for c in range(4):
            offset += jacobian[k, c] * change[c]
        at = min(max((offset - low) / step, 0.0), last)
        i = int(at)
        total += profiles[k, i] + (at - i) * (profiles[k, i + 1] - profiles[k, i])
    return float(total / profiles.shape[0])


@compiled
def _ascend(
    profiles: Array,
    jacobian: Array,
    low: float,
    directions: Array,
    limit: float,
    offset_step: float,
    step: float,
    sweeps: int,
    fine: float,
    change: Array,
) -> float:
    high = low + offset_step * (profiles.shape[1] - 1)
    trial = np.zeros(4)
    best = -1.0
    steps = int((high - low) / step) + 1
    for s in range(steps):
        size = low + step * s
        for c in range(4):
            trial[c] = -size if c < 2 else size
        strength = _strength(profiles, jacobian, low, offset_step, trial)
        if strength > best:
            best = strength
            change[:] = trial
    for sweep in range(sweeps):
        for d in range(directions.shape[0]):
            start = change.copy()
            count = steps if sweep == 0 else int(2 * fine / step) + 1
            for s in range(count):
                size = (low if sweep == 0 else -fine) + step * s
                inside = True
                for c in range(4):
                    trial[c] = start[c] + size * directions[d, c]
                    inside = inside and abs(trial[c]) <= limit
                if not inside:
                    continue
                strength = _strength(profiles, jacobian, low, offset_step, trial)
                if strength > best + 1e-9:
                    best = strength
                    change[:] = trial
    return best
