"""Corners that tie images together, and candidates' centres without lens distortion (report chapters 6 and 8)."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections
from wayside.schemas.settings import FeatureSettings
from wayside.stages.geometry import ideal_points
from wayside.stages.kernels import compiled, compiled_within

PYRAMID_LEVELS = 3
"""Levels of the corners' image pyramid, from half size."""
PYRAMID_SCALE = 1.5
"""From level to level: an object 20 m away grows 1.7 times over 8 m."""
CORNER_CONTRAST = 7
"""Least strength of a corner, grey levels: low enough for the texture of roads and verges."""
CORNER_CELL_PX = 32
"""Side of a cell, in pixels of its level."""
BLUR_PX = 5
"""Side of the mean of which descriptors compare pixels."""
REACH_PX = 15
"""Farthest of these pixels from their corner, each way."""
MARGIN_PX = REACH_PX + 1
PATTERN = np.rint(np.random.default_rng(0).normal(0, 6, (256, 4))).clip(-REACH_PX, REACH_PX)
"""Pairs of pixels that a descriptor compares, (u, v, u, v) off the corner: normal, a fifth of the patch wide."""


def extract_features(
    images: Iterator[Detections], settings: FeatureSettings
) -> Iterator[Detections]:
    """Detect corners for tie points and undistort the candidates' centres: the last stage that uses one image alone.

    The grey image stays for the registration of ties, the colours for the measuring of panels; label images and
    smaller sizes are dropped.
    """
    for item in images:
        grey, camera, candidates = item.image.grey, item.frame.camera, item.candidates
        features = item.features
        if grey is not None:
            corners, descriptors = tie_corners(grey, settings)
            features = replace(features, corners=corners, descriptors=descriptors)
        if camera is not None:
            candidates = replace(candidates, ideal=ideal_points(camera, candidates.center))
        yield Detections(replace(item.segmentation, labels=None), candidates, features)


