"""K-means of the colours of an image, and the nearest centre of every pixel (report chapters 2.1 and 2.3).

Every n-th pixel falls into one of 32^3 bins that keep count and colour sums, so that a bin stands at its true mean.
Weighted Lloyd steps on the thousand bins in use cost little. One step on the sample in full colours follows, then
the centres are rounded, which makes all later arithmetic exact: squared distances of whole colours fit single
precision. The start is k-means++ from a fixed seed, and every machine draws the same: the same image has the same
palette, whatever came before it.
"""

from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Bytes, Floats, compiled, require_array, require_image

MOST_CENTERS = 256
"""A label image holds bytes."""
DIFFERENCES = 443
"""Rounded distances between colours: 0 to 442 = round(255 sqrt 3)."""
ROUNDED = np.arange(DIFFERENCES, dtype=np.uint16)
"""These distances themselves."""
SEED = 1
"""Seed of k-means++."""
TRIALS = 4
"""Draws for each centre (greedy k-means++, Arthur and Vassilvitskii 2007)."""
LLOYD_STEPS = 20
"""Lloyd steps on the bins at most."""
SETTLED = 0.5
"""Colour levels: Lloyd steps end when no centre moves further; centres are rounded to whole levels."""
_BINS = 32**3
_CHUNK, _PACKED = 1024, 16


