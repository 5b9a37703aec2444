"""What a panel stands on: the strip below it, rectified on its plane, in its nearest views.

Both edges of a post run down the whole strip, under the middle of the panel or at equal distances to both sides of it.
Edges of the background end sooner or move from view to view, so that the geometric mean of an edge's strength over
pieces of the strip, in the view that shows it least, tells them apart.
"""

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
GAP_M, LENGTH_M, SHORTEST_M = 0.06, 0.9, 0.25
"""Where the strip begins below the panel, and its greatest and least length."""
CLEAR_M = 0.3
"""The strip ends so far above the road: grass and the fall of the verge lie below."""
BESIDE_M = 0.3
"""The strip reaches so far beyond the panel on both sides."""
COLUMN_M, ROW_M, PIECE = 0.005, 0.025, 4
"""Distance of the samples of a strip, and rows of a piece of it, whose edges are averaged."""
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
FEWEST_PX = 3.5
"""A post that is narrower in the image, in pixels, shows its width but not its kind."""
LEAST_PROBABILITY, FARTHEST = 0.7, 6.0
"""A less probable kind, or one farther off (Mahalanobis distance), is unknown."""
POST_SPACE, FEATURES = "post", 6
"""Name of the space of `post_features`, and its dimensions."""


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


def measure_posts(
    registered: RegisteredViews, box: Array, above_m: float, model: GaussianModel
) -> Posts:
    """What a panel stands on; box, above_m: as for `post_below`. model: the kinds, in `POST_SPACE`.

    A camera without colours does not show the kind.
    """
    if above_m > OVERHEAD_M:
        return Posts("gantry")
    strips, edges = post_below(registered, box, above_m)
    if edges is None:
        return Posts()
    number, nearest = len(edges.sides_m), strips[0]
    kind, probability = "unknown", np.nan
    if edges.width_m > FEWEST_PX * nearest.pixel_m and np.ptp(nearest.rgb, axis=2).any():
        kind, probability = kind_of(post_features(nearest, edges), model)
    scatter = EDGE_SIGMA_PX * nearest.pixel_m / np.sqrt(number)
    sigma = float(np.hypot(scatter, WIDTH_SIGMA * edges.width_m))
    return Posts(kind, probability, number, edges.width_m, sigma, len(strips))


def post_below(
    registered: RegisteredViews, box: Array, above_m: float
) -> tuple[list[Strip], PostEdges | None]:
    """The strips below a panel in its nearest views that show all of them, the nearest first, and the posts there.

    box (4,): left, top, right, bottom of the panel in samples of the template. above_m: height of its lower edge above
    the road. None: no edges there are strong enough.
    """
    step, plane, found = registered.step, registered.plane, list[Strip]()
    middle = (np.array(registered.views[0][0].grey.shape[::-1]) - 1) / 2
    centre, half = ((box[:2] + box[2:]) / 2 - middle) * step, (box[2:] - box[:2]) / 2 * step
    count, length = int((half[0] + BESIDE_M) / COLUMN_M), min(LENGTH_M, above_m - CLEAR_M)
    across = COLUMN_M * np.arange(-count, count + 1, dtype=np.float64)
    for view, alignment in registered.views if length > SHORTEST_M else ():
        (x, y), (wide, tall), image = alignment.shift * step, alignment.stretch, view.image
        columns = x + wide * (centre[0] + across)
        rows = y + tall * (centre[1] + half[1] + np.arange(GAP_M, length, ROW_M))
        ends = np.array([[right, down] for right in columns[[0, -1]] for down in rows[[0, -1]]])
        pixels = image.pixels(plane.points(ends))
        if (pixels >= 0).all() and (pixels < image.rgb.shape[1::-1]).all():
            (seen,) = rectify(plane, columns, rows, [(view.depth, image)])
            sight = plane.point - image.pose.centre
            slant = float(sight @ plane.ahead / np.hypot(sight @ plane.ahead, sight @ plane.right))
            found.append(Strip(seen.rgb, across, view.depth / image.focal, slant))
    edges = find_posts(found[:VIEWS], 2 * float(half[0])) if found else None
    return found[:VIEWS], edges if edges is not None and edges.strength > LEAST_STRENGTH else None


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
        pairs = at[np.column_stack(np.triu_indices(len(at), 1))]
        wide = np.diff(offset[pairs], axis=1)[:, 0]
        pairs = pairs[(wide > NARROWEST_M) & (wide < WIDEST_M)]
        if not len(pairs):
            continue
        score, chosen = _best(offset[pairs], np.sqrt(strength[pairs].prod(axis=1)), width_m)
        if len(chosen) and (best is None or score > best[0]):
            best = score, pairs[chosen], float(lean), mean, NOISE + float(np.median(strength))
    if best is None:
        return None
    score, pairs, lean, mean, usual = best
    before, middle, after = mean[pairs - 1], mean[pairs], mean[pairs + 1]
    shift = (before - after) / 2 / np.minimum(before - 2 * middle + after, -1e-9)
    sides = offset[pairs] + COLUMN_M * np.clip(shift, -0.5, 0.5)
    width = strips[0].slant * float(np.diff(sides, axis=1).mean())
    return PostEdges(sides, width, lean, score / usual)


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
    """What tells the kinds of posts apart, (6,): logarithm of the width, colour, light across, and change along.

    Colour: red less blue, as part of all light. The light across is that of the cosine series of 2nd and 4th order, and
    the median step: a tube is darker to both sides, a channel in the middle, a plate is even. The change is that of the
    colour: grain and rust.
    """
    down = np.arange(len(strip.rgb), dtype=np.float32)[:, None]
    sides = edges.sides_m.tolist()
    across = np.concatenate([np.linspace(left, right, 18)[1:-1] for left, right in sides])
    columns = (across - strip.offset_m[0] + edges.lean * ROW_M * down) / COLUMN_M
    rows = np.broadcast_to(down, columns.shape).copy()
    seen = cv2.remap(strip.rgb, columns.astype(np.float32), rows, cv2.INTER_LINEAR)
    rgb = seen.reshape(len(down), -1, 16, 3).mean(axis=1) + 1.0
    warm, light = (rgb[..., 0] - rgb[..., 2]) / rgb.sum(axis=2), rgb.mean(axis=(0, 2))
    light /= light.mean()
    series, step = dct(light, norm="ortho") / 4, np.median(np.abs(np.diff(light)))
    change = np.log(0.01 + np.std(warm.mean(axis=1)))
    found = np.log(edges.width_m), warm.mean(), series[2], series[4], step, change
    return np.array(found, np.float64)


def kind_of(features: Array, model: GaussianModel) -> tuple[str, float]:
    """The most probable kind and its probability, each kind as likely before; nan: like none of them, or like two."""
    density = log_normals(features[None], model.classes)[0]
    probability = np.exp(density - np.logaddexp.reduce(density))
    best, distance = int(probability.argmax()), class_distances(features[None], model.classes).min()
    if probability[best] < LEAST_PROBABILITY or distance > FARTHEST:
        return "unknown", np.nan
    return model.classes[best].name, float(probability[best])
