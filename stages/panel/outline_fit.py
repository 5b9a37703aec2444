"""Outlines fitted to edges, to a fraction of a sample: the strongest of each shape, refined, and the outer rim.

Boxes are [left, top, right, bottom] in samples of the template (4,), as all lengths, before the rotation about their
centre.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.stages.kernels import Array
from wayside.stages.panel.outline_edges import OFFSET_STEP, Gradients, edge_profiles, strongest_box
from wayside.stages.panel.outline_shapes import (
    ASPECT,
    OUTLINE_SHAPES,
    Segments,
    box_size,
    growth,
    has_area,
    segments_of,
)

INWARD = 0.12
"""The strongest outline lies within the box by this fraction of the smaller side at most."""
OUTWARD = 0.28
"""The strongest outline lies outside the box by this fraction at most."""
SEARCH = 3.0
"""The strongest outline is sought so far, either way, at least."""
MOST_REFINED = 3
"""Shapes that are refined."""
MOST_INNER = 2
"""Shapes round whose strongest outline candidates are sought."""
SIDE_ROUNDS = 2
"""Rounds of aligning the profiles of the sides."""
SIDE_SEARCH = 4.0
"""Range of the shift that aligns the profiles of the sides."""
SIDE_PENALTY = 0.01
"""Correlation that a shift of a side must gain for each sample."""
REFINE_ITERATIONS = 4
"""Steps of a fit of sides and rotation, and of its weights in each, at most."""
REFINE_STEP = 2.0
"""Change of a side in one step at most (of the rotation: rad)."""
REFINE_CONVERGED = 0.02
"""Shorter steps (of the rotation: rad) end the fit."""
FREE_SEARCH = 2.0
"""Range of the edges where sides are free."""
SIDE_SIGMA = 1.0
"""Scatter of a side about its start (prior)."""
RIVAL_SIGMAS = 4.0
"""Edges within so many standard deviations of a side, either way, are its rivals."""
ROTATION_SIGMA_DEG = 1.5
"""Scatter of the rotation in the plane (prior)."""
ASPECT_SIGMA = 0.03
"""Relative scatter of the proportion of shapes that have one."""
EDGE_SIGMA = 0.35
"""Scatter of the edge of one segment."""
EDGE_CAUCHY = 0.5
"""Scale of the Cauchy weight of a segment's residual."""
OFFSET_SIGMA = 1.0
"""Standard deviation of the weight that prefers the nearer edges of a segment."""
WEAKEST_EDGE = 0.05
"""Strength below which a segment has no edge."""
FLANK = 4.0
"""Range in which the outer flank of the edge is measured."""
SHARP_FLANK = 1.7
"""Width of a plain edge to half of its height."""
RIM_FRACTION = 0.7
"""Fraction of the remaining width that is rim."""
MOST_RIM_INWARD = 0.7
"""The rim moves the outline inwards by this at most."""
MOST_RIM_OUTWARD = 1.4
"""The rim moves the outline outwards by this at most."""
_DIRECTIONS = {
    False: np.eye(4),
    True: np.array(
        [
            [0.5, 0, 0.5, 0],
            [0, 0.5, 0, 0.5],
            [-0.5, -0.5, 0.5, 0.5],
            [-0.5, 0, 0.5, 0],
            [0, -0.5, 0, 0.5],
        ]
    ),
}
"""How boxes change: sides of a rectangle one by one; shapes of one proportion move and grow."""


class Outline(NamedTuple):
    """A fitted outline: shape, box, rotation (rad, clockwise), mean edge strength 0 to 1."""

    shape: str
    box: Array
    rotation: float
    strength: float


def strongest_outlines(gradients: Gradients, box: Array) -> list[Outline]:
    """Outlines of the best shapes near a box, the strongest one of each."""
    reach = INWARD, OUTWARD
    found = [
        _strongest(gradients, shape, _in_proportion(shape, box), *reach) for shape in OUTLINE_SHAPES
    ]
    # segments rotate as the proportions change: once more, near by
    found = [_strongest(gradients, o.shape, o.box, 0.0, 0.0) for o in _with_area(found)]
    refined = [
        refine_outline(gradients, o, FREE_SEARCH, held=False)
        for o in _by_strength(_with_area(found))[:MOST_REFINED]
    ]
    return [align_sides(gradients, o) for o in _by_strength(refined)[:MOST_INNER]]


