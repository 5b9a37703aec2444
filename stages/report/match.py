"""The report's matching: a SIFT descriptor of each region, the midpoint of two rays (chapters 5 and 7)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections, Features, Regions, box_centers
from wayside.schemas.landmarks import Crop, TrackedFrame
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import TrackSettings
from wayside.stages.geometry import cross_matrices
from wayside.stages.kernels import Array, compiled
from wayside.stages.mapping import (
    GAP_SHARE,
    LandmarkFit,
    LandmarkMeasurement,
    TravelledPath,
    WindowFrame,
    box_panel,
    build_landmark,
    candidates_of,
    fit_views,
    through_window,
)
from wayside.stages.report.trajectory import trajectory_of

AROUND = 1.5
"""Sides of what is described, in sides of the region's box: the face and the edge around it."""
LARGEST_ENTRY = 0.2
"""No entry of a normalised descriptor is larger (Lowe 2004)."""
_LEVELS, _CELLS, _SAMPLES, _ANGLES, _STRIDE = 4, 4, 16, 8, 12
_turn = np.arange(_ANGLES) * (2 * np.pi / _ANGLES)
_DIRECTIONS = np.stack([np.cos(_turn), np.sin(_turn)], axis=1).astype(np.float32)
_middles = (np.arange(_SAMPLES) + 0.5) * (_CELLS / _SAMPLES) - 0.5
_WEIGHTS = np.maximum(0, 1 - abs(_middles - np.arange(_CELLS)[:, None])).astype(np.float32)


def extract_sift(images: Iterator[Detections]) -> Iterator[Detections]:
    """Describe the open candidates of each image; other key points stay as they are.

    The regions themselves are the key points. SIFT's own detector would cost fifty times as much, and most of its
    points lie off the candidates or on their edges.
    """
    for item in images:
        grey, candidates = item.image.grey, item.candidates
        if grey is not None:
            rows = candidates.open_rows()
            features = replace(
                item.features,
                sign_points=candidates.center[rows].astype(np.float32),
                sign_descriptors=describe_regions(grey, candidates.regions.select(rows)),
                sign_rows=rows.astype(np.int32),
            )
            item = replace(item, features=features)
        yield item


def describe_regions(grey: NDArray[np.uint8], regions: Regions) -> NDArray[np.float32]:
    """Descriptor (n, 132) of each region: SIFT, the share of its box that it fills, and its mean colour, 0 to 1.

    SIFT of an upright patch as large as the box and its surroundings (Lowe 2004; of regions, Mikolajczyk et al. 2005):
    4 x 4 cells of gradients in 8 directions. Patches are taken from a level of a pyramid at about its resolution.
    """
    side = regions.box[:, 2:] - regions.box[:, :2]
    middle, step = box_centers(regions.box), side * (AROUND / _SAMPLES)
    level = np.clip(np.log2(step).mean(axis=1).astype(np.int64), 0, _LEVELS - 1)
    cells = np.zeros((len(regions), _CELLS, _CELLS, _ANGLES), np.float32)
    image = grey
    for k in range(_LEVELS):
        rows = np.flatnonzero(level == k)
        if k > 0:
            half = [max(n // 2, 1) for n in image.shape[::-1]]
            image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), np.uint8)
        at = (middle + 0.5) / 2**k - 0.5
        _describe(image, rows, at, step / 2**k, _DIRECTIONS, _WEIGHTS, cells)
    found = cells.reshape(len(regions), _CELLS * _CELLS * _ANGLES)
    for most in (LARGEST_ENTRY, np.inf):
        found = np.minimum(
            found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-6), most
        )
    filled = regions.area_px / side.prod(axis=1)
    return np.column_stack([found, filled, regions.rgb / 255]).astype(np.float32)


@compiled
def _describe(
    image: NDArray[np.uint8],
    rows: NDArray[np.int64],
    middle: Array,
    step: Array,
    directions: NDArray[np.float32],
    weights: NDArray[np.float32],
    found: NDArray[np.float32],
) -> None:
    """Gradients (n, cells, cells, angles) of the patches of some rows: points (n, 2), steps (n, 2) between samples."""
    cells, samples = _CELLS, _SAMPLES
    patch = np.empty((samples + 2, samples + 2), np.float32)
    across, along = np.empty((cells, _ANGLES), np.float32), np.empty(_ANGLES, np.float32)
    for i in rows:
        _sample(image, middle[i, 0], middle[i, 1], step[i, 0], step[i, 1], patch)
        for a in range(samples):
            across[:] = 0
            for b in range(samples):
                right = patch[a + 1, b + 2] - patch[a + 1, b]
                down = patch[a + 2, b + 1] - patch[a, b + 1]
                for k in range(_ANGLES):
                    turned = right * directions[k, 0] + down * directions[k, 1]
                    along[k] = max(turned, np.float32(0))
                for c in range(cells):
                    if weights[c, b] > 0:
                        for k in range(_ANGLES):
                            across[c, k] += weights[c, b] * along[k]
            for r in range(cells):
                if weights[r, a] > 0:
                    for c in range(cells):
                        for k in range(_ANGLES):
                            found[i, r, c, k] += weights[r, a] * across[c, k]


