"""The report's matching: a SIFT descriptor of each region, points on which several rays meet (chapters 5 and 7)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from wayside.schemas.detections import Detections, Regions, box_centers
from wayside.schemas.landmarks import Crop, TrackedFrame
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import TrackSettings
from wayside.stages.geometry import cross_matrices
from wayside.stages.kernels import Array, Bytes, Flags, Floats, Numbers, compiled, compiled_within
from wayside.stages.mapping import (
    BOX_SIGMA,
    GAP_SHARE,
    LandmarkFit,
    LandmarkMeasurement,
    SideClassifiers,
    WindowFrame,
    WindowSolver,
    box_panel,
)

AROUND = 1.5
"""Sides of what is described, in sides of the region's box: the face and the edge around it."""
LARGEST_ENTRY = 0.2
"""No entry of a normalised descriptor is larger (Lowe 2004)."""
_LEVELS, _CELLS, _WIDE, _ANGLES, _STRIDE = 4, 4, 4, 8, 12
_SAMPLES = _CELLS * _WIDE
_turn = np.arange(_ANGLES) * (2 * np.pi / _ANGLES)
_DIRECTIONS = np.stack([np.cos(_turn), np.sin(_turn)]).astype(np.float32)
_TENT = (1 - abs(np.arange(2 * _WIDE) + 0.5 - _WIDE) / _WIDE).astype(np.float32)


def extract_sift(images: Iterator[Detections]) -> Iterator[Detections]:
    """Describe the open candidates of each image; other key points stay as they are.

    The regions themselves are the key points. SIFT's own detector would cost fifty times as much, and most of its
    points lie off the candidates or on their edges.
    """
    for item in images:
        grey, candidates = item.image.grey, item.candidates
        if grey is not None:
            found = describe_regions(grey, candidates.regions.select(candidates.open_rows()))
            item = replace(item, features=replace(item.features, sign_descriptors=found))
        yield item


def describe_regions(grey: Bytes, regions: Regions) -> Floats:
    """Descriptor (n, 132) of each region: SIFT, the share of its box that it fills, and its mean colour, 0 to 1.

    SIFT of an upright patch as large as the box and its surroundings (Lowe 2004; of regions, Mikolajczyk et al. 2005):
    4 x 4 cells of gradients in 8 directions. Patches are taken from a level of a pyramid at about its resolution.
    """
    side = regions.box[:, 2:] - regions.box[:, :2]
    middle, step = box_centers(regions.box), side * (AROUND / _SAMPLES)
    level = np.clip(np.log2(step).mean(axis=1).astype(np.int64), 0, _LEVELS - 1)
    below = (middle + _SAMPLES * step)[:, 1].max(initial=0.0)
    image = grey[: int(below) // 2**_LEVELS * 2**_LEVELS + 2**_LEVELS]
    cells = np.zeros((len(regions), _CELLS, _CELLS, _ANGLES), np.float32)
    for k in range(_LEVELS):
        rows = np.flatnonzero(level == k)
        if k > 0:
            half = [max(n // 2, 1) for n in image.shape[::-1]]
            image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), np.uint8)
        at = (middle + 0.5) / 2**k - 0.5
        _describe(image, rows, at, step / 2**k, cells)
    found = cells.reshape(len(regions), _CELLS * _CELLS * _ANGLES)
    for most in (LARGEST_ENTRY, np.inf):
        found = np.minimum(
            found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-6), most
        )
    filled = regions.area_px / side.prod(axis=1)
    return np.column_stack([found, filled, regions.rgb / 255]).astype(np.float32)