def tie_corners(
    grey: NDArray[np.uint8], settings: FeatureSettings
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Corners (n, 2) of a grey image, recorded pixels, and descriptors (n, 32).

    FAST corners of a pyramid (Rosten and Drummond 2006), the strongest of each cell: weak ones on road and verge are
    kept as well as strong ones against the sky. BRIEF descriptors (Calonder et al. 2010) are upright, as cameras on the
    road hardly roll. The pyramid starts at half size: the blur of lens and JPEG lies below that scale.
    """
    level = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    corners, descriptors = list[Any](), list[Any]()
    for index in range(PYRAMID_LEVELS):
        if index > 0:
            level = cv2.resize(level, None, fx=1 / PYRAMID_SCALE, fy=1 / PYRAMID_SCALE)
        places = _strongest(np.asarray(level, np.uint8), settings.corners_per_cell)
        smooth = np.asarray(cv2.blur(level, (BLUR_PX, BLUR_PX)), np.uint8)
        offsets = PATTERN.astype(np.int64).reshape(-1, 2, 2) @ [1, level.shape[1]]
        # Pixel centres are at integers: the centre of a block of s pixels lies (s - 1) / 2 from its first.
        scale = np.array([grey.shape[1] / level.shape[1], grey.shape[0] / level.shape[0]])
        corners.append(((places + 0.5) * scale - 0.5).astype(np.float32))
        descriptors.append(_described(smooth, places, offsets.view(np.uint64)))
    return np.concatenate(corners), np.concatenate(descriptors)


def _strongest(level: NDArray[np.uint8], most: int) -> NDArray[np.int64]:
    """Places (n, 2) of the strongest corners of each cell, no weaker than their neighbours; the strongest first."""
    # whole numbers that order corners by strength, then by place, row after row
    rows, columns = (1 + side // CORNER_CELL_PX for side in level.shape)
    least = (CORNER_CONTRAST - 1 << 32) - level.size
    best = np.full((rows, columns, most), least)
    _fill_strongest(_strength(level), best)
    place = -np.sort(best[best > least])[::-1] & 0xFFFFFFFF
    return np.column_stack([place % level.shape[1], place // level.shape[1]])


@compiled
def _strength(level: NDArray[np.uint8]) -> NDArray[np.uint8]:
    strength = np.zeros_like(level)
    height, left, right = level.shape[0], MARGIN_PX, level.shape[1] - MARGIN_PX
    part = slice(left - 3, right + 3)
    for grey in (level, ~level):
        for y in range(MARGIN_PX, height - MARGIN_PX):
            above = grey[y - 3, part], grey[y - 2, part], grey[y - 1, part]
            below = grey[y + 1, part], grey[y + 2, part], grey[y + 3, part]
            _raise_strength(above, grey[y, part], below, strength[y, left:right])
    return strength


@compiled
def _fill_strongest(strength: NDArray[np.uint8], best: NDArray[np.int64]) -> None:
    # A pixel takes part that is no weaker than those around it, and stronger than the weakest of its cell so far.
    height, width = strength.shape
    part = slice(MARGIN_PX - 1, width - MARGIN_PX + 1)
    least, peaks = np.zeros((2, -(-width // CORNER_CELL_PX) * CORNER_CELL_PX), np.uint8)
    eights = peaks.view(np.uint64)
    for y in range(MARGIN_PX, height - MARGIN_PX):
        cells = best[(y - MARGIN_PX) // CORNER_CELL_PX]
        if (y - MARGIN_PX) % CORNER_CELL_PX == 0:
            least[:] = CORNER_CONTRAST
        _keep_peaks(strength[y - 1, part], strength[y, part], strength[y + 1, part], least, peaks)
        for n in range(len(eights)):
            if eights[n] == 0:
                continue
            values = cells[8 * n // CORNER_CELL_PX]
            for x in range(8 * n, 8 * n + 8):
                if peaks[x] <= (values[-1] >> 32) + 1:
                    continue
                found, k = (int(peaks[x]) << 32) - (y * width + x + MARGIN_PX), len(values) - 1
                while k > 0 and values[k - 1] < found:
                    values[k] = values[k - 1]
                    k -= 1
                values[k] = found
            begin = 8 * n // CORNER_CELL_PX * CORNER_CELL_PX
            least[begin : begin + CORNER_CELL_PX] = min(255, (values[-1] >> 32) + 2)


@compiled_within
def _keep_peaks(above: Any, row: Any, below: Any, least: Any, peaks: Any) -> None:
    # The strengths of a row, 0 where one of the eight around is larger, or the least wanted.
    for x in range(len(row) - 2):
        around = max(above[x], above[x + 1], above[x + 2], row[x], row[x + 2])
        around = max(around, below[x], below[x + 1], below[x + 2], least[x])
        peaks[x] = row[x + 1] * np.uint8(row[x + 1] >= around)


@compiled_within
def _raise_strength(above: Any, centre: Any, below: Any, strength: Any) -> None:
    # Of the pixels of a row between three above and three below: to how much darker each is than all of nine neighbours
    # in turn on a circle, if that is more. The least of eight serves two arcs of nine.
    a3, a2, a1 = above
    b1, b2, b3 = below
    for x in range(strength.shape[0]):
        p0, p1, p2, p3 = a3[x + 3], a3[x + 4], a2[x + 5], a1[x + 6]
        p4, p5, p6, p7 = centre[x + 6], b1[x + 6], b2[x + 5], b3[x + 4]
        p8, p9, p10, p11 = b3[x + 3], b3[x + 2], b2[x + 1], b1[x]
        p12, p13, p14, p15 = centre[x], a1[x], a2[x + 1], a3[x + 2]
        q1, q3, q5, q7 = min(p1, p2), min(p3, p4), min(p5, p6), min(p7, p8)
        q9, q11, q13, q15 = min(p9, p10), min(p11, p12), min(p13, p14), min(p15, p0)
        r1, r3, r5, r7 = min(q1, q3), min(q3, q5), min(q5, q7), min(q7, q9)
        r9, r11, r13, r15 = min(q9, q11), min(q11, q13), min(q13, q15), min(q15, q1)
        best = max(min(r1, r5, max(p0, p9)), min(r3, r7, max(p2, p11)), centre[x + 3])
        best = max(best, min(r5, r9, max(p4, p13)), min(r7, r11, max(p6, p15)))
        best = max(best, min(r9, r13, max(p8, p1)), min(r11, r15, max(p10, p3)))
        best = max(best, min(r13, r1, max(p12, p5)), min(r15, r3, max(p14, p7)))
        strength[x] = max(strength[x], best - centre[x + 3])


@compiled
def _described(
    smooth: NDArray[np.uint8], places: NDArray[np.int64], offsets: NDArray[np.uint64]
) -> NDArray[np.uint8]:
    codes = np.empty((len(places), 32), np.uint8)
    pixels, width = smooth.reshape(-1), smooth.shape[1]
    for n in range(places.shape[0]):
        at = np.uint64(places[n, 1] * width + places[n, 0])
        for k in range(0, 256, 8):
            code = 0
            for bit in range(8):
                darker = pixels[at + offsets[k + bit, 0]] < pixels[at + offsets[k + bit, 1]]
                code |= int(darker) << bit
            codes[n, k // 8] = code
    return codes
