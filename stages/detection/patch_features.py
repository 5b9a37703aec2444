"""Features of the pixels of a box: a patch of 32 x 32 samples with the box in its middle 20 x 20.

Every box is resampled to the same size, so that a far diamond and a near one have the same features. Colours are
logarithms (brightness, R/G, B/G): illumination multiplies colours, so it is an offset of their logarithms, which the
features remove.

The sizes below are the layout of the feature vector that the models were learned with, no settings.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.imaging import DARK_LEVEL, Pyramid
from wayside.stages.kernels import compiled, require_array, require_image

SIDE, INNER = 32, 20
"""Samples of the patch and of the box in it, each way."""

CELLS = 8
"""Cells of mean colour, each way."""

HOG_CELLS, HOG_BINS = 6, 9
"""Cells and directions (unsigned, 20 degrees each) of the histogram of gradients (Dalal and Triggs 2005)."""

OUTLINES = ("rectangle", "circle", "diamond", "triangle_up", "triangle_down", "octagon")
"""Outlines along which inside and outside are compared."""

RIM = 2.5
"""Width of the strips on either side of an outline, samples."""

CHANNELS = ("brightness", "red_green", "blue_green")


def patch_feature_names() -> tuple[str, ...]:
    """Names of the columns of `patch_features`, in order."""
    cells = [
        f"cell_{row}_{column}_{channel}"
        for row in range(CELLS)
        for column in range(CELLS)
        for channel in CHANNELS
    ]
    gradients = [
        f"gradient_{row}_{column}_{bin_}"
        for row in range(HOG_CELLS)
        for column in range(HOG_CELLS)
        for bin_ in range(HOG_BINS)
    ]
    spread = [
        f"{part}_{what}_{c}"
        for part in ("inside", "outside")
        for what in ("mean", "spread")
        for c in CHANNELS
    ]
    outlines = [f"{outline}_{what}" for outline in OUTLINES for what in ("mean", "worst")]
    return (*cells, *gradients, "gradient_total", *spread, *outlines)


def patch_features(levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.float32]:
    """Features of each box, shape (n, columns of `patch_feature_names`).

    Parameters
    ----------
    levels
        The image at full, half and quarter size, (height, width, 3) uint8 each.
    box
        (n, 4) float32 `[x0, y0, x1, y1]`, half open, full-size pixels; beyond the image its border is repeated.

    Raises
    ------
    ValueError
        If an image or the boxes are of another type or layout.
    """
    box = _checked(levels, box)
    result = np.zeros((len(box), len(patch_feature_names())), np.float32)
    full, half, quarter = levels
    _features(
        full,
        half,
        quarter,
        box,
        _LOG,
        _RIM_AT,
        _RIM_PART,
        _RIM_COUNT,
        _BIN_SINE,
        _BIN_COSINE,
        result,
    )
    return result


def drawn_patches(levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The patch of each box as an image, (n, 32, 32, 3); arguments and errors are those of `patch_features`."""
    box = _checked(levels, box)
    result = np.zeros((len(box), SIDE, SIDE, 3), np.uint8)
    full, half, quarter = levels
    _draw_all(full, half, quarter, box, result)
    return result


def _checked(levels: Pyramid, box: NDArray[np.float32]) -> NDArray[np.float32]:
    """The boxes as the kernels want them; raises ValueError."""
    if len(levels) != 3:
        raise ValueError(f"levels: wanted full, half and quarter size, found {len(levels)} images")
    for level in levels:
        require_image(level, "levels")
        if level.size == 0:
            raise ValueError("levels: wanted images with pixels, found an empty one")
    box = np.ascontiguousarray(box, np.float32)
    require_array(box, "box", np.float32, (None, 4))
    return box