@compiled
def _describe(image: Bytes, rows: Numbers, middle: Array, step: Array, found: Floats) -> None:
    """Gradients (n, cells, cells, angles) of the patches of some rows: points (n, 2), steps (n, 2) between samples.

    A sample counts in the two cells around it, less with its distance from their middles: `_TENT`.
    """
    patch = np.empty((_SAMPLES + 2, _SAMPLES + 2), np.float32)
    along = np.zeros((_SAMPLES + _WIDE, _ANGLES), np.float32)  # from half a cell before the first
    across = np.empty((_CELLS, _ANGLES), np.float32)
    for i in rows:
        _sample(image, middle[i, 0], middle[i, 1], step[i, 0], step[i, 1], patch)
        for a in range(_SAMPLES):
            for b in range(_SAMPLES):
                right = patch[a + 1, b + 2] - patch[a + 1, b]
                down = patch[a + 2, b + 1] - patch[a, b + 1]
                for k in range(_ANGLES):
                    turned = right * _DIRECTIONS[0, k] + down * _DIRECTIONS[1, k]
                    along[b + _WIDE // 2, k] = max(turned, np.float32(0))
            for c in range(_CELLS):
                for k in range(_ANGLES):
                    total = np.float32(0)
                    for b in range(2 * _WIDE):
                        total += _TENT[b] * along[_WIDE * c + b, k]
                    across[c, k] = total
            for r in range(_CELLS):
                b = a + _WIDE // 2 - _WIDE * r
                for c in range(_CELLS if 0 <= b < 2 * _WIDE else 0):
                    for k in range(_ANGLES):
                        found[i, r, c, k] += _TENT[b] * across[c, k]


@compiled_within
def _sample(image: Bytes, x: float, y: float, right: float, down: float, patch: Floats) -> None:
    """Bilinear samples around a point; beyond the image its edge goes on."""
    height, width = image.shape
    size = _SAMPLES + 2
    left, share = np.empty(size, np.uint64), np.empty(size, np.float32)
    for b in range(size):
        u = min(max(x + (b - (size - 1) / 2) * right, 0.0), width - 1.0)
        left[b] = min(np.int64(u), width - 2)
        share[b] = u - left[b]
    for a in range(size):
        v = min(max(y + (a - (size - 1) / 2) * down, 0.0), height - 1.0)
        top = min(np.int64(v), height - 2)
        t, upper, lower = np.float32(v - top), image[top], image[top + 1]
        for b in range(size):
            s, here, after = share[b], left[b], left[b] + np.uint64(1)
            one, two = np.float32(upper[here]), np.float32(upper[after])
            above = one + s * (two - one)
            one, two = np.float32(lower[here]), np.float32(lower[after])
            below = one + s * (two - one)
            patch[a, b] = above + t * (below - above)


CROPPED_VIEWS = 2
"""Nearest views whose SIFT points place a landmark, as in report chapter 7."""
MARGIN, MARGIN_PX = 0.1, 4.0
"""Around the box of a view, of its sides and px: points on the edge of a face have half of their pixels outside."""
FARTHEST = 0.9
"""Descriptors of one region in two images are nearer, nine of ten pairs on faces of learning drives."""
REACH = 1
"""Frames between the two segments of a hypothesis: panels are seen in neighbouring images."""
APPEARANCE, VIEWS = 0.4, 1.4
"""Weights of evidence for a sign, those of place and size being 1: of the mean likelihood ratio of its colour, and of
the logarithm of the number of views (logistic regression on four learning drives)."""


def match_segments(
    posed: Iterator[PosedDetections], settings: TrackSettings
) -> Iterator[TrackedFrame]:
    """Find the points that stand and that segments of several images show at the place and in the size they must have.

    Any two segments whose rays meet and that look alike make a hypothesis (eqs. 7.1 to 7.4); see `WindowSolver`. The
    confidence of a landmark and its facing are not known: score and facing are nan.
    """
    yield from _Matcher(settings, {False: SideClassifiers()}, BOX_SIGMA, REACH).run(posed)


class _Matcher(WindowSolver):
    """All landmarks that fit are handed on: what they are, the gates decide."""

    grey = True

    def append(self, frame: WindowFrame) -> None:
        frame.matches = np.zeros((0, 4), np.float32)
        super().append(frame)

    def _likely(self, recent: Sequence[WindowFrame]) -> Numbers:
        """Segments on each other's epipolar lines with like descriptors."""
        older, newer = recent
        moved = older.motion.pose.relative_to(newer.motion.pose)
        essential = cross_matrices(moved.centre) @ moved.rotation
        rays = older.followed["ray"]
        lines = np.column_stack([rays, np.ones(len(rays))]) @ essential.T
        lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
        gap = self.settings.gap_px / newer.focal + GAP_SHARE * newer.followed["size"][:, 1]
        one, two = (f.posed.detections.features.sign_descriptors for f in (older, newer))
        alike = np.zeros((len(one), len(two)), np.bool_)
        _compare(lines, np.ascontiguousarray(newer.followed["ray"]), gap, one, two, alike)
        return np.asarray(np.argwhere(alike) + np.array([0, len(one)]))

    def _settle(self, passed: list[LandmarkFit], ahead: list[LandmarkFit]) -> None:
        """Give landmarks to their frames; SIFT points measure those that a gate accepts."""
        for fit, offset in zip(passed, self._path.offsets([f.point for f in passed]), strict=True):
            measured = LandmarkMeasurement(fit.point, fit.covariance, box_panel(fit))
            views = [(self._window[k], row) for k, row in zip(fit.frames, fit.rows, strict=True)]
            look, many = APPEARANCE * fit.seen["score"].mean(), VIEWS * np.log(len(views))
            self._report(
                fit,
                measured,
                offset=offset,
                score=np.nan,
                verdict="sign",
                evidence=(("appearance", float(look)), ("views", float(many))),
                trace=(fit.seen["ray"].copy(), tuple(held.motion.pose for held, _ in views)),
                crops=tuple(crop for view in views[-CROPPED_VIEWS:] for crop in _crops(*view)),
            )
            centres = box_centers(fit.seen["box"]).astype(np.float32)
            for k in np.flatnonzero(np.diff(fit.frames) == 1).tolist():
                held, link = views[k + 1][0], centres[k : k + 2].reshape(1, 4)
                held.matches = np.concatenate([held.matches, link])


def _crops(held: WindowFrame, row: int) -> Iterator[Crop]:
    """The pixels around a followed candidate, where the image has pixels."""
    image = held.posed.detections.image.grey
    if image is not None:
        x0, y0, x1, y1 = held.followed["box"][row].tolist()
        right, down = MARGIN * (x1 - x0) + MARGIN_PX, MARGIN * (y1 - y0) + MARGIN_PX
        x, y = max(0, int(x0 - right)), max(0, int(y0 - down))
        part = image[y : int(y1 + down), x : int(x1 + right)].copy()
        yield Crop(part, np.array([x, y], np.float64), held.camera, held.motion)


@compiled
def _compare(
    lines: Array, ray: Array, allowed: Array, own: Floats, other: Floats, alike: Flags
) -> None:
    """Which of m regions are near the line of each of n regions, and described like it: (n, m)."""
    for i in range(alike.shape[0]):
        for j in range(alike.shape[1]):
            gap = lines[i, 0] * ray[j, 0] + lines[i, 1] * ray[j, 1] + lines[i, 2]
            if abs(gap) > allowed[j]:
                continue
            square, start = np.float32(0), own.shape[1]
            while start > 0 and square < FARTHEST**2:  # share and colour first
                start -= _STRIDE
                for k in range(start, start + _STRIDE):
                    square += (own[i, k] - other[j, k]) ** 2
            alike[i, j] = square < FARTHEST**2
