"""The outer outline of a face, to a fraction of a sample.

A face has several outlines one within the other: legend, inner field, border line, rim. The strongest is found first,
for each shape; then those around it are weighed against each other: the edge, the evenness of the strip within it (a
rim has one colour all round, what lies behind the panel has not), and how far it strays from the box that was found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array
from wayside.stages.mapping.outline_edges import (
    ASPECT,
    ASPECT_SIGMA,
    SHAPES,
    STEP,
    Segments,
    edge_profiles,
    segments_of,
    slopes,
    strip_colors,
    strongest_box,
)

INWARD, OUTWARD, REACH = 0.12, 0.28, 0.3
"""Shares of a box's smaller side by which the strongest outline may lie within or outside it; further ones outside."""
BACK = 3.0
"""Samples within the strongest outline from which on others are looked for."""
MOST_TRIED = 6
"""Outlines looked at again, of all shapes and proportions."""
FAINTEST = 0.15
"""Share of the strongest edge below which an outline is not considered."""
SHARPEST_VIEWS = 2
"""Views that the last fit uses: those from nearest."""
CLOSE, DRIFT = 1.5, 1.0
"""Samples around an outline where its edge is sought, and scatter of its sides about the whole."""
TURN_SIGMA = float(np.radians(1.5))
ALIKE_REACH = 4.0
"""Samples by which sides are shifted to agree, and on either side of which they are compared."""
EDGE_SIGMA = 0.35
"""Scatter of the edge of one segment, samples."""
WEIGHTS = np.array([-6.3, 4.2, 14.5, -3.4, 4.6, 4.8, 4.8, -12.4, -5.0, -2.2, 3.0, 2.9])
"""What speaks for an outline, learned on rendered drives: share of the strongest edge, its logarithm, strength of the
inner outline, unevenness of the strip within (30 grey levels) alone and times the edge, growth of width and of height
(logarithms), their squares, their difference, whether the edge is a peak or a shoulder, whether a rectangle."""
PLAIN = 0.4
"""Scatter of width and height where the outline is certain, samples."""
FLANK, PLAIN_FLANK, FLANK_SHARE = 4.0, 1.7, 0.7
"""Samples over which an edge falls off outwards: looked at, a plain edge to its half; share of the rest that is rim."""


class Face(NamedTuple):
    """An outline: shape, box [left, top, right, bottom] before the turn (samples; rad clockwise), strength 0 to 1.

    sigma (2,): scatter of width and height, samples.
    """

    shape: str
    box: Array
    turn: float
    strength: float
    sigma: Array


class _Outline(NamedTuple):
    shape: str
    box: Array
    turn: float
    strength: float


class _Rival(NamedTuple):
    outline: _Outline
    evidence: Array


Slopes = tuple[NDArray[np.float32], NDArray[np.float32]]


def fit_face(views: NDArray[np.float32], boxes: Sequence[Array]) -> Face | None:
    """Find the outer outline of the face that views in register show.

    Parameters
    ----------
    views
        (n, rows, columns, 3) float32, the sharpest first.
    boxes
        Where the face may be, [left, top, right, bottom] in samples (4,) each; the first is the likeliest.

    Returns
    -------
    Face or None
        None where no shape has edges all round.
    """
    edges = slopes(views)
    rivals = list(_rivals(views, edges, boxes))
    if not rivals:
        return None
    value = np.array([rival.evidence for rival in rivals]) @ WEIGHTS
    best = int(np.argmax(value))
    share = np.exp(value - value[best])
    share /= share.sum()
    chosen = rivals[best].outline
    sharp = (edges[0][:SHARPEST_VIEWS], edges[1][:SHARPEST_VIEWS])
    fine = refined(sharp, chosen.shape, chosen.box, chosen.turn)
    box = fine.box + _hidden_rim(sharp, fine)
    sizes = np.array([_size(rival.outline.box) for rival in rivals])
    sigma = np.sqrt((share[:, None] * (sizes - sizes[best]) ** 2).sum(axis=0) + PLAIN**2)
    return Face(chosen.shape, box, fine.turn, chosen.strength, sigma)


