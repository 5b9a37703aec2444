"""What a panel stands on: the strip below it, rectified on its plane, in its nearest views.

Both edges of a post run down the whole strip, under the middle of the panel or at equal distances to both sides of it.
Edges of the background end sooner or move from view to view. So the strength of an edge is its geometric mean over
pieces of the strip, in the view that shows it least. Rust and grooves have edges as well: a conditional logit
(McFadden 1974) weighs all likely edges with all kinds.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import maximum_filter1d
from scipy.special import softmax

from wayside.schemas.models import LinearModel
from wayside.schemas.roadside import Posts
from wayside.stages.kernels import Array
from wayside.stages.panel.rectification import pixels_of, rectify
from wayside.stages.panel.registration import RegisteredViews

VIEWS, TRIALS, STRONG = 2, 3, 3.0
"""Views of which the strip is looked at: the nearest ones, or the next where no edges are so strong there (a tree)."""
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
ALIKE, SINGLE, DOUBLE = 0.2, 6, 8
"""Posts of a panel differ so little in width (logarithm); so many single ones are weighed, and so many twos."""
OVERHEAD_M = 4.2
"""A panel whose lower edge is higher hangs from a gantry: no vehicle passes below another."""
EDGE_SIGMA_PX, WIDTH_SIGMA = 0.3, 0.05
"""Scatter of the width of a post: by the pixels of an image, and as part of it (measured on rendered drives)."""
BAND_PX, RESOLVED_PX, USUAL_M = (0.5, 3.0), 8.0, (0.12, 1.3)
"""A band so far beside a post is compared with it; width that shows a profile; of a usual post, and panel."""
HALF, LEAST_PROBABILITY = 0.5, 0.6
"""Probability below which posts count as hidden, and a kind as unknown (of those stated, 90 % are right by folds)."""
KINDS = ("pole", "round_metal", "steel_beam", "u_channel", "wood")
"""What posts can be by their look, as in `POST_KINDS`."""
_SHARED = ("strength", "strength among others", "evenness", "several by width", "three")
_FORM = ("constant", "width", "width squared", "several")
_LOOK = ("1st", "2nd", "4th", "red", "red squared", "light")
POST_FEATURES = (*_SHARED, *(f"{kind}: {name}" for kind in KINDS for name in _FORM + _LOOK))
"""Names of the numbers of `post_features`."""


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
    registered: RegisteredViews, box: Array, above_m: float, model: LinearModel
) -> Posts:
    """What a panel stands on; box, above_m: as for `posts_below`. model: weights of `post_features`.

    A camera without colours does not show the kind.
    """
    if above_m > OVERHEAD_M:
        return Posts("gantry")
    strips, likely = posts_below(registered, box, above_m)
    if not likely:
        return Posts()
    value = post_features(strips[0], likely) @ model.weights
    share = softmax(np.append(value, 0.0))[:-1].reshape(value.shape)  # the rest: they are hidden
    of_post, of_kind = share.sum(axis=1), share.sum(axis=0)
    if of_post.sum() < HALF:
        return Posts()
    widths, numbers = np.array([(one.width_m, len(one.sides_m)) for one in likely]).T
    number = int(np.bincount(numbers.astype(int), of_post).argmax())
    of_post = of_post * (numbers == number)
    width = float(widths[of_post.argmax()])
    scatter = np.hypot(EDGE_SIGMA_PX * strips[0].pixel_m / np.sqrt(number), WIDTH_SIGMA * width)
    gaps = np.abs(widths - width)
    held = of_post[gaps.argsort()].cumsum() / of_post.sum()
    # the square sum of the gaps would count rare edges most
    most, nearly_all = np.sort(gaps)[held.searchsorted((0.683, 0.954))]
    sigma = np.hypot(scatter, max(most, nearly_all / 2))
    kind, probability = KINDS[of_kind.argmax()], float(of_kind.max())
    if probability < LEAST_PROBABILITY or not np.ptp(strips[0].rgb, axis=2).any():
        kind, probability = "unknown", np.nan
    return Posts(kind, probability, number, width, float(sigma), len(strips))


def posts_below(
    registered: RegisteredViews, box: Array, above_m: float
) -> tuple[list[Strip], list[PostEdges]]:
    """The strips below a panel in two of its nearest views that show all of them, and the likely posts there.

    `box` (4,): left, top, right, bottom of the panel in samples of the template. `above_m`: height of its lower edge
    above the road.
    """
    step, plane, found = registered.step, registered.plane, list[Strip]()
    middle = (np.array(registered.views[0][0].rgb.shape[1::-1]) - 1) / 2
    centre, half = ((box[:2] + box[2:]) / 2 - middle) * step, (box[2:] - box[:2]) / 2 * step
    count, length = int((half[0] + BESIDE_M) / COLUMN_M), min(LENGTH_M, above_m - CLEAR_M)
    across = COLUMN_M * np.arange(-count, count + 1, dtype=np.float64)
    for view, alignment in registered.views if length > SHORTEST_M else ():
        (x, y), (wide, tall), image = alignment.shift * step, alignment.stretch, view.image
        columns = x + wide * (centre[0] + across)
        rows = y + tall * (centre[1] + half[1] + np.arange(GAP_M, length, ROW_M))
        ends = np.array([[right, down] for right in columns[[0, -1]] for down in rows[[0, -1]]])
        (pixels,) = pixels_of([image], plane.points(ends))
        if (pixels >= 0).all() and (pixels < image.rgb.shape[1::-1]).all():
            (seen,) = rectify(plane, columns, rows, [(view.depth, image)])
            sight = plane.point - image.pose.centre
            slant = float(sight @ plane.ahead / np.hypot(sight @ plane.ahead, sight @ plane.right))
            found.append(
                Strip(seen.rgb.astype(np.float32), across, view.depth / image.focal, slant)
            )
    best: tuple[list[Strip], list[PostEdges]] = [], []
    for first in range(min(len(found), TRIALS)):
        likely = find_posts(found[first : first + VIEWS], 2 * float(half[0]))
        if likely and (not best[1] or likely[0].strength > best[1][0].strength):
            best = found[first : first + VIEWS], likely
        if best[1] and best[1][0].strength > STRONG:
            break
    return best


def find_posts(strips: Sequence[Strip], width_m: float) -> list[PostEdges]:
    """The likely posts of a panel of this width by the strips below it, the strongest first; they lean alike."""
    pieces = [_edge_strength(strip) for strip in strips]
    offset, best, found = strips[0].offset_m, 0.0, list[PostEdges]()
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
        geometric = np.sqrt(strength[pairs].prod(axis=1))
        likely = sorted(_likely(offset[pairs], geometric, width_m), key=lambda one: -one[0])
        if not likely or likely[0][0] <= best:
            continue
        best, found, usual = likely[0][0], [], NOISE + float(np.median(strength))
        for score, chosen in likely:
            edges = pairs[chosen]
            before, middle, after = mean[edges - 1], mean[edges], mean[edges + 1]
            shift = (before - after) / 2 / np.minimum(before - 2 * middle + after, -1e-9)
            sides = offset[edges] + COLUMN_M * np.clip(shift, -0.5, 0.5)
            width = strips[0].slant * float(np.diff(sides, axis=1).mean())
            found.append(PostEdges(sides, width, float(lean), score / usual))
    return found


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


def _likely(sides: Array, strength: Array, width_m: float) -> Iterator[tuple[float, list[int]]]:
    """Strength and numbers of the pairs of edges (n, 2), metres, that are likely the posts of a panel."""
    middle, wide = sides.mean(axis=1), np.diff(sides, axis=1)[:, 0]
    alone = np.where(np.abs(middle) < OFF_MIDDLE * width_m + OFF_MIDDLE_M, strength, 0.0)
    central = [one for one in np.argsort(-alone)[:SINGLE].tolist() if alone[one] > 0]
    yield from ((alone[one], [one]) for one in central)
    beside = (np.abs(middle) > 0.15 * width_m) & (np.abs(middle) < 0.5 * width_m + OFF_MIDDLE_M)
    left, right = (np.flatnonzero(beside & (middle * side > 0)) for side in (-1, 1))
    if width_m < TWO_FROM_M or not len(left) or not len(right):
        return
    uneven = (middle[left, None] + middle[right]) / (OFF_MIDDLE_M * (1 + width_m))
    unlike = np.log(wide[left, None] / wide[right]) / ALIKE
    both = np.minimum(strength[left, None], strength[right]) * np.exp(-(uneven**2 + unlike**2) / 2)
    for one in np.argsort(-both, axis=None)[:DOUBLE].tolist():
        score, pair = both.flat[one], [left[one // len(right)], right[one % len(right)]]
        third = [k for k in central if abs(np.log(wide[k] / wide[pair[0]])) < ALIKE][:1]
        yield score, pair
        yield from ((min(score, alone[k]), [*pair, k]) for k in third)


def post_features(strip: Strip, likely: Sequence[PostEdges]) -> Array:
    """What tells the edges and the kinds of posts, `POST_FEATURES`: (likely, kinds, 55), those of other kinds 0.

    Of edges: strength, strength over that of the strongest, how much less a post changes downwards than its sides do,
    several by the width of the panel, and three. Of kinds: width, several, colour, and light across by its cosine
    series of 1st, 2nd and 4th order. A tube is darker at both sides, a channel in the middle, and a plate is even.
    """
    found, best = [], max(one.strength for one in likely)
    beyond = strip.pixel_m * np.array(BAND_PX)[:, None]
    panel = np.log(2 * (strip.offset_m[-1] - BESIDE_M) / USUAL_M[1])
    for edges in likely:
        left, right = edges.sides_m.T
        sides = edges.sides_m.T, left - beyond[::-1], right + beyond
        seen, *beside = (_sampled(strip, ends, edges.lean) for ends in sides)
        own, *others = (np.log(3 + one.mean(axis=2).std(axis=0).mean()) for one in (seen, *beside))
        strength, several = np.log([edges.strength, edges.strength / best]), len(left) > 1
        shared = [*strength, min(others) - own, several * panel, len(left) > 2]
        rgb = seen[:, :, 1:-1].mean(axis=1) + 1.0
        light = rgb.mean(axis=2)
        light = np.median(light / light.mean(axis=1, keepdims=True), axis=0)
        series = min(edges.width_m / strip.pixel_m / RESOLVED_PX, 1.0) * dct(light, norm="ortho")
        color = np.median(rgb[:, 3:-3].reshape(-1, 3), axis=0) / 100
        wide, red, mean = np.log([edges.width_m / USUAL_M[0], color[0] / color[2], color.mean()])
        look = [abs(series[1]), series[2], series[4], red, red**2, mean]
        kind = [1.0, wide, wide**2, several, *look]
        found.append([[*shared, *row] for row in np.kron(np.eye(len(KINDS)), kind)])
    return np.array(found, np.float64)


def _sampled(strip: Strip, ends: Array, lean: float) -> NDArray[np.float32]:
    """A strip between lines (2, n) that lean, by their places at the top: (rows, n, 18, 3)."""
    down = np.arange(len(strip.rgb), dtype=np.float32)[:, None]
    across = np.linspace(ends[0], ends[1], 18, axis=1).ravel()
    columns = ((across - strip.offset_m[0] + lean * ROW_M * down) / COLUMN_M).astype(np.float32)
    rows = np.broadcast_to(down, columns.shape).copy()
    seen = cv2.remap(strip.rgb, columns, rows, cv2.INTER_LINEAR)
    return np.asarray(seen.reshape(len(down), -1, 18, 3))