@compiled
def _sample(
    image: NDArray[np.uint8],
    x: float,
    y: float,
    right: float,
    down: float,
    patch: NDArray[np.float32],
) -> None:
    """Bilinear samples around a point; beyond the image its edge goes on."""
    height, width = image.shape
    size = _SAMPLES + 2
    for a in range(size):
        v = min(max(y + (a - (size - 1) / 2) * down, 0.0), height - 1.0)
        top = min(np.int64(v), height - 2)
        t = np.float32(v - top)
        for b in range(size):
            u = min(max(x + (b - (size - 1) / 2) * right, 0.0), width - 1.0)
            left = min(np.int64(u), width - 2)
            s = np.float32(u - left)
            one, two = np.float32(image[top, left]), np.float32(image[top, left + 1])
            above = one + s * (two - one)
            one, two = np.float32(image[top + 1, left]), np.float32(image[top + 1, left + 1])
            below = one + s * (two - one)
            patch[a, b] = above + t * (below - above)


SIFT_VIEWS = 2
"""Nearest views that place a chain of descriptors, as in report chapter 7."""
MARGIN, MARGIN_PX = 0.1, 4.0
"""Around the box of a view, of its sides and px: points on the edge of a face have half of their pixels outside."""
FARTHEST = 0.39
"""Descriptors at a larger distance do not match."""
GROWTH = (0.9, 2.0)
"""Of the sides of a region from image to image: what stands does not shrink, and doubles 16 m away in a step of 8 m."""


def match_by_descriptors(
    posed: Iterator[PosedDetections], settings: TrackSettings
) -> Iterator[TrackedFrame]:
    """Chain candidates from frame to frame by their descriptors; the midpoint of the two nearest rays is its landmark.

    The confidence of a landmark and its facing are not known: score and facing are nan. Frames come out in order, each
    once, when no open chain holds them, at most `track.longest` used frames late; candidates that a chain had before
    that are left `unmatched`.
    """
    yield from through_window(posed, _Matcher(settings))


_Chain = tuple[tuple[WindowFrame, int], ...]
"""Views so far: (frame, followed candidate), oldest first."""


class _Matcher:
    """Open chains, and the frames that they hold."""

    def __init__(self, settings: TrackSettings) -> None:
        self._settings = settings
        self._path = TravelledPath(2 * settings.longest)
        self._window: list[WindowFrame] = []
        self._features: Features | None = None
        self._chains: dict[int, _Chain] = {}  # by followed candidate of the newest frame
        self._next_id = 0

    def holds(self, frame: WindowFrame) -> bool:
        """Whether a chain may still claim candidates of the frame."""
        return any(f is frame for f in self._window)

    def append(self, frame: WindowFrame, features: Features) -> None:
        """Take the next frame: chains go on or end."""
        going: dict[int, _Chain] = {}
        if self._features is not None:
            before, previous = self._window[-1], self._features
            a, b = match_regions((before, previous), (frame, features), self._settings.gap_px)
            frame.matches = np.concatenate([previous.sign_points[a], features.sign_points[b]], 1)
            olds, news = _followed(before, previous)[a], _followed(frame, features)[b]
            before.followed["paired"][olds, 1] = frame.followed["paired"][news, 0] = True
            for old, new in zip(olds.tolist(), news.tolist(), strict=True):
                chain = self._chains.pop(old, ((before, old),))
                going[new] = (*chain, (frame, new))[-self._settings.longest :]
        ended = list(self._chains.values())
        self._window.append(frame)
        self._path.append(frame.motion)
        self._end(ended)
        for held in self._window[-SIFT_VIEWS - 1 : -SIFT_VIEWS]:
            held.posed = _without_pixels(held.posed)
        self._chains, self._features = going, features
        self._let_go()

    def finish(self) -> None:
        """End all chains: no frame follows."""
        self._end(list(self._chains.values()))
        self._chains = {}
        self._window = []

    def _let_go(self) -> None:
        wanted = {id(f) for chain in self._chains.values() for f, _ in chain}
        wanted.add(id(self._window[-1]))
        while id(self._window[0]) not in wanted:
            del self._window[0]

    def _end(self, chains: list[_Chain]) -> None:
        if not chains:
            return
        candidates = candidates_of(self._window)
        at = {id(f): i for i, f in enumerate(self._window)}
        for chain in chains:
            if len(chain) < self._settings.fewest_views:
                continue
            frames = np.array([at[id(f)] for f, _ in chain])
            rows = candidates.first[frames] + np.array([row for _, row in chain])
            # the solver starts at the midpoint (eq. 7.4), and goes no further
            fit = fit_views(candidates, rows, frames, nearest=SIFT_VIEWS, iterations=0)
            if fit is not None:
                self._add_landmark(fit)

    def _add_landmark(self, fit: LandmarkFit) -> None:
        """Give a landmark to its frames; its points measure it, where a gate accepts it."""
        window = self._window
        landmark = build_landmark(
            fit,
            window,
            LandmarkMeasurement(fit.point, fit.covariance, box_panel(fit, window)),
            self._path.offset(fit.point),
            track_id=self._next_id,
            score=np.nan,
            verdict="sign",
        )
        views = fit.views_in(window)
        rays = np.array([held.followed["ray"][row] for held, row in views])
        landmark = replace(
            landmark,
            facing_deg=np.nan,
            sigma_facing_deg=np.nan,
            trajectory=trajectory_of(rays, [held.motion for held, _ in views]),
            crops=tuple(crop for view in views[-SIFT_VIEWS:] for crop in _crops(*view)),
        )
        window[fit.frames[0]].landmarks.append(landmark)
        for held, row in views:
            held.followed["assigned"][row] = True
        self._next_id += 1