def _rivals(views: NDArray[np.float32], edges: Slopes, boxes: Sequence[Array]) -> Iterator[_Rival]:
    """Outlines that may be the outer one, with what speaks for each."""
    found = strongest(edges, boxes[0])
    for box in boxes[1:]:
        found += strongest(edges, box)[:1]
    for inner in found:
        side = float(_size(inner.box).min())
        high = STEP * np.ceil((REACH * side + 1) / STEP)
        segments = segments_of(inner.shape, inner.box, inner.turn)
        profiles = edge_profiles(*edges, segments, -BACK, high)
        # of the weaker three quarters: an outline has edges all round
        kept = -(-3 * len(profiles) // 4)
        strength = np.sort(profiles, axis=0)[:kept].mean(axis=0)
        colors = strip_colors(views, segments, -BACK, high)
        middle = np.median(colors, axis=(0, 1))
        uneven = np.median(np.abs(colors - middle).max(axis=3), axis=(0, 1))
        grow = _growth(segments)
        peaks = _peaks(strength)
        top = float(max((strength[i] for i in peaks), default=0.0))
        for i in sorted({*peaks, *_shoulders(strength)}):
            offset = i * STEP - BACK
            if offset <= -CLOSE or top <= 0 or strength[i] < FAINTEST * top:
                continue
            box = inner.box + offset * grow
            within = float(uneven[max(0, i - 6) : i + 1].min())
            evidence = _evidence(inner, box, boxes[0], float(strength[i]) / top, within, i in peaks)
            yield _Rival(_Outline(inner.shape, box, inner.turn, inner.strength), evidence)


def _evidence(
    inner: _Outline, box: Array, likely: Array, edge: float, within: float, peak: bool
) -> Array:
    """Numbers (12,) about an outline, for `WEIGHTS`."""
    wide, tall = np.log(_size(box) / _size(likely))
    uneven = min(within, 60.0) / 30
    return np.array(
        [
            edge,
            np.log(edge),
            inner.strength,
            uneven,
            edge * uneven,
            wide,
            tall,
            wide**2,
            tall**2,
            abs(wide - tall),
            float(peak),
            float(inner.shape == "rectangle"),
        ]
    )


def strongest(edges: Slopes, box: Array) -> list[_Outline]:
    """The two likeliest shapes near a box, each with its strongest outline, best first."""
    starts = [(shape, start) for shape in SHAPES for start in _starts(shape, box)]
    found = [_strongest(edges, shape, start, INWARD, OUTWARD) for shape, start in starts]
    found.sort(key=lambda outline: -outline.strength)
    # sides turn as the proportions change: once more, near by
    found = [_strongest(edges, o.shape, o.box, 0.0, 0.0) for o in found[:MOST_TRIED]]
    found.sort(key=lambda outline: -outline.strength)
    best = {outline.shape: outline for outline in reversed(found)}
    likely = sorted(best.values(), key=lambda outline: -outline.strength)[:3]
    better = [refined(edges, o.shape, o.box, 0.0, drift=None) for o in likely]
    better.sort(key=lambda outline: -outline.strength)
    return [_agreed(edges, outline) for outline in better[:2]]


def _agreed(edges: Slopes, outline: _Outline) -> _Outline:
    """The outline with all its sides on the same one of several lines that run beside each other.

    Rim and border line look alike on all sides: each side is shifted to where its profile is most like the mean.
    """
    x = np.array([*outline.box, outline.turn])
    for _ in range(2):
        segments = segments_of(outline.shape, x[:4], x[4])
        profiles = edge_profiles(*edges, segments, -2 * ALIKE_REACH, 2 * ALIKE_REACH)
        half = round(ALIKE_REACH / STEP)
        mean = profiles.mean(axis=0)[half:-half]
        windows = np.lib.stride_tricks.sliding_window_view(profiles, len(mean), axis=1)
        norm = np.sqrt((windows**2).sum(axis=2) * (mean**2).sum()) + 1e-9
        away = (np.arange(windows.shape[1]) - half) * STEP
        alike = (windows @ mean) / norm - 0.01 * np.abs(away)
        best = alike.argmax(axis=1)
        weight = np.maximum(alike.max(axis=1), 0.0) ** 2
        normal, right = _priors(outline.shape, x, x, None)
        x = x + _least_squares(segments, away[best], weight, normal, right)
    return outline._replace(box=x[:4], turn=float(x[4]))


def _starts(shape: str, box: Array) -> list[Array]:
    if shape not in ASPECT:
        return [box]
    middle, size = (box[:2] + box[2:]) / 2, _size(box)
    tall = np.sqrt(size.prod() / ASPECT[shape])
    half = np.array([ASPECT[shape] * tall, tall]) / 2
    own = [np.concatenate([middle - half * k, middle + half * k]) for k in (1.0, 1.25)]
    return [*own, box] if shape in ("triangle", "triangle_up", "pennant") else own[:1]


def _strongest(edges: Slopes, shape: str, box: Array, inward: float, outward: float) -> _Outline:
    """The strongest outline of a shape within shares of a box's smaller side, and three samples at least."""
    side = float(_size(box).min())
    low = -STEP * np.ceil(max(inward * side + 1, 3.0) / STEP)
    high = STEP * np.ceil(max(outward * side + 1, 3.0) / STEP)
    segments = segments_of(shape, box)
    profiles = edge_profiles(*edges, segments, low, high)
    change, strength = strongest_box(
        profiles, segments.jacobian, low, _DIRECTIONS[shape in ASPECT], max(-low, high)
    )
    return _Outline(shape, box + change, 0.0, strength)


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


def refined(
    edges: Slopes, shape: str, box: Array, turn: float, *, drift: float | None = DRIFT
) -> _Outline:
    """Least squares (Cauchy weights) of the box's sides and turn on the nearest edge of each segment.

    The sides keep within `drift` samples of where they began, where given, and shapes of one proportion nearly to it.
    """
    reach = 2.0 if drift is None else CLOSE
    start = np.array([*box, turn])
    x, strength = start.copy(), 0.0
    for _ in range(4):
        segments = segments_of(shape, x[:4], x[4])
        profiles = edge_profiles(*edges, segments, -reach, reach)
        strength = float(profiles[:, profiles.shape[1] // 2].mean())
        offset, weight = nearest_edges(profiles, reach)
        normal, right = _priors(shape, x, start, drift)
        change = _least_squares(segments, offset, weight, normal, right)
        x += np.clip(change, -2, 2)
        if np.abs(change).max() < 0.02:
            break
    return _Outline(shape, x[:4], float(x[4]), strength)


def _hidden_rim(edges: Slopes, outline: _Outline) -> Array:
    """Change (4,) of a box for a rim too narrow to show its own edge: it widens the outer flank of the edge."""
    segments = segments_of(outline.shape, outline.box, outline.turn)
    profile = edge_profiles(*edges, segments, -FLANK, FLANK + 1).mean(axis=0)
    middle = round(FLANK / STEP)
    reach = round(1 / STEP)
    top = middle - reach + int(np.argmax(profile[middle - reach : middle + reach + 1]))
    fallen = np.flatnonzero(profile[top:] < profile[top] / 2)
    flank = (top + fallen[0] - middle) * STEP if len(fallen) else FLANK + 1
    outward = np.clip(FLANK_SHARE * (flank - PLAIN_FLANK), -0.7, 1.4)
    return np.asarray(outward * _growth(segments))


def _growth(segments: Segments) -> Array:
    """Change (4,) of a box that moves all segments one sample outwards."""
    ones = np.ones(len(segments.begin))
    return np.asarray(np.linalg.lstsq(segments.jacobian[:, :4], ones, rcond=1e-6)[0])


def nearest_edges(profiles: Array, reach: float) -> tuple[Array, Array]:
    """Offset (k,) of each segment's edge, to a fraction of a step, and its weight; 0 and 0 where there is none."""
    middle = (profiles.shape[1] - 1) // 2
    inner = profiles[:, 1:-1]
    peak = (inner >= profiles[:, :-2]) & (inner > profiles[:, 2:])
    away = (np.arange(1, profiles.shape[1] - 1) - middle) * STEP
    value = np.where(peak, inner * np.exp(-0.5 * away**2), 0.0)
    at = value.argmax(axis=1) + 1
    row = np.arange(len(profiles))
    before, here, after = profiles[row, at - 1], profiles[row, at], profiles[row, at + 1]
    bend = before - 2 * here + after
    part = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=bend < 0)
    found = value.max(axis=1) > 0.05
    offset = np.where(found, -reach + STEP * (at + part), 0.0)
    return offset, np.where(found, here**2, 0.0)


def _priors(shape: str, x: Array, start: Array, drift: float | None) -> tuple[Array, Array]:
    """Normal matrix (5, 5) and right side (5,) of what holds a box in place, in units of `EDGE_SIGMA`."""
    hold = np.array([1 / (drift or DRIFT) ** 2] * 4 + [1 / TURN_SIGMA**2]) * EDGE_SIGMA**2
    normal = np.diag(hold)
    right = np.zeros(5) if drift is None else -hold * (x - start)
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
    for _ in range(4):
        gap = offset - segments.jacobian @ change
        sure = weight / (1 + (gap / 0.5) ** 2)
        weighted = segments.jacobian * sure[:, None]
        matrix = segments.jacobian.T @ weighted + normal
        change = np.asarray(np.linalg.solve(matrix, weighted.T @ offset + right), np.float64)
    return change


def _size(box: Array) -> Array:
    return np.asarray(np.maximum(box[2:] - box[:2], 1.0))


def _peaks(values: Array) -> list[int]:
    inner = values[1:-1]
    return (np.flatnonzero((inner >= values[:-2]) & (inner > values[2:])) + 1).tolist()


def _shoulders(values: Array) -> list[int]:
    """Where a falling flank is least steep: a faint edge beside a strong one."""
    slope = np.diff(values)
    before, here, after = slope[:-2], slope[1:-1], slope[2:]
    at = np.flatnonzero((here < 0) & (here > before) & (here >= after)) + 2
    return [int(i) for i in at if i * STEP - BACK > 0.5]
