"""K-means on a histogram of colours: the palette of pass one (report chapter 2.1).

Every n-th pixel falls into one of 64^3 bins that keep count and colour sums, so that a bin stands at its true mean.
Weighted Lloyd steps on the few thousand bins in use cost little. One step on the sample in full colours follows, then
the centres are rounded, which makes all later arithmetic exact. The start is k-means++ from a fixed seed: the same
image has the same palette, whatever came before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings import SegmentSettings
from wayside.stages.kernels import compiled, require_image
from wayside.stages.segmentation.label_images import MOST_CENTERS, mean_of_labels

SEED = 1
"""Seed of the first start of k-means++; further starts count on."""
STARTS = 2
"""Starts of K-means; the one of the smallest sum of squared distances is taken."""
TRIALS = 4
"""Draws for each centre of a start (greedy k-means++, Arthur and Vassilvitskii 2007)."""
LLOYD_STEPS = 20
"""Lloyd steps of a start at most."""
SETTLED = 0.5
"""Colour levels: Lloyd steps end when no centre moves further; centres are rounded to whole levels."""
_BINS = 1 << 18


@dataclass(frozen=True, slots=True)
class ColorBins:
    """A sample of an image: its pixels (n, 3) uint8 and its bins, `mean` (3, m) float32 and `weight` (m,) float32."""

    pixels: NDArray[np.uint8]
    mean: NDArray[np.float32]
    weight: NDArray[np.float32]


def sample_colors(rgb: NDArray[np.uint8], at_least: int) -> ColorBins:
    """Colours of a regular sample of `at_least` so many pixels, where there are, as pixels and as 6-bit bins.

    Parameters
    ----------
    rgb
        Image or whole rows of one, (height, width, 3) uint8, C-contiguous, not empty.
    at_least
        Pixels.

    Raises
    ------
    ValueError
        If the image is of another type or layout, or empty.
    """
    require_image(rgb)
    height, width = rgb.shape[:2]
    if height * width == 0:
        raise ValueError(f"rgb: an image of {width} x {height} has no pixel")
    step = max(1, min(isqrt(height * width // at_least), height, width))
    pixels = rgb[step // 2 :: step, step // 2 :: step].reshape(-1, 3)
    sums = np.zeros((len(pixels), 4), np.float64)
    used = _fill_bins(np.ascontiguousarray(pixels), np.full(_BINS, -1, np.int32), sums)
    weight = sums[:used, 3].astype(np.float32)
    mean = (sums[:used, :3] * (np.float32(1) / weight)[:, None]).astype(np.float32)
    return ColorBins(pixels, np.ascontiguousarray(mean.T), weight)


def palette(sample: ColorBins, settings: SegmentSettings) -> NDArray[np.uint8]:
    """K-means of the sampled colours: whole-numbered centres, darkest first, shape (clusters, 3).

    Parameters
    ----------
    sample
        Colours of the image.
    settings
        k (centres repeat where there are fewer colours), starts and Lloyd steps.

    Raises
    ------
    ValueError
        If k is not from 2 to 256.
    """
    clusters = settings.clusters
    if not 2 <= clusters <= MOST_CENTERS:
        raise ValueError(f"clusters: {clusters} is outside 2 to {MOST_CENTERS}. Set another k.")
    best, least = np.zeros((clusters, 3), np.float32), np.inf
    for seed in range(SEED, SEED + STARTS):
        centers = np.empty((clusters, 3), np.float32)
        _spread_start(sample.mean, sample.weight, seed, TRIALS, centers)
        inertia = _lloyd(sample.mean, sample.weight, centers, LLOYD_STEPS, SETTLED)
        if inertia < least:
            best, least = centers, inertia
    polished = mean_of_labels(sample.pixels, np.rint(best))
    rounded = np.rint(polished).astype(np.uint8)
    brightness = rounded.sum(axis=1, dtype=np.int64)
    order = np.lexsort((rounded[:, 2], rounded[:, 1], rounded[:, 0], brightness))
    return np.asarray(rounded[order])


@compiled
def _fill_bins(
    pixels: NDArray[np.uint8], number: NDArray[np.int32], sums: NDArray[np.float64]
) -> int:
    """Colour sums and count of each bin, in the order in which the sample meets them; how many bins there are.

    `number` (-1 everywhere) becomes the row of each bin.
    """
    used = 0
    for i in range(pixels.shape[0]):
        red, green, blue = np.int32(pixels[i, 0]), np.int32(pixels[i, 1]), np.int32(pixels[i, 2])
        colour = (red >> 2) << 12 | (green >> 2) << 6 | blue >> 2
        row = number[colour]
        if row < 0:
            row = used
            number[colour] = row
            used += 1
        sums[row, 0] += red
        sums[row, 1] += green
        sums[row, 2] += blue
        sums[row, 3] += 1
    return used


@compiled
def _spread_start(
    mean: NDArray[np.float32],
    weight: NDArray[np.float32],
    seed: int,
    trials: int,
    centers: NDArray[np.float32],
) -> None:
    """Greedy k-means++ (Arthur and Vassilvitskii 2007) on weighted bins: the best of some `trials` for each centre.

    The generator (xorshift64) is its own, so that every machine draws the same.
    """
    n = weight.size
    squared = np.ones(n, np.float32)
    trial_squared, best_squared = np.empty(n, np.float32), np.empty(n, np.float32)
    cost = weight.copy()
    state = np.uint64(seed * 2 + 1) * np.uint64(0x9E3779B97F4A7C15)
    for j in range(centers.shape[0]):
        total = np.cumsum(cost)
        least = np.inf
        for _ in range(trials if j > 0 else 1):
            state ^= state << np.uint64(13)
            state ^= state >> np.uint64(7)
            state ^= state << np.uint64(17)
            target = np.float64(state >> np.uint64(11)) / 9007199254740992.0 * total[-1]
            drawn = min(np.searchsorted(total, target), n - 1)
            red, green, blue = mean[0, drawn], mean[1, drawn], mean[2, drawn]
            for i in range(n):
                r, g, b = mean[0, i] - red, mean[1, i] - green, mean[2, i] - blue
                d = r * r + g * g + b * b
                trial_squared[i] = d if j == 0 or d < squared[i] else squared[i]
            left = np.float64(0)
            for i in range(n):
                left += weight[i] * trial_squared[i]
            if left < least:
                least = left
                for c in range(3):
                    centers[j, c] = mean[c, drawn]
                trial_squared, best_squared = best_squared, trial_squared
        squared, best_squared = best_squared, squared
        for i in range(n):
            cost[i] = weight[i] * squared[i]


@compiled
def _nearest(
    mean: NDArray[np.float32],
    centers: NDArray[np.float32],
    label: NDArray[np.int32],
    squared: NDArray[np.float32],
) -> None:
    """Nearest centre of each bin; the loop over bins is the inner one, so that it runs in vector registers."""
    squared[:] = np.float32(1e30)
    for j in range(centers.shape[0]):
        red, green, blue = centers[j, 0], centers[j, 1], centers[j, 2]
        number = np.int32(j)
        for i in range(squared.size):
            r, g, b = mean[0, i] - red, mean[1, i] - green, mean[2, i] - blue
            d = r * r + g * g + b * b
            nearer = d < squared[i]
            squared[i] = d if nearer else squared[i]
            label[i] = number if nearer else label[i]


@compiled
def _lloyd(
    mean: NDArray[np.float32],
    weight: NDArray[np.float32],
    centers: NDArray[np.float32],
    steps: int,
    settled: float,
) -> float:
    """Move the centres to the weighted means of their bins until they settle; the weighted sum of squared distances.

    A centre without bins moves to the bin that costs most.
    """
    k = centers.shape[0]
    label = np.zeros(weight.size, np.int32)
    squared = np.empty(weight.size, np.float32)
    sums = np.empty((k, 4), np.float64)
    for _ in range(steps):
        _nearest(mean, centers, label, squared)
        sums[:] = 0
        for i in range(weight.size):
            w = weight[i]
            for c in range(3):
                sums[label[i], c] += w * mean[c, i]
            sums[label[i], 3] += w
        moved = 0.0
        for j in range(k):
            if sums[j, 3] > 0:
                step_squared = 0.0
                for c in range(3):
                    value = sums[j, c] / sums[j, 3]
                    step_squared += (value - centers[j, c]) ** 2
                    centers[j, c] = value
                moved = max(moved, step_squared)
            else:
                worst = np.argmax(weight * squared)
                if squared[worst] > 0:
                    for c in range(3):
                        centers[j, c] = mean[c, worst]
                    squared[worst] = 0
                    moved = np.inf
        if moved <= settled * settled:
            break
    _nearest(mean, centers, label, squared)
    inertia = 0.0
    for i in range(weight.size):
        inertia += weight[i] * squared[i]
    return inertia
