"""The outer outline of a face: chosen among nested candidates by a linear model.

A face has several outlines one within the other: legend, inner field, border line, rim. The strongest of each shape is
found first, and its sides are aligned. The edges parallel to it are the candidates. A conditional logit (McFadden 1974)
over 11 features chooses the outer one. The features are strength of the edge, evenness of the strip inside it (a rim
has one colour all round, the background has not), and difference from the detected box.

Boxes are [left, top, right, bottom] (4,), before the rotation about their centre. Lengths are in samples of the
template.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import LinearModel
from wayside.stages.geometry import cholesky_solve
from wayside.stages.kernels import Array, compiled, compiled_within, require_array, shaped
from wayside.stages.panel.outline_edges import (
    OFFSET_STEP,
    TRIAL_STEP,
    Gradients,
    edge_profiles,
    gradients_of,
    strip_unevenness,
    strongest_outline,
)
from wayside.stages.panel.outline_shapes import (
    ASPECT,
    TEMPLATES,
    growth,
    placed,
    segments_of,
)

COARSE, FINE = (0.12, 0.28, TRIAL_STEP), (0.0, 0.0, OFFSET_STEP)
"""The strongest outline lies within the box or outside it by such fractions of the smaller side at most, and step."""
SIDE_ROUNDS, SIDE_SEARCH = 2, 4.0
"""Rounds of aligning the profiles of the sides, and range of the shift that aligns them."""
SIDE_PENALTY = 0.01
"""Correlation that a shift of a side must gain for each sample."""
FIT_ITERATIONS = 4
"""Weights of a fit of sides and rotation are computed so many times."""
SIDE_SIGMA = 1.0
"""Scatter of a side about its start (prior)."""
ROTATION_SIGMA = float(np.radians(1.5))
"""Scatter of the rotation in the plane, rad (prior)."""
ASPECT_SIGMA = 0.03
"""Relative scatter of the proportion of shapes that have one."""
EDGE_SIGMA, EDGE_CAUCHY = 0.35, 0.5
"""Scatter of the edge of one segment, and scale of the Cauchy weight of its residual."""
FLANK, SHARP_FLANK = 4.0, 1.7
"""Range about a side in which the outer flank of its edge is measured, and which its rivals lie in; width of a plain
edge to half of its height."""
RIM_FRACTION = 0.7
"""Fraction of the remaining width that is rim."""
MOST_RIM_INWARD, MOST_RIM_OUTWARD = 0.7, 1.4
"""The rim moves the outline inwards and outwards by this at most."""
_CENTRE = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5]])
_SIZE = np.array([[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
"""Centre and size by left, top, right, bottom."""
SMALLEST_INWARD = 1.5
"""Candidates lie within the strongest outline by this at most."""
CANDIDATES_OUTWARD = 0.3
"""Candidates lie outside the strongest outline by this fraction of the smaller side at most."""
WEAKER_PART = 0.75
"""Fraction of the segments, the weaker ones, whose mean strength counts: an outline has edges all round."""
SMALLEST_EDGE = 0.15
"""Fraction of the strongest edge below which a candidate is left out."""
STRIP = 1.5
"""Width of the strip inside a candidate whose colour should be even."""
SHARP_VIEWS = 2
"""Nearest views, which show a rim too narrow to have an edge of its own."""
OUTLINE_FEATURES = (
    "edge",
    "log_edge",
    "inner_strength",
    "unevenness",
    "edge_times_unevenness",
    "log_width",
    "log_height",
    "log_width_squared",
    "log_height_squared",
    "log_width_height_difference",
    "rectangle",
)
"""Features of a candidate, in this order: edge strength as a fraction of the strongest; strength of the outline it
surrounds; unevenness of the colour of the strip inside (30 grey levels); width and height relative to the detected box;
whether it is a rectangle."""
_UNEVEN_LEVELS, _MOST_UNEVEN = 30.0, 60.0
"""Scale and limit of the unevenness, grey levels: part of what the feature means."""


class FaceOutline(NamedTuple):
    """The outer outline of a face: shape, box and rotation as in `Outline`; strength (0 to 1) of the one it surrounds.

    covariance (4, 4) of left, top, right, bottom, samples^2.
    """

    shape: str
    box: Array
    rotation: float
    strength: float
    covariance: Array

    @property
    def size_sigma(self) -> Array:
        """Standard deviations (2,) of width and height, samples."""
        return np.asarray(np.sqrt(np.diag(_SIZE @ self.covariance @ _SIZE.T)))

    @property
    def centre_sigma(self) -> Array:
        """Standard deviations (2,) of the centre, right and down, samples."""
        return np.asarray(np.sqrt(np.diag(_CENTRE @ self.covariance @ _CENTRE.T)))


def fit_face_outline(
    views: NDArray[np.float32], box: Array, model: LinearModel
) -> FaceOutline | None:
    """Find the outer outline of the face that registered views show.

    None where no shape has edges all round. `views`: `(n, rows, columns, 3)` float32, the nearest first. `box` (4,):
    where the face was detected, `[left, top, right, bottom]` in samples. `model`: weights of `OUTLINE_FEATURES`.

    Raises ValueError where the model is of other features, or the views are another kind of array.
    """
    if model.features != OUTLINE_FEATURES:
        raise ValueError(f"a model of {model.features} instead of {OUTLINE_FEATURES}")
    gradients = gradients_of(views)
    candidates, features = outline_candidates(views, gradients, box)
    if not candidates:
        return None
    value = features @ model.weights
    best = int(np.argmax(value))
    probability = np.exp(value - value[best])
    probability /= probability.sum()
    chosen = candidates[best]
    rim, variances = settle_sides(gradients[:SHARP_VIEWS], chosen)
    rivals = np.array([candidate.box for candidate in candidates]) - chosen.box
    covariance = (rivals.T * probability) @ rivals + np.diag(variances)
    box = chosen.box + rim
    return FaceOutline(chosen.shape, box, chosen.rotation, chosen.strength, covariance)


def outline_candidates(
    views: NDArray[np.float32], gradients: Gradients, box: Array
) -> tuple[list["Outline"], Array]:
    """Outlines parallel to the strongest of the best shapes, and `OUTLINE_FEATURES` (n, 11) of each.

    Raises ValueError for other arrays than those of `fit_face_outline` and `gradients_of`.
    """
    require_array(gradients, "gradients", np.float32, (None, None, None, 2))
    box = shaped(box, (4,))
    candidates, step = list[Outline](), OFFSET_STEP
    features = [np.empty((0, len(OUTLINE_FEATURES)))]
    for inner in strongest_outlines(gradients, box):
        low = -(SMALLEST_INWARD + STRIP)
        side = float((inner.box[2:] - inner.box[:2]).min())
        high = step * np.ceil((CANDIDATES_OUTWARD * side + 1) / step)
        segments = segments_of(inner.shape, inner.box, inner.rotation)
        profiles = edge_profiles(gradients, segments, low, high, step)
        kept = math.ceil(WEAKER_PART * len(profiles))
        strength = np.sort(profiles, axis=0)[:kept].mean(axis=0)
        left, here, right = strength[:-2], strength[1:-1], strength[2:]
        peaks = np.flatnonzero((here >= left) & (here > right)) + 1
        offset, edge = peaks * step + low, strength[peaks] / strength[peaks].max(initial=1e-9)
        outer = inner.box + offset[:, None] * growth(segments)
        likely = (edge >= SMALLEST_EDGE) & (offset > -SMALLEST_INWARD)
        likely &= (outer[:, 2:] - outer[:, :2]).min(axis=1) >= 1.0
        peaks, edge, outer = peaks[likely], edge[likely], outer[likely]
        farthest, wide = low + step * peaks.max(initial=0), round(STRIP / step) - 1
        uneven = strip_unevenness(views, segments, low, farthest)
        strip = [float(uneven[max(0, (i - wide) // 2) : i // 2 + 1].min()) for i in peaks.tolist()]
        features.append(_features(inner, outer, box, edge, np.array(strip)))
        candidates += [inner._replace(box=own) for own in outer]
    return candidates, np.concatenate(features)


def _features(inner: "Outline", outer: Array, detected: Array, edge: Array, strip: Array) -> Array:
    """`OUTLINE_FEATURES` (n, 11) of boxes (n, 4), by their strength and the unevenness inside, (n,)."""
    wide, tall = np.log((outer[:, 2:] - outer[:, :2]) / (detected[2:] - detected[:2])).T
    uneven, one = np.minimum(strip, _MOST_UNEVEN) / _UNEVEN_LEVELS, np.ones(len(outer))
    of_edge = [edge, np.log(edge), inner.strength * one, uneven, edge * uneven]
    of_size = [wide, tall, wide**2, tall**2, np.abs(wide - tall)]
    return np.column_stack([*of_edge, *of_size, (inner.shape == "rectangle") * one])


class Outline(NamedTuple):
    """A fitted outline: shape, box, mean edge strength 0 to 1 and its standard error, rotation (rad, clockwise)."""

    shape: str
    box: Array
    strength: float
    error: float = 0.0
    rotation: float = 0.0


def strongest_outlines(gradients: Gradients, box: Array) -> list[Outline]:
    """Outlines of the best shapes near a box, the strongest one of each."""
    found = [
        Outline(shape, *strongest_outline(gradients, template, box, *COARSE))
        for shape, template in TEMPLATES.items()
    ]
    # segments rotate as the proportions change: once more, near by
    near = [
        Outline(one.shape, *strongest_outline(gradients, TEMPLATES[one.shape], one.box, *FINE))
        for one in _best(found)
    ]
    return [align_sides(gradients, one) for one in _best(near)]


def _best(found: list[Outline]) -> list[Outline]:
    """The strongest, and those that its standard error does not tell from it (Breiman et al., 1984).

    Narrower ones than a sample have no outline.
    """
    wide = [one for one in found if (one.box[2:] - one.box[:2]).min() >= 1.0]
    wide.sort(key=lambda one: -one.strength)
    return [one for one in wide if one.strength >= wide[0].strength - wide[0].error]


def align_sides(gradients: Gradients, outline: Outline) -> Outline:
    """The outline with all sides on the same one of several parallel lines (rim, border line).

    The profiles of all sides are alike: each side is shifted to where its profile correlates best with their mean.
    Where two sides would meet, it is the given one.
    """
    x = np.array([*outline.box, outline.rotation])
    aspect = ASPECT.get(outline.shape, 0.0)
    if not _align_sides(gradients, TEMPLATES[outline.shape], aspect, x):
        return outline
    return outline._replace(box=x[:4], rotation=float(x[4]))


@compiled
def _align_sides(gradients: Gradients, template: Array, aspect: float, x: Array) -> bool:
    # Moves box and rotation x (5,); False where two sides meet.
    count, half, reach = len(template), round(SIDE_SEARCH / OFFSET_STEP), 2 * SIDE_SEARCH
    width, offset, weight = 2 * half + 1, np.empty(count), np.empty(count)
    for _ in range(SIDE_ROUNDS):
        segments, mean, power = placed(template, x[:4], x[4]), np.zeros(width), 0.0
        profiles = edge_profiles(gradients, segments, -reach, reach, OFFSET_STEP)
        for n in range(width):
            for k in range(count):
                mean[n] += profiles[k, half + n] / count
            power += mean[n] * mean[n]
        for k in range(count):
            alike, square, best = np.zeros(width), np.zeros(width), -np.inf
            for i in range(width):
                for n in range(width):
                    alike[n] += profiles[k, n + i] * mean[i]
                    square[n] += profiles[k, n + i] * profiles[k, n + i]
            for n in range(width):
                shift = (n - half) * OFFSET_STEP
                value = alike[n] / (np.sqrt(square[n] * power) + 1e-9) - SIDE_PENALTY * abs(shift)
                if value > best:
                    best, offset[k] = value, shift
            weight[k] = max(best, 0.0) ** 2
        _fit_sides(x, aspect, segments.jacobian, offset, weight)
        if min(x[2] - x[0], x[3] - x[1]) < 1.0:
            return False
    return True


@compiled_within
def _fit_sides(x: Array, aspect: float, jacobian: Array, offset: Array, weight: Array) -> None:
    """Move a box and its rotation x so that segments lie at an offset (k,), with Cauchy weights and priors.

    Sides and rotation scatter about where they are, and a shape of one proportion about that; in units of the scatter
    of an edge.
    """
    change, normal, hold = np.zeros(5), np.empty((5, 5)), 0.0
    by = (-1.0, aspect, 1.0, -aspect, 0.0)
    off = by[0] * x[0] + by[1] * x[1] + by[2] * x[2] + by[3] * x[3]
    if aspect > 0:
        hold = (EDGE_SIGMA / (ASPECT_SIGMA * (x[2] - x[0]))) ** 2
    for _ in range(FIT_ITERATIONS):
        right = np.empty(5)
        for c in range(5):
            right[c] = -hold * by[c] * off
            for d in range(5):
                normal[c, d] = hold * by[c] * by[d]
            normal[c, c] += (EDGE_SIGMA / (SIDE_SIGMA if c < 4 else ROTATION_SIGMA)) ** 2
        for k in range(len(offset)):
            residual = offset[k]
            for c in range(5):
                residual -= jacobian[k, c] * change[c]
            pull = weight[k] / (1 + (residual / EDGE_CAUCHY) ** 2)
            for c in range(5):
                right[c] += pull * jacobian[k, c] * offset[k]
                for d in range(5):
                    normal[c, d] += pull * jacobian[k, c] * jacobian[k, d]
        cholesky_solve(normal, right)
        change = right
    for c in range(5):
        x[c] += change[c]


def settle_sides(gradients: Gradients, outline: Outline) -> tuple[Array, Array]:
    """Change (4,) of a box for a rim too narrow to have an edge of its own, and variance (4,) of each side, samples^2.

    Such a rim widens the outer flank of the edge. The variance is of the posterior of the offset of a side, over all
    edges that it could lie on. Prior of a side and information of an edge are as in `align_sides`, and edges count by
    how far the side moves their segments. One clear edge leaves little; two of like strength, their distance. Raises
    ValueError for other arrays than `gradients_of` returns.
    """
    require_array(gradients, "gradients", np.float32, (None, None, None, 2))
    segments = segments_of(outline.shape, outline.box, outline.rotation)
    step, near = OFFSET_STEP, round(1 / OFFSET_STEP)
    profiles = edge_profiles(gradients, segments, -FLANK, FLANK + 1, step)
    offset = np.linspace(-FLANK, FLANK + 1, profiles.shape[1])
    profile, centre = profiles.mean(axis=0), round(FLANK / step)
    top = centre - near + int(np.argmax(profile[centre - near : centre + near + 1]))
    fallen = np.flatnonzero(profile[top:] < profile[top] / 2)
    flank = offset[top + fallen[0]] if len(fallen) else FLANK + 1
    outward = RIM_FRACTION * (flank - SHARP_FLANK)
    change = min(max(outward, -MOST_RIM_INWARD), MOST_RIM_OUTWARD) * growth(segments)
    moves = segments.jacobian[:, :4, None]
    at = np.rint((moves * offset + FLANK) / step).astype(np.int64).clip(0, len(offset) - 1)
    edges = np.take_along_axis(profiles[:, None], at, axis=2)
    strength = (np.abs(moves) * edges).sum(axis=0) / np.abs(moves).sum(axis=0)
    away = (offset - change[:, None]) ** 2
    likelihood = strength / EDGE_SIGMA**2 - away / SIDE_SIGMA**2 / 2
    probability = np.exp(likelihood - likelihood.max(axis=1, keepdims=True))
    return change, (probability * away).sum(axis=1) / probability.sum(axis=1)