def sample_colors(rgb: Bytes, at_least: int) -> Bytes:
    """Colours (n, 3) of a regular sample of `at_least` so many pixels, where there are.

    `rgb`: image or whole rows of one, (height, width, 3) uint8, C-contiguous. Raises ValueError where it is of another
    type or layout, or empty.
    """
    require_image(rgb)
    height, width = rgb.shape[:2]
    if height * width == 0:
        raise ValueError(f"rgb: an image of {width} x {height} has no pixel")
    step = max(1, min(isqrt(height * width // at_least), height, width))
    pixels = rgb.view("V3")[step // 2 :: step, step // 2 :: step]  # three bytes are copied as one
    return np.ascontiguousarray(pixels).view(np.uint8).reshape(-1, 3)


def palette(sample: Bytes, clusters: int) -> Bytes:
    """K-means of sampled colours (n, 3): whole-numbered centres, darkest first, shape (clusters, 3).

    Centres repeat where there are fewer colours. Raises ValueError where `clusters` is not from 2 to 256.
    """
    if not 2 <= clusters <= MOST_CENTERS:
        raise ValueError(f"clusters: {clusters} is outside 2 to {MOST_CENTERS}. Set another k.")
    require_array(sample, "sample", np.uint8, (None, 3))
    bins = np.empty(len(sample), np.uint16)
    sums = _sums(sample, bins, _number_bins(sample, bins))
    weight = sums[:, 3].astype(np.float32)
    mean = (sums[:, :3] * (np.float32(1) / weight)[:, None]).T.astype(np.float32, "C")
    centers = np.empty((clusters, 3), np.float32)
    _spread_start(mean, weight, centers)
    _settle(mean, weight, centers)
    rounded = np.rint(centers).astype(np.uint8)
    sums = _sums(sample, nearest_centers(sample, rounded)[0].astype(np.uint16), clusters)
    filled = sums[:, 3] > 0
    rounded[filled] = np.rint(sums[filled, :3] / sums[filled, 3:])
    order = np.lexsort((*rounded.T[::-1], rounded.sum(axis=1, dtype=np.int64)))
    return np.asarray(rounded[order])


def nearest_centers(
    colors: Bytes, centers: NDArray[Any], of_distance: NDArray[Any] = ROUNDED
) -> tuple[Bytes, NDArray[Any]]:
    """Nearest centre of each colour, the lower one on a tie, and the entry of its rounded distance.

    The rounded distances themselves are the difference image of the report (chapter 2.3).

    `colors` (..., 3): an image or whole rows of one, uint8, C-contiguous. `centers` (k, 3): whole-numbered colours, k
    from 1 to 256. `of_distance` (443,): an entry for each rounded distance. Returns labels (uint8) and entries (...).

    Raises ValueError where an array is of another type, shape or layout.
    """
    shape = colors.shape[:-1]
    require_array(colors, "colors", np.uint8, (*shape, 3))
    require_array(of_distance, "of_distance", of_distance.dtype.type, (DIFFERENCES,))
    whole = np.ascontiguousarray(centers, np.float32)
    if whole.ndim != 2 or whole.shape[1] != 3 or not 1 <= len(whole) <= MOST_CENTERS:
        raise ValueError(
            f"centres: shape {whole.shape} instead of (k, 3) with k from 1 to {MOST_CENTERS}"
        )
    if not np.array_equal(whole, np.clip(np.rint(whole), 0, 255)):
        raise ValueError("centres: not whole numbers from 0 to 255. Round and clip them first.")
    label, entry = np.empty(shape, np.uint8), np.empty(shape, of_distance.dtype)
    _fill_nearest(colors.ravel(), whole, of_distance, label.ravel(), entry.ravel())
    return label, entry


@compiled
def _number_bins(pixels: Bytes, bins: NDArray[np.uint16]) -> int:
    """Number the bins in the order in which the pixels (n, 3) meet them: that of each pixel (n,), and how many."""
    number, used = np.full(_BINS, _BINS, np.uint16), 0
    for i in range(pixels.shape[0]):
        r, g, b = np.uint32(pixels[i, 0]), np.uint32(pixels[i, 1]), np.uint32(pixels[i, 2])
        code = np.uint32((r >> 3 << 10) + (g >> 3 << 5) + (b >> 3))
        if number[code] == _BINS:
            number[code] = used
            used += 1
        bins[i] = number[code]
    return used


@compiled
def _sums(pixels: Bytes, group: NDArray[np.uint16], count: int) -> NDArray[np.int64]:
    """Sums of the colours (n, 3) of each group, and how many there are: (count, 4)."""
    sums = np.zeros((count, 4), np.int64)
    for i in range(group.size):
        for c in range(3):
            sums[group[i], c] += pixels[i, c]
        sums[group[i], 3] += 1
    return sums


@compiled
def _spread_start(mean: Floats, weight: Floats, centers: Floats) -> None:
    """Greedy k-means++ (Arthur and Vassilvitskii 2007) on weighted bins, (clusters, 3): the best of some draws each.

    The generator (xorshift64) is its own, so that every machine draws the same.
    """
    n = weight.size
    squared, left, best_left = np.empty((3, n), np.float32)
    squared[:] = np.float32(np.inf)
    total = np.cumsum(weight)
    state = np.uint64(SEED * 2 + 1) * np.uint64(0x9E3779B97F4A7C15)
    for j in range(centers.shape[0]):
        least = np.inf
        for _ in range(TRIALS if j else 1):
            state ^= state << np.uint64(13)
            state ^= state >> np.uint64(7)
            state ^= state << np.uint64(17)
            target = np.float64(state >> np.uint64(11)) / 2.0**53 * total[n - 1]
            drawn, cost = min(np.searchsorted(total, target), n - 1), 0.0
            red, green, blue = mean[0, drawn], mean[1, drawn], mean[2, drawn]
            for i in range(n):
                r, g, b = mean[0, i] - red, mean[1, i] - green, mean[2, i] - blue
                left[i] = min(r * r + g * g + b * b, squared[i])
                cost += weight[i] * left[i]
            if cost < least:
                least = cost
                left, best_left = best_left, left
                centers[j] = mean[:, drawn]
        squared, best_left = best_left, squared
        total = np.cumsum(weight * squared)


@compiled
def _settle(colors: Floats, weight: Floats, centers: Floats) -> None:
    """Move centres (k, 3) to the weighted means of their colours (3, n) until they settle.

    A centre without colours moves to the colour that costs most, where it costs anything.
    """
    n, k = weight.size, centers.shape[0]
    label, squared = np.zeros(n, np.int32), np.empty(n, np.float32)
    for _ in range(LLOYD_STEPS):
        squared[:] = np.float32(np.inf)
        for j in range(k):  # the inner loop runs in vector registers
            red, green, blue = centers[j, 0], centers[j, 1], centers[j, 2]
            for i in range(n):
                r, g, b = colors[0, i] - red, colors[1, i] - green, colors[2, i] - blue
                d = r * r + g * g + b * b
                label[i] = np.int32(j) if d < squared[i] else label[i]
                squared[i] = min(d, squared[i])
        sums, moved = np.zeros((k, 4)), 0.0
        for i in range(n):
            own = sums[label[i]]
            for c in range(3):
                own[c] += weight[i] * colors[c, i]
            own[3] += weight[i]
        for j in range(k):
            if sums[j, 3] > 0:
                new = sums[j, :3] / sums[j, 3]
                moved = max(moved, ((new - centers[j]) ** 2).sum())
                centers[j] = new
                continue
            worst = np.argmax(weight * squared)
            if squared[worst] > 0:
                centers[j], squared[worst], moved = colors[:, worst], 0, np.inf
        if moved <= SETTLED * SETTLED:
            break


@compiled
def _fill_nearest(
    colors: Bytes, centers: Floats, of_distance: NDArray[Any], label: Bytes, entry: NDArray[Any]
) -> None:
    """Label and entry (n,) of flat colours (3 n,), by one minimum over 16 centres m at a time.

    16 (|m|^2 - 2 m x) + number of the centre is a whole number below 2^24, which single precision holds. Its four
    lowest bits are the label, the others the squared distance less |x|^2. Each loop runs in vector registers.
    """
    k, levels = len(centers), np.zeros(3 * _CHUNK, np.float32)
    red, green, blue, least = np.empty((4, _CHUNK), np.float32)
    nearest, size = np.empty(_CHUNK, np.int32), np.float32(_PACKED)
    term = np.empty((k, 4), np.float32)
    for j in range(k):
        term[j, :3] = -2 * size * centers[j]
        term[j, 3] = size * (centers[j] ** 2).sum() + j % _PACKED
    for start in range(0, label.size, _CHUNK):
        part = colors[3 * start : 3 * (start + _CHUNK)]
        for x in range(part.size):
            levels[x] = np.float32(part[x])
        for x in range(_CHUNK):  # of the last chunk, the rest is measured once more, and not read
            red[x], green[x], blue[x] = levels[3 * x], levels[3 * x + 1], levels[3 * x + 2]
        nearest[:] = 2**31 - 1
        for first in range(0, k, _PACKED):
            least[:] = np.inf
            for j in range(first, min(first + _PACKED, k), 2):  # two at a time: half the loads
                r, g, b, own = term[j]
                r2, g2, b2, own2 = term[min(j + 1, k - 1)]
                for x in range(_CHUNK):
                    one = red[x] * r + green[x] * g + blue[x] * b + own
                    two = red[x] * r2 + green[x] * g2 + blue[x] * b2 + own2
                    both = two if two < one else one
                    least[x] = both if both < least[x] else least[x]
            for x in range(_CHUNK):
                square = np.int32(red[x] * red[x] + green[x] * green[x] + blue[x] * blue[x])
                packed = np.int32(least[x])
                square += np.int32(packed >> 4)
                this = square * np.int32(MOST_CENTERS) + np.int32(first + (packed & 15))
                nearest[x] = this if this < nearest[x] else nearest[x]
        labels, entries = label[start : start + _CHUNK], entry[start : start + _CHUNK]
        for x in range(labels.size):
            labels[x] = nearest[x] & (MOST_CENTERS - 1)
        for x in range(_CHUNK):
            nearest[x] = np.int32(np.sqrt(np.float32(nearest[x] >> 8)) + np.float32(0.5))
        for x in range(labels.size):
            entries[x] = of_distance[np.uint32(nearest[x])]
