"""Outlines fitted to edges, to a fraction of a sample: the strongest of each shape, refined, and the outer rim.

Boxes are [left, top, right, bottom] in samples of the template (4,), before the rotation about their centre.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.schemas.settings import PanelOutlineSettings
from wayside.stages.kernels import Array
from wayside.stages.panel.outline_edges import Gradients, edge_profiles, strongest_box
from wayside.stages.panel.outline_shapes import (
    ASPECT,
    OUTLINE_SHAPES,
    Segments,
    box_size,
    growth,
    has_area,
    segments_of,
)

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


def strongest_outlines(
    gradients: Gradients, box: Array, settings: PanelOutlineSettings
) -> list[Outline]:
    """Outlines of the best shapes near a box, the strongest one of each."""
    reach = settings.inward, settings.outward
    found = [
        _strongest(gradients, shape, _in_proportion(shape, box), *reach, settings)
        for shape in OUTLINE_SHAPES
    ]
    # segments rotate as the proportions change: once more, near by
    found = [_strongest(gradients, o.shape, o.box, 0.0, 0.0, settings) for o in _with_area(found)]
    refined = [
        refine_outline(gradients, o, settings.free_search, settings, held=False)
        for o in _by_strength(_with_area(found))[: settings.most_refined]
    ]
    return [
        align_sides(gradients, o, settings) for o in _by_strength(refined)[: settings.most_inner]
    ]


def _with_area(outlines: list[Outline]) -> list[Outline]:
    return [outline for outline in outlines if has_area(outline.box)]


def _by_strength(outlines: list[Outline]) -> list[Outline]:
    return sorted(outlines, key=lambda outline: -outline.strength)


def _in_proportion(shape: str, box: Array) -> Array:
    """The box of the shape's own proportion about a box, or that itself where it has none."""
    if shape not in ASPECT:
        return box
    centre, tall = (box[:2] + box[2:]) / 2, np.sqrt(box_size(box).prod() / ASPECT[shape])
    half = np.array([ASPECT[shape] * tall, tall]) / 2
    return np.concatenate([centre - half, centre + half])


def _strongest(
    gradients: Gradients,
    shape: str,
    box: Array,
    inward: float,
    outward: float,
    settings: PanelOutlineSettings,
) -> Outline:
    """The strongest outline of a shape within fractions of a box's smaller side."""
    side, step = float(box_size(box).min()), settings.offset_step
    low = -step * np.ceil(max(inward * side + 1, settings.search) / step)
    high = step * np.ceil(max(outward * side + 1, settings.search) / step)
    segments = segments_of(shape, box)
    profiles = edge_profiles(gradients, segments, low, high, settings)
    change, strength = strongest_box(
        profiles, segments.jacobian, low, _DIRECTIONS[shape in ASPECT], max(-low, high), settings
    )
    return Outline(shape, box + change, 0.0, strength)


def align_sides(gradients: Gradients, outline: Outline, settings: PanelOutlineSettings) -> Outline:
    """The outline with all sides on the same one of several parallel lines (rim, border line).

    The profiles of all sides are alike: each side is shifted to where its profile correlates best with their mean.
    Where two sides would meet, it is the given one.
    """
    x = np.array([*outline.box, outline.rotation])
    reach, step = settings.side_search, settings.offset_step
    for _ in range(settings.side_rounds):
        segments = segments_of(outline.shape, x[:4], x[4])
        profiles = edge_profiles(gradients, segments, -2 * reach, 2 * reach, settings)
        half = round(reach / step)
        mean = profiles.mean(axis=0)[half:-half]
        windows = np.lib.stride_tricks.sliding_window_view(profiles, len(mean), axis=1)
        norm = np.sqrt((windows**2).sum(axis=2) * (mean**2).sum()) + 1e-9
        shift = (np.arange(windows.shape[1]) - half) * step
        correlation = (windows @ mean) / norm - settings.side_penalty * np.abs(shift)
        best = correlation.argmax(axis=1)
        weight = np.maximum(correlation.max(axis=1), 0.0) ** 2
        normal, right = _priors(outline.shape, x, x, settings)
        x = x + _least_squares(segments, shift[best], weight, normal, right, settings)
        if not has_area(x[:4]):
            return outline
    return outline._replace(box=x[:4], rotation=float(x[4]))