def _with_area(outlines: list[Outline]) -> list[Outline]:
    return [outline for outline in outlines if has_area(outline.box)]


def _by_strength(outlines: list[Outline]) -> list[Outline]:
    return sorted(outlines, key=lambda outline: -outline.strength)


def _in_proportion(shape: str, box: Array) -> Array:
    """The box of the shape's own proportion about a box, or the box itself."""
    if shape not in ASPECT:
        return box
    centre, tall = (box[:2] + box[2:]) / 2, np.sqrt(box_size(box).prod() / ASPECT[shape])
    half = np.array([ASPECT[shape] * tall, tall]) / 2
    return np.concatenate([centre - half, centre + half])


def _strongest(
    gradients: Gradients, shape: str, box: Array, inward: float, outward: float
) -> Outline:
    """The strongest outline of a shape within fractions of a box's smaller side."""
    side, step = float(box_size(box).min()), OFFSET_STEP
    low = -step * np.ceil(max(inward * side + 1, SEARCH) / step)
    high = step * np.ceil(max(outward * side + 1, SEARCH) / step)
    segments = segments_of(shape, box)
    profiles = edge_profiles(gradients, segments, low, high)
    change, strength = strongest_box(
        profiles, segments.jacobian, low, _DIRECTIONS[shape in ASPECT], max(-low, high)
    )
    return Outline(shape, box + change, 0.0, strength)


def align_sides(gradients: Gradients, outline: Outline) -> Outline:
    """The outline with all sides on the same one of several parallel lines (rim, border line).

    The profiles of all sides are alike: each side is shifted to where its profile correlates best with their mean.
    Where two sides would meet, it is the given one.
    """
    x = np.array([*outline.box, outline.rotation])
    reach, step = SIDE_SEARCH, OFFSET_STEP
    for _ in range(SIDE_ROUNDS):
        segments = segments_of(outline.shape, x[:4], x[4])
        profiles = edge_profiles(gradients, segments, -2 * reach, 2 * reach)
        half = round(reach / step)
        mean = profiles.mean(axis=0)[half:-half]
        windows = np.lib.stride_tricks.sliding_window_view(profiles, len(mean), axis=1)
        norm = np.sqrt((windows**2).sum(axis=2) * (mean**2).sum()) + 1e-9
        shift = (np.arange(windows.shape[1]) - half) * step
        correlation = (windows @ mean) / norm - SIDE_PENALTY * np.abs(shift)
        best = correlation.argmax(axis=1)
        weight = np.maximum(correlation.max(axis=1), 0.0) ** 2
        normal, right = _priors(outline.shape, x, x)
        x = x + _least_squares(segments, shift[best], weight, normal, right)
        if not has_area(x[:4]):
            return outline
    return outline._replace(box=x[:4], rotation=float(x[4]))