def _inside(outline: str, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth of points inside an outline that fills the square -1..1 (negative: outside), y down."""
    ax, ay = np.abs(x), np.abs(y)
    if outline == "rectangle":
        return np.asarray(1 - np.maximum(ax, ay))
    if outline == "circle":
        return np.asarray(1 - np.hypot(x, y))
    if outline == "diamond":
        return np.asarray((1 - ax - ay) / np.sqrt(2))
    if outline == "octagon":
        corner = (2 - np.sqrt(2) + (np.sqrt(2) - 1) * 2 - ax - ay) / np.sqrt(2)
        return np.asarray(np.minimum(1 - np.maximum(ax, ay), corner))
    down = -y if outline == "triangle_up" else y
    slope = (1 - down - 2 * ax) / np.sqrt(5)
    return np.asarray(np.minimum(down + 1, slope))


def _rims() -> tuple[NDArray[np.int16], NDArray[np.uint8], NDArray[np.int32]]:
    """Samples near each outline and their segment: quadrant 0-3 of the inner strip, 4-7 of the outer one."""
    grid = (np.arange(SIDE) + 0.5 - SIDE / 2) / (INNER / 2)
    x, y = np.meshgrid(grid, grid)
    quadrant = (x > 0).astype(np.uint8) + 2 * (y > 0).astype(np.uint8)
    at = np.zeros((len(OUTLINES), SIDE * SIDE), np.int16)
    part = np.zeros((len(OUTLINES), SIDE * SIDE), np.uint8)
    count = np.zeros(len(OUTLINES), np.int32)
    for k, outline in enumerate(OUTLINES):
        depth = _inside(outline, x, y) * (INNER / 2)
        near = np.flatnonzero((np.abs(depth) <= RIM).ravel())
        at[k, : len(near)] = near
        part[k, : len(near)] = (quadrant + np.where(depth < 0, 4, 0)).ravel()[near]
        count[k] = len(near)
    return at, part, count


_LOG = np.log(np.arange(256) + DARK_LEVEL).astype(np.float32)
_RIM_AT, _RIM_PART, _RIM_COUNT = _rims()
_BIN_SINE = np.sin(np.pi * (np.arange(1, HOG_BINS)) / HOG_BINS).astype(np.float32)
_BIN_COSINE = np.cos(np.pi * (np.arange(1, HOG_BINS)) / HOG_BINS).astype(np.float32)


@compiled
def _draw(
    full: Any, half: Any, quarter: Any, x0: Any, y0: Any, x1: Any, y1: Any, pixels: Any
) -> None:
    """Sample the patch (32, 32, 3), linear between pixels, from the size that is nearest above its own."""
    longest = max(x1 - x0, y1 - y0) / INNER
    scale = 1
    image = full
    if longest >= 4:
        image = quarter
        scale = 4
    elif longest >= 2:
        image = half
        scale = 2
    height, width = image.shape[:2]
    dx = np.float32((x1 - x0) / (INNER * scale))
    dy = np.float32((y1 - y0) / (INNER * scale))
    left = np.float32(((x0 + x1) / scale - 1) / 2) - dx * np.float32((SIDE - 1) / 2)
    top = np.float32(((y0 + y1) / scale - 1) / 2) - dy * np.float32((SIDE - 1) / 2)
    # Weights are whole 256ths: integers are quick, and the same on every machine.
    at = np.empty((SIDE, 3), np.int32)
    for j in range(SIDE):
        x = min(max(left + j * dx, np.float32(0)), np.float32(width - 1))
        at[j, 0] = int(x)
        at[j, 1] = min(int(x) + 1, width - 1)
        at[j, 2] = int((x - int(x)) * 256)
    for i in range(SIDE):
        y = min(max(top + i * dy, np.float32(0)), np.float32(height - 1))
        above = image[int(y)]
        below = image[min(int(y) + 1, height - 1)]
        b = np.int32((y - int(y)) * 256)
        for j in range(SIDE):
            c0 = at[j, 0]
            c1 = at[j, 1]
            w01 = at[j, 2] * (256 - b)
            w11 = at[j, 2] * b
            w00 = (256 - at[j, 2]) * (256 - b)
            w10 = (256 - at[j, 2]) * b
            pixels[i, j, 0] = (
                w00 * above[c0, 0] + w01 * above[c1, 0] + w10 * below[c0, 0] + w11 * below[c1, 0]
            ) >> 16
            pixels[i, j, 1] = (
                w00 * above[c0, 1] + w01 * above[c1, 1] + w10 * below[c0, 1] + w11 * below[c1, 1]
            ) >> 16
            pixels[i, j, 2] = (
                w00 * above[c0, 2] + w01 * above[c1, 2] + w10 * below[c0, 2] + w11 * below[c1, 2]
            ) >> 16


@compiled
def _draw_all(full: Any, half: Any, quarter: Any, box: Any, pixels: Any) -> None:
    for n in range(box.shape[0]):
        _draw(full, half, quarter, box[n, 0], box[n, 1], box[n, 2], box[n, 3], pixels[n])


@compiled
def _logarithms(pixels: Any, log: Any, patch: Any) -> None:
    """Colours of the patch (3, 32, 32) as logarithms."""
    for i in range(SIDE):
        for j in range(SIDE):
            red = np.int32(pixels[i, j, 0])
            green = np.int32(pixels[i, j, 1])
            blue = np.int32(pixels[i, j, 2])
            patch[0, i, j] = log[(red + green + blue) // 3]
            patch[1, i, j] = log[red] - log[green]
            patch[2, i, j] = log[blue] - log[green]


@compiled
def _spread(patch: Any, row: Any, at: Any) -> None:
    """Mean and standard deviation of each channel inside the box and outside it."""
    first = (SIDE - INNER) // 2
    last = SIDE - first
    n = INNER * INNER
    m = SIDE * SIDE - n
    for c in range(3):
        # One sum a column, so that the loops are vectorised in the order written.
        total = np.zeros(SIDE, np.float32)
        square = np.zeros(SIDE, np.float32)
        inner = np.zeros(SIDE, np.float32)
        inner_square = np.zeros(SIDE, np.float32)
        for i in range(SIDE):
            for j in range(SIDE):
                v = patch[c, i, j]
                total[j] += v
                square[j] += v * v
        for i in range(first, last):
            for j in range(first, last):
                v = patch[c, i, j]
                inner[j] += v
                inner_square[j] += v * v
        inside = inner.sum()
        inside_square = inner_square.sum()
        mean = inside / n
        row[at + c] = mean
        row[at + 3 + c] = np.sqrt(max(inside_square / n - mean * mean, np.float32(0)))
        mean = (total.sum() - inside) / m
        spread = (square.sum() - inside_square) / m - mean * mean
        row[at + 6 + c] = mean
        row[at + 9 + c] = np.sqrt(max(spread, np.float32(0)))
    # Brightness outside relative to inside; brightness inside stays as it is.
    row[at + 6] -= row[at]


@compiled
def _cells(patch: Any, row: Any, middle: Any) -> None:
    """Mean colour of 8 x 8 cells; brightness relative to that of the box."""
    size = SIDE // CELLS
    k = 0
    for i in range(CELLS):
        for j in range(CELLS):
            for c in range(3):
                total = np.float32(0)
                for y in range(i * size, (i + 1) * size):
                    for x in range(j * size, (j + 1) * size):
                        total += patch[c, y, x]
                row[k] = total / (size * size) - (middle if c == 0 else np.float32(0))
                k += 1


@compiled
def _gradients(patch: Any, row: Any, at: Any, sine: Any, cosine: Any) -> None:
    """Histogram of directions per cell of the strongest channel's gradient, over its total; the total behind it."""
    size = (SIDE - 2) // HOG_CELLS
    total = np.float32(0)
    strength = np.empty(SIDE, np.float32)
    bin_ = np.empty(SIDE, np.int32)
    for i in range(1, SIDE - 1):
        # A row without branches, so that it is vectorised; then its strengths into their cells.
        for j in range(1, SIDE - 1):
            gx = patch[0, i, j + 1] - patch[0, i, j - 1]
            gy = patch[0, i + 1, j] - patch[0, i - 1, j]
            best = gx * gx + gy * gy
            for c in range(1, 3):
                dx = patch[c, i, j + 1] - patch[c, i, j - 1]
                dy = patch[c, i + 1, j] - patch[c, i - 1, j]
                q = dx * dx + dy * dy
                more = q > best
                best = q if more else best
                gx = dx if more else gx
                gy = dy if more else gy
            back = (gy < 0) | ((gy == 0) & (gx < 0))
            gx = -gx if back else gx
            gy = -gy if back else gy
            # Number of bin borders that the direction lies beyond.
            beyond = np.int32(0)
            for k in range(HOG_BINS - 1):
                beyond += np.int32(gy * cosine[k] - gx * sine[k] >= 0)
            bin_[j] = beyond
            strength[j] = np.sqrt(best)
        for j in range(1, SIDE - 1):
            total += strength[j]
            cell = ((i - 1) // size) * HOG_CELLS + (j - 1) // size
            row[at + cell * HOG_BINS + bin_[j]] += strength[j]
    n = HOG_CELLS * HOG_CELLS * HOG_BINS
    over = np.float32(1) / (total + np.float32(1))
    for k in range(n):
        row[at + k] *= over
    row[at + n] = np.log(total + np.float32(1))


@compiled
def _separation(patch: Any, rim_at: Any, rim_part: Any, rim_count: Any, row: Any, at: Any) -> None:
    """Step in colour across each outline over the scatter beside it: mean of the quadrants, and the worst."""
    flat = patch.reshape(3, SIDE * SIDE)
    total = np.empty((8, 4), np.float32)
    square = np.empty(8, np.float32)
    for k in range(rim_at.shape[0]):
        total[:] = 0
        square[:] = 0
        for q in range(rim_count[k]):
            p = rim_at[k, q]
            part = rim_part[k, q]
            a = flat[0, p]
            b = flat[1, p]
            c = flat[2, p]
            total[part, 0] += a
            total[part, 1] += b
            total[part, 2] += c
            total[part, 3] += 1
            square[part] += a * a + b * b + c * c
        mean = np.float32(0)
        worst = np.float32(1e9)
        for quadrant in range(4):
            step = np.float32(0)
            scatter = np.float32(0)
            for c in range(3):
                u = total[quadrant, c] / total[quadrant, 3]
                v = total[quadrant + 4, c] / total[quadrant + 4, 3]
                step += (u - v) * (u - v)
                scatter -= u * u + v * v
            scatter += square[quadrant] / total[quadrant, 3]
            scatter += square[quadrant + 4] / total[quadrant + 4, 3]
            ratio = np.sqrt(step / (max(scatter, np.float32(0)) + np.float32(0.01)))
            mean += ratio / 4
            worst = min(worst, ratio)
        row[at + 2 * k] = mean
        row[at + 2 * k + 1] = worst


@compiled
def _features(
    full: Any,
    half: Any,
    quarter: Any,
    box: Any,
    log: Any,
    rim_at: Any,
    rim_part: Any,
    rim_count: Any,
    sine: Any,
    cosine: Any,
    result: Any,
) -> None:
    pixels = np.empty((SIDE, SIDE, 3), np.uint8)
    patch = np.empty((3, SIDE, SIDE), np.float32)
    gradients = CELLS * CELLS * 3
    spread = gradients + HOG_CELLS * HOG_CELLS * HOG_BINS + 1
    for n in range(box.shape[0]):
        row = result[n]
        _draw(full, half, quarter, box[n, 0], box[n, 1], box[n, 2], box[n, 3], pixels)
        _logarithms(pixels, log, patch)
        _spread(patch, row, spread)
        _cells(patch, row, row[spread])
        _gradients(patch, row, gradients, sine, cosine)
        _separation(patch, rim_at, rim_part, rim_count, row, spread + 12)