def _crops(held: WindowFrame, row: int) -> Iterator[Crop]:
    """The pixels around a followed candidate, where the image has pixels."""
    if held.rgb is not None:
        x0, y0, x1, y1 = held.box(row).tolist()
        right, down = MARGIN * (x1 - x0) + MARGIN_PX, MARGIN * (y1 - y0) + MARGIN_PX
        x, y = max(0, int(x0 - right)), max(0, int(y0 - down))
        part = held.rgb[y : int(y1 + down), x : int(x1 + right)]
        grey = np.asarray(cv2.cvtColor(part, cv2.COLOR_RGB2GRAY), np.uint8)
        yield Crop(grey, np.array([x, y], np.float64), held.camera, held.motion)


def _without_pixels(posed: PosedDetections) -> PosedDetections:
    """The frame, of which the window keeps the candidates only."""
    found = posed.detections
    image = replace(found.image, rgb=None, grey=None, levels=None)
    segmentation = replace(found.segmentation, image=image)
    return replace(posed, detections=replace(found, segmentation=segmentation))


def _followed(frame: WindowFrame, features: Features) -> NDArray[np.int64]:
    """Number among the followed ones of each region that has a descriptor."""
    return np.searchsorted(frame.followed["candidate"], features.sign_rows)


def match_regions(
    first: tuple[WindowFrame, Features], second: tuple[WindowFrame, Features], gap_px: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Regions (k,) of one image and of the next that are each other's nearest.

    Only regions on each other's epipolar lines that grow as what stands does are compared. Lowe's ratio test would
    compare with other regions of the same thing; the distance itself decides.
    """
    (before, own), (frame, other) = first, second
    one, two = (f.followed[_followed(f, x)] for f, x in (first, second))
    start, end = before.motion.pose, frame.motion.pose
    moved = end.rotation.T @ (start.centre - end.centre)
    essential = cross_matrices(moved) @ end.rotation.T @ start.rotation
    lines = np.column_stack([one["ray"], np.ones(len(one))]) @ essential.T
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    nearest = np.full(len(one), -1)
    _match(
        lines,
        np.ascontiguousarray(one["size"]),
        own.sign_descriptors,
        np.ascontiguousarray(two["ray"]),
        np.ascontiguousarray(two["size"]),
        other.sign_descriptors,
        gap_px / frame.focal + GAP_SHARE * two["size"][:, 1],
        nearest,
    )
    matched = np.flatnonzero(nearest >= 0)
    return matched, nearest[matched]


@compiled
def _match(
    lines: Array,
    size: Array,
    described: NDArray[np.float32],
    other_ray: Array,
    other_size: Array,
    other_described: NDArray[np.float32],
    allowed: Array,
    nearest: NDArray[np.int64],
) -> None:
    n, m = lines.shape[0], other_ray.shape[0]
    gap, least, back = np.empty(m), np.full(m, np.inf), np.full(m, -1)
    for i in range(n):
        for j in range(m):
            x, y = other_ray[j, 0], other_ray[j, 1]
            gap[j] = abs(lines[i, 0] * x + lines[i, 1] * y + lines[i, 2])
        best = FARTHEST**2
        for j in range(m):
            if gap[j] > allowed[j]:
                continue
            wider, taller = other_size[j, 0] / size[i, 0], other_size[j, 1] / size[i, 1]
            if min(wider, taller) < GROWTH[0] or max(wider, taller) > GROWTH[1]:
                continue
            square, start = np.float32(0), described.shape[1]
            while start > 0 and square < FARTHEST**2:  # share and colour first
                start -= _STRIDE
                for k in range(start, start + _STRIDE):
                    square += (described[i, k] - other_described[j, k]) ** 2
            if square < best:
                best, nearest[i] = float(square), j
            if square < least[j]:
                least[j], back[j] = square, i
    for i in range(n):
        if nearest[i] >= 0 and back[nearest[i]] != i:
            nearest[i] = -1