def refine_outline(gradients: Gradients, outline: Outline, search: float, *, held: bool) -> Outline:
    """Least squares (Cauchy weights) of the box's sides and rotation on the nearest edge of each segment.

    Parameters
    ----------
    gradients
        Of the registered views.
    outline
        Where to begin.
    search
        Range of the edges, samples.
    held
        Whether sides and rotation scatter about where they begin; else about where the step before left them.

    Returns
    -------
    Outline
        The given one where two sides meet on one edge.
    """
    shape = outline.shape
    start = np.array([*outline.box, outline.rotation])
    x, strength = start.copy(), 0.0
    for _ in range(REFINE_ITERATIONS):
        segments = segments_of(shape, x[:4], x[4])
        profiles = edge_profiles(gradients, segments, -search, search)
        strength = float(profiles[:, profiles.shape[1] // 2].mean())
        offset, weight = nearest_edges(profiles, search)
        normal, right = _priors(shape, x, start if held else x)
        change = _least_squares(segments, offset, weight, normal, right)
        x += np.clip(change, -REFINE_STEP, REFINE_STEP)
        if not has_area(x[:4]):
            return outline
        if np.abs(change).max() < REFINE_CONVERGED:
            break
    return Outline(shape, x[:4], float(x[4]), strength)


def rim_correction(gradients: Gradients, outline: Outline) -> Array:
    """Change (4,) of a box for a rim too narrow to have an edge of its own: it widens the outer flank of the edge."""
    segments = segments_of(outline.shape, outline.box, outline.rotation)
    reach, step = FLANK, OFFSET_STEP
    profile = edge_profiles(gradients, segments, -reach, reach + 1).mean(axis=0)
    centre, near = round(reach / step), round(1 / step)
    top = centre - near + int(np.argmax(profile[centre - near : centre + near + 1]))
    fallen = np.flatnonzero(profile[top:] < profile[top] / 2)
    flank = (top + fallen[0] - centre) * step if len(fallen) else reach + 1
    outward = RIM_FRACTION * (flank - SHARP_FLANK)
    limited = np.clip(outward, -MOST_RIM_INWARD, MOST_RIM_OUTWARD)
    return np.asarray(limited * growth(segments))


def side_variances(gradients: Gradients, outline: Outline) -> Array:
    """Variance (4,) of each side of a box about where it lies, by all edges that it could lie on alone, samples^2.

    The posterior of its offset, with the prior of a side and the information of an edge as in `refine_outline`; edges
    count by how far the side moves their segments. One clear edge leaves little; two of like strength, their distance.
    """
    segments = segments_of(outline.shape, outline.box, outline.rotation)
    step = OFFSET_STEP
    reach = step * np.ceil(RIVAL_SIGMAS * SIDE_SIGMA / step)
    profiles = edge_profiles(gradients, segments, -reach, reach)
    offset = np.linspace(-reach, reach, profiles.shape[1])
    moves = segments.jacobian[:, :4]
    strength = np.zeros((4, len(offset)))
    for profile, move in zip(profiles, moves, strict=True):
        for side in np.flatnonzero(move):
            strength[side] += abs(move[side]) * np.interp(offset * move[side], offset, profile)
    strength /= np.abs(moves).sum(axis=0)[:, None]
    likelihood = strength / EDGE_SIGMA**2 - (offset / SIDE_SIGMA) ** 2 / 2
    probability = np.exp(likelihood - likelihood.max(axis=1, keepdims=True))
    return np.asarray(probability @ offset**2 / probability.sum(axis=1))


def nearest_edges(profiles: Array, search: float) -> tuple[Array, Array]:
    """Offset (k,) of each segment's edge, interpolated, and its weight. Both are 0 without an edge."""
    centre, step = (profiles.shape[1] - 1) // 2, OFFSET_STEP
    inner = profiles[:, 1:-1]
    peak = (inner >= profiles[:, :-2]) & (inner > profiles[:, 2:])
    away = (np.arange(1, profiles.shape[1] - 1) - centre) * step / OFFSET_SIGMA
    value = np.where(peak, inner * np.exp(-0.5 * away**2), 0.0)
    at = value.argmax(axis=1) + 1
    row = np.arange(len(profiles))
    before, here, after = profiles[row, at - 1], profiles[row, at], profiles[row, at + 1]
    bend = before - 2 * here + after
    part = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=bend < 0)
    found = value.max(axis=1) > WEAKEST_EDGE
    offset = np.where(found, -search + step * (at + part), 0.0)
    return offset, np.where(found, here**2, 0.0)


def _priors(shape: str, x: Array, about: Array) -> tuple[Array, Array]:
    """Normal matrix (5, 5) and right side (5,) of the priors of a box, in units of the scatter of an edge."""
    sigma = np.array([SIDE_SIGMA] * 4 + [np.radians(ROTATION_SIGMA_DEG)])
    hold = (EDGE_SIGMA / sigma) ** 2
    normal, right = np.diag(hold), -hold * (x - about)
    if shape in ASPECT:
        by = np.array([-1, ASPECT[shape], 1, -ASPECT[shape], 0])
        weight = (EDGE_SIGMA / (ASPECT_SIGMA * (x[2] - x[0]))) ** 2
        normal += weight * np.outer(by, by)
        right -= weight * by * float(by @ x)
    return normal, right


def _least_squares(
    segments: Segments, offset: Array, weight: Array, normal: Array, right: Array
) -> Array:
    change: Array = np.zeros(5)
    for _ in range(REFINE_ITERATIONS):
        residual = offset - segments.jacobian @ change
        robust = weight / (1 + (residual / EDGE_CAUCHY) ** 2)
        weighted = segments.jacobian * robust[:, None]
        matrix = segments.jacobian.T @ weighted + normal
        change = np.asarray(np.linalg.solve(matrix, weighted.T @ offset + right), np.float64)
    return change
