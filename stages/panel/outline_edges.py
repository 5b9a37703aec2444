"""Strength of edges along the segments of an outline, in registered views (rows, columns, 3).

What belongs to a face is at the same samples in all views; its background moves from view to view. An edge of gradient
e counts as e^2 / (e^2 + c^2), so that a faint rim all along an outline outweighs a strong letter. Lengths are in
samples of the template.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array, require_array
from wayside.stages.panel.outline_shapes import Segments

OFFSET_STEP = 0.25
"""Distance between the places where an edge is sought."""
EDGE_LEVEL = 12.0
"""Gradient of an edge of strength one half, grey levels a sample."""
SEGMENT_SAMPLES = 12
"""Points at which a segment is compared."""
STRIP_SAMPLES = 3
"""Points of a segment whose mean is the colour of its strip."""
INSIDE = 0.6
"""Fraction of a segment that lies in the views at least."""
TRIAL_STEP = 0.5
"""Distance between the boxes that are tried for the strongest outline."""
TRIAL_RANGES = (np.inf, 2.0, 2.0)
"""Range of a side, either way, in each sweep over the sides of a box."""

Gradients = NDArray[np.float32]
"""Gradient right and down of each view, of the channel that changes most, (views, rows, columns, 2)."""


def gradients_of(views: NDArray[np.float32]) -> Gradients:
    """Gradients of views (n, rows, columns, 3), grey levels a sample; raises ValueError for other arrays."""
    require_array(views, "views", np.float32, (None, None, None, 3))
    half = np.float32(0.5)
    across = (views[:, 1:-1, 2:] - views[:, 1:-1, :-2]) * half
    along = (views[:, 2:, 1:-1] - views[:, :-2, 1:-1]) * half
    most = (across**2 + along**2).argmax(axis=3)[..., None]
    fields = [np.take_along_axis(part, most, axis=3)[..., 0] for part in (across, along)]
    return np.pad(np.stack(fields, axis=-1), ((0, 0), (1, 1), (1, 1), (0, 0)))


def edge_profiles(gradients: Gradients, segments: Segments, low: float, high: float) -> Array:
    """Strength of the edge along each segment at offsets low, low + `OFFSET_STEP`, ... (k, m), 0 to 1, over the views.

    Segments that leave the views have strength 0.
    """
    points = _points(segments, low, high, SEGMENT_SAMPLES)
    rows, columns = gradients.shape[1:3]
    inside = ((points >= 1) & (points < np.array([columns - 2, rows - 2]))).all(axis=-1)
    normal = segments.normal.astype(np.float32)[:, None, None]
    strength = np.zeros(points.shape[:3], np.float32)
    for view in gradients:
        square = (_sampled(view, points) * normal).sum(axis=-1) ** 2
        strength += square / (square + np.float32(EDGE_LEVEL**2))
    count = inside.sum(axis=2)
    mean = (strength * inside).sum(axis=2) / np.maximum(count, 1) / len(gradients)
    return np.where(count >= INSIDE * SEGMENT_SAMPLES, mean, 0.0).astype(np.float64)


def strip_colors(
    views: NDArray[np.float32], segments: Segments, low: float, high: float
) -> NDArray[np.float32]:
    """Mean colour along each segment at offsets low, low + `OFFSET_STEP`, ...: (k, views, m, 3)."""
    points = _points(segments, low, high, STRIP_SAMPLES)
    return np.stack([_sampled(view, points).mean(axis=2) for view in views], axis=1)


def strongest_box(
    profiles: Array, jacobian: Array, low: float, directions: Array
) -> tuple[Array, float]:
    """Change (4,) of a box whose segments lie on the strongest edges, and their mean strength.

    Coordinate ascent: the whole box grows first, then each of the `directions` (d, 4) is changed alone.
    """
    high = low + OFFSET_STEP * (profiles.shape[1] - 1)
    segment, limit = np.arange(len(profiles)), max(-low, high)

    def strongest(changes: Array) -> tuple[Array, float]:
        at = (changes @ jacobian[:, :4].T - low) / OFFSET_STEP
        at = np.clip(at, 0, profiles.shape[1] - 1.001)
        left = at.astype(np.int64)
        part = at - left
        strength = (1 - part) * profiles[segment, left] + part * profiles[segment, left + 1]
        mean = strength.mean(axis=1)
        mean[(np.abs(changes) > limit).any(axis=1)] = -1.0
        best = int(mean.argmax())
        return changes[best], float(mean[best])

    change, strength = strongest(np.arange(low, high, TRIAL_STEP)[:, None] * [-1, -1, 1, 1])
    for reach in TRIAL_RANGES:
        sizes = np.arange(max(low, -reach), min(high, reach), TRIAL_STEP)
        for direction in directions:
            change, strength = strongest(np.vstack([change, change + sizes[:, None] * direction]))
    return change, strength


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
