"""What a panel stands on: the strip below it, rectified on its plane, in its nearest views.

Both edges of a post run down the whole strip, under the middle of the panel or at equal distances to both sides of it.
Edges of the background end sooner or move from view to view, so that the geometric mean of an edge's strength over
pieces of the strip, in all views, tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import maximum_filter1d

from wayside.schemas.models import GaussianModel
from wayside.schemas.roadside import Posts
from wayside.stages.classifiers import class_distances, log_normals
from wayside.stages.kernels import Array
from wayside.stages.panel.rectification import rectify
from wayside.stages.panel.registration import RegisteredViews

VIEWS = 2
"""Nearest views of which the strip is looked at."""
GAP_M, LENGTH_M = 0.06, 0.9
"""The strip begins below the edge of the panel, and is so long at most."""
CLEAR_M = 0.3
"""The strip ends so far above the road: grass and the fall of the verge lie below."""
SHORTEST_M = 0.25
"""A shorter strip says nothing."""
BESIDE_M = 0.3
"""The strip reaches so far beyond the panel on both sides."""
COLUMN_M, ROW_M = 0.005, 0.025
"""Distance of the samples of a strip."""
PIECE = 4
"""Rows of a piece of the strip, whose edges are averaged."""
BLUR_PX = 0.6
"""Blur (sigma) of an image along its rows before its edges are measured."""
NOISE = 1.0
"""Grey levels a pixel that are added to the strength of an edge: fainter ones are noise."""
OFF_PX, FAINTER = 0.7, 0.4
"""In a farther view, an edge is this far from its place at most, and its strength less by this factor (logarithm)."""
LEANS = np.arange(-4, 5) * 0.03
"""How far a post may lean: to the right, a metre downwards."""
NARROWEST_M, WIDEST_M = 0.035, 0.45
"""Width of a post."""
OFF_MIDDLE, OFF_MIDDLE_M = 0.1, 0.05
"""A single post stands this near to the middle of the panel: part of its width, and metres."""
TWO_FROM_M = 0.7
"""Width of a panel that may stand on two posts."""
ALIKE, THIRD = 0.2, 0.6
"""Posts of a panel differ so little in width (logarithm), and a third one is so strong next to the others."""
LEAST_STRENGTH = 3.0
"""Least strength of the edges of posts over that of half of all edges in the strip (set on rendered drives)."""
OVERHEAD_M = 4.2
"""A panel whose lower edge is higher hangs from a gantry: no vehicle passes below another."""
EDGE_SIGMA_PX, WIDTH_SIGMA = 0.35, 0.06
"""Scatter of the width of a post: by the pixels of an image, and as part of it (measured on rendered drives)."""
FEWEST_PX = 2.5
"""A post that is narrower in the image, in pixels, shows its width but not its kind."""
LEAST_PROBABILITY = 0.7
"""A less probable kind is unknown."""
FARTHEST = 6.0
"""A post farther from every kind, as Mahalanobis distance, is of none that was learned."""
POST_SPACE = "post"
"""Name of the space of `post_features`."""
FEATURES = 11
"""Numbers of `post_features`."""


class Strip(NamedTuple):
    """The strip below a panel in one view."""

    rgb: NDArray[np.float32]
    """(rows, columns, 3)."""
    offset_m: Array
    """Of the columns from the middle of the panel, to the right, (columns,)."""
    pixel_m: float
    """What a pixel of the image covers."""
    slant: float
    """Cosine of the line of sight to the normal of the plane, seen from above."""


def strips_below(registered: RegisteredViews, box: Array, above_m: float) -> list[Strip]:
    """The strips below a panel in its nearest views that show all of it, the nearest first.

    box (4,): left, top, right, bottom of the panel in samples of the template. above_m: height of its lower edge above
    the road.
    """
    step, (template, _) = registered.step, registered.views[0]
    length = min(LENGTH_M, above_m - CLEAR_M)
    if length < SHORTEST_M:
        return []
    middle = (np.array(template.grey.shape[::-1]) - 1) / 2
    centre = ((box[:2] + box[2:]) / 2 - middle) * step
    half = (box[2:] - box[:2]) / 2 * step
    count = int((half[0] + BESIDE_M) / COLUMN_M)
    across = COLUMN_M * np.arange(-count, count + 1, dtype=np.float64)
    down = half[1] + np.arange(GAP_M, length, ROW_M)
    found = []
    for view, alignment in registered.views:
        shift, image = alignment.shift * step, view.image
        columns = shift[0] + alignment.stretch[0] * (centre[0] + across)
        rows = shift[1] + alignment.stretch[1] * (centre[1] + down)
        ends = np.array([[x, y] for x in columns[[0, -1]] for y in rows[[0, -1]]])
        pixels, size = image.pixels(registered.plane.points(ends)), image.rgb.shape[1::-1]
        if (pixels >= 0).all() and (pixels < size).all():
            (seen,) = rectify(registered.plane, columns, rows, [(view.depth, image)])
            sight = registered.plane.point - image.pose.centre
            ahead, right = sight @ registered.plane.ahead, sight @ registered.plane.right
            slant = float(ahead / np.hypot(ahead, right))
            found.append(Strip(seen.rgb, across, view.depth / image.focal, slant))
    return found[:VIEWS]


class PostEdges(NamedTuple):
    """The edges of the posts of a strip."""

    sides_m: Array
    """Left and right edge of each post at the top of the strip, from the middle of the panel, (posts, 2)."""
    width_m: float
    """Of a post, the mean, across the line of sight."""
    lean: float
    """To the right, a metre downwards."""
    strength: float
    """Of the edges over that of half of all edges in the strip."""


def find_posts(strips: Sequence[Strip], width_m: float) -> PostEdges | None:
    """The posts of a panel of this width by the strips below it; None where no two edges could be of a post."""
    pieces = [_edge_strength(strip) for strip in strips]
    offset, best = strips[0].offset_m, None
    for lean in LEANS:
        mean, *others = (_along(own, lean) for own in pieces)
        seen = [mean]
        for strip, other in zip(strips[1:], others, strict=True):
            reach = 2 * round(OFF_PX * strip.pixel_m / COLUMN_M) + 1
            seen.append(maximum_filter1d(other, reach) + FAINTER)
        strength = np.exp(np.min(seen, axis=0)) - NOISE
        at = np.flatnonzero((mean[1:-1] >= mean[:-2]) & (mean[1:-1] > mean[2:])) + 1
        left, right = np.triu_indices(len(at), 1)
        left, right = at[left], at[right]
        wide = offset[right] - offset[left]
        kept = (wide > NARROWEST_M) & (wide < WIDEST_M)
        pairs = np.column_stack([left, right])[kept]
        if not len(pairs):
            continue
        score, chosen = _best(offset[pairs], np.sqrt(strength[pairs].prod(axis=1)), width_m)
        if len(chosen) and (best is None or score > best[0]):
            best = score, pairs[chosen], lean, mean, float(np.median(strength))
    if best is None:
        return None
    score, pairs, lean, mean, usual = best
    before, middle, after = mean[pairs - 1], mean[pairs], mean[pairs + 1]
    shift = (before - after) / 2 / np.minimum(before - 2 * middle + after, -1e-9)
    sides = offset[pairs] + COLUMN_M * np.clip(shift, -0.5, 0.5)
    width = strips[0].slant * float(np.diff(sides, axis=1).mean())
    return PostEdges(sides, width, float(lean), score / (NOISE + usual))


def _edge_strength(strip: Strip) -> Array:
    """Logarithm of the strength of edges in pieces of a strip, (pieces, columns)."""
    width = strip.pixel_m / COLUMN_M
    soft = cv2.GaussianBlur(strip.rgb, (0, 0), sigmaX=BLUR_PX * width, sigmaY=1e-3)
    slope = np.gradient(soft, axis=1) * width
    rows = len(slope) // PIECE * PIECE
    pieces = slope[:rows].reshape(-1, PIECE, *slope.shape[1:]).mean(axis=1)
    return np.asarray(np.log(np.sqrt((pieces**2).mean(axis=2)) + NOISE))


def _along(pieces: Array, lean: float) -> Array:
    """Mean (columns,) of pieces of a strip along lines that lean."""
    down = (np.arange(len(pieces)) + 0.5) * PIECE * ROW_M
    columns = np.arange(pieces.shape[1]) + np.round(lean * down / COLUMN_M).astype(int)[:, None]
    columns = np.clip(columns, 0, pieces.shape[1] - 1)
    return np.asarray(np.take_along_axis(pieces, columns, axis=1).mean(axis=0))


def _best(sides: Array, strength: Array, width_m: float) -> tuple[float, list[int]]:
    """Strength and numbers of the pairs of edges (n, 2), metres, that are most likely the posts of a panel."""
    middle, wide = sides.mean(axis=1), np.diff(sides, axis=1)[:, 0]
    alone = np.where(np.abs(middle) < OFF_MIDDLE * width_m + OFF_MIDDLE_M, strength, 0.0)
    central = int(alone.argmax())
    score, chosen = float(alone[central]), [central] if alone[central] > 0 else []
    beside = (np.abs(middle) > 0.15 * width_m) & (np.abs(middle) < 0.5 * width_m + OFF_MIDDLE_M)
    left, right = (np.flatnonzero(beside & (middle * side > 0)) for side in (-1, 1))
    if width_m < TWO_FROM_M or not len(left) or not len(right):
        return score, chosen
    uneven = (middle[left, None] + middle[right]) / (OFF_MIDDLE_M * (1 + width_m))
    unlike = np.log(wide[left, None] / wide[right]) / ALIKE
    both = np.minimum(strength[left, None], strength[right]) * np.exp(-(uneven**2 + unlike**2) / 2)
    first, second = np.unravel_index(int(both.argmax()), both.shape)
    pair, most = [int(left[first]), int(right[second])], max(float(both.max()), score)
    alike = bool(chosen) and abs(np.log(wide[central] / wide[pair[0]])) < ALIKE
    if alike and min(float(both.max()), score) > THIRD * most:
        return most, pair + chosen
    return (score, chosen) if most == score else (most, pair)


def post_features(strip: Strip, edges: PostEdges) -> Array:
    """What tells the kinds of posts apart, (11,): width, colour, light across, and how both vary along.

    The light across is a cosine series of 1st to 4th order, those that depend on the side the light is on without sign.
    """
    down = (np.arange(len(strip.rgb)) * ROW_M).astype(np.float32)
    rows = np.broadcast_to(down / ROW_M, (16, len(down))).T.astype(np.float32)
    seen = []
    for left, right in edges.sides_m:
        across = np.linspace(left, right, 18)[1:-1] - strip.offset_m[0]
        columns = ((across + edges.lean * down[:, None]) / COLUMN_M).astype(np.float32)
        seen.append(
            cv2.remap(strip.rgb, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        )
    rgb = np.mean(seen, axis=0) + 1.0
    grey, total = rgb.mean(axis=2), rgb.sum(axis=2)
    warm, green = (rgb[..., 0] - rgb[..., 2]) / total, rgb[..., 1] / total
    series = dct(grey.mean(axis=0) / grey.mean(), norm="ortho")[1:5] / 4
    along = grey.mean(axis=1)
    return np.array(
        [
            np.log(edges.width_m),
            warm.mean(),
            green.mean(),
            np.log(grey.mean() / 100),
            *np.where([True, False, True, False], np.abs(series), series),
            np.log(0.01 + np.std(along) / along.mean()),
            np.log(0.01 + np.std(warm.mean(axis=1))),
            np.log(0.01 + np.abs(np.diff(grey, axis=0)).mean() / grey.mean()),
        ]
    )


def measure_posts(
    registered: RegisteredViews, box: Array, above_m: float, model: GaussianModel
) -> Posts:
    """What a panel stands on; box, above_m: as for `strips_below`. model: the kinds, in `POST_SPACE`.

    A camera without colours does not show the kind.
    """
    if above_m > OVERHEAD_M:
        return Posts("gantry")
    strips = strips_below(registered, box, above_m)
    edges = find_posts(strips, float(box[2] - box[0]) * registered.step) if strips else None
    if edges is None or edges.strength < LEAST_STRENGTH:
        return Posts()
    number, nearest = len(edges.sides_m), strips[0]
    kind, probability = "unknown", np.nan
    if edges.width_m > FEWEST_PX * nearest.pixel_m and np.ptp(nearest.rgb, axis=2).any():
        kind, probability = kind_of(post_features(nearest, edges), model)
    scatter = EDGE_SIGMA_PX * nearest.pixel_m / np.sqrt(number)
    sigma = float(np.hypot(scatter, WIDTH_SIGMA * edges.width_m))
    return Posts(kind, probability, number, edges.width_m, sigma, len(strips))


def kind_of(features: Array, model: GaussianModel) -> tuple[str, float]:
    """The most probable kind and its probability, each kind as likely before; nan: like none of them, or like two."""
    values = features[None]
    density = log_normals(values, model.classes)[0]
    probability = np.exp(density - np.logaddexp.reduce(density))
    best = int(probability.argmax())
    alien = class_distances(values, model.classes).min() > FARTHEST
    if probability[best] < LEAST_PROBABILITY or alien:
        return "unknown", np.nan
    return model.classes[best].name, float(probability[best])