def refine_outline(
    gradients: Gradients,
    outline: Outline,
    search: float,
    settings: PanelOutlineSettings,
    *,
    held: bool,
) -> Outline:
    """Least squares (Cauchy weights) of the box's sides and rotation on the nearest edge of each segment.

    Parameters
    ----------
    gradients
        Of the registered views.
    outline
        Where to begin.
    search
        Range of the edges, samples.
    settings
        Scatter of edges, sides, rotation and proportions.
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
    for _ in range(settings.refine_iterations):
        segments = segments_of(shape, x[:4], x[4])
        profiles = edge_profiles(gradients, segments, -search, search, settings)
        strength = float(profiles[:, profiles.shape[1] // 2].mean())
        offset, weight = nearest_edges(profiles, search, settings)
        normal, right = _priors(shape, x, start if held else x, settings)
        change = _least_squares(segments, offset, weight, normal, right, settings)
        x += np.clip(change, -settings.refine_step, settings.refine_step)
        if not has_area(x[:4]):
            return outline
        if np.abs(change).max() < settings.refine_converged:
            break
    return Outline(shape, x[:4], float(x[4]), strength)


def rim_correction(gradients: Gradients, outline: Outline, settings: PanelOutlineSettings) -> Array:
    """Change (4,) of a box for a rim too narrow to have an edge of its own: it widens the outer flank of the edge."""
    segments = segments_of(outline.shape, outline.box, outline.rotation)
    reach, step = settings.flank, settings.offset_step
    profile = edge_profiles(gradients, segments, -reach, reach + 1, settings).mean(axis=0)
    centre, near = round(reach / step), round(1 / step)
    top = centre - near + int(np.argmax(profile[centre - near : centre + near + 1]))
    fallen = np.flatnonzero(profile[top:] < profile[top] / 2)
    flank = (top + fallen[0] - centre) * step if len(fallen) else reach + 1
    outward = settings.rim_fraction * (flank - settings.sharp_flank)
    limited = np.clip(outward, -settings.most_rim_inward, settings.most_rim_outward)
    return np.asarray(limited * growth(segments))


def side_variances(gradients: Gradients, outline: Outline, settings: PanelOutlineSettings) -> Array:
    """Variance (4,) of each side of a box about where it lies, by all edges that it could lie on alone, samples^2.

    The posterior of its offset, with the prior of a side and the information of an edge as in `refine_outline`; edges
    count by how far the side moves their segments. One clear edge leaves little; two of like strength, their distance.
    """
    segments = segments_of(outline.shape, outline.box, outline.rotation)
    step = settings.offset_step
    reach = step * np.ceil(settings.rival_sigmas * settings.side_sigma / step)
    profiles = edge_profiles(gradients, segments, -reach, reach, settings)
    offset = np.linspace(-reach, reach, profiles.shape[1])
    moves = segments.jacobian[:, :4]
    strength = np.zeros((4, len(offset)))
    for profile, move in zip(profiles, moves, strict=True):
        for side in np.flatnonzero(move):
            strength[side] += abs(move[side]) * np.interp(offset * move[side], offset, profile)
    strength /= np.abs(moves).sum(axis=0)[:, None]
    likelihood = strength / settings.edge_sigma**2 - (offset / settings.side_sigma) ** 2 / 2
    probability = np.exp(likelihood - likelihood.max(axis=1, keepdims=True))
    return np.asarray(probability @ offset**2 / probability.sum(axis=1))


def nearest_edges(
    profiles: Array, search: float, settings: PanelOutlineSettings
) -> tuple[Array, Array]:
    """Offset (k,) of each segment's edge, interpolated, and its weight; 0 and 0 where there is none."""
    centre, step = (profiles.shape[1] - 1) // 2, settings.offset_step
    inner = profiles[:, 1:-1]
    peak = (inner >= profiles[:, :-2]) & (inner > profiles[:, 2:])
    away = (np.arange(1, profiles.shape[1] - 1) - centre) * step / settings.offset_sigma
    value = np.where(peak, inner * np.exp(-0.5 * away**2), 0.0)
    at = value.argmax(axis=1) + 1
    row = np.arange(len(profiles))
    before, here, after = profiles[row, at - 1], profiles[row, at], profiles[row, at + 1]
    bend = before - 2 * here + after
    part = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=bend < 0)
    found = value.max(axis=1) > settings.weakest_edge
    offset = np.where(found, -search + step * (at + part), 0.0)
    return offset, np.where(found, here**2, 0.0)


def _priors(
    shape: str, x: Array, about: Array, settings: PanelOutlineSettings
) -> tuple[Array, Array]:
    """Normal matrix (5, 5) and right side (5,) of the priors of a box, in units of the scatter of an edge."""
    sigma = np.array([settings.side_sigma] * 4 + [np.radians(settings.rotation_sigma_deg)])
    hold = (settings.edge_sigma / sigma) ** 2
    normal, right = np.diag(hold), -hold * (x - about)
    if shape in ASPECT:
        by = np.array([-1, ASPECT[shape], 1, -ASPECT[shape], 0])
        weight = (settings.edge_sigma / (settings.aspect_sigma * (x[2] - x[0]))) ** 2
        normal += weight * np.outer(by, by)
        right -= weight * by * float(by @ x)
    return normal, right


def _least_squares(
    segments: Segments,
    offset: Array,
    weight: Array,
    normal: Array,
    right: Array,
    settings: PanelOutlineSettings,
) -> Array:
    change: Array = np.zeros(5)
    for _ in range(settings.refine_iterations):
        residual = offset - segments.jacobian @ change
        robust = weight / (1 + (residual / settings.edge_cauchy) ** 2)
        weighted = segments.jacobian * robust[:, None]
        matrix = segments.jacobian.T @ weighted + normal
        change = np.asarray(np.linalg.solve(matrix, weighted.T @ offset + right), np.float64)
    return change
