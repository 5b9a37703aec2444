"""The report's matching: SIFT points on the candidates, the midpoint of two rays (chapters 5 and 7)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Detections, Features
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping import (
    GAP_SHARE,
    LandmarkFit,
    TravelledPath,
    WindowFrame,
    build_landmark,
    candidates_of,
    fit_views,
    measure_landmark,
    through_window,
)
from wayside.stages.report.trajectory import trajectory_of

MARGIN_PX = 3
"""Points so far outside the box of a candidate belong to it: a face's own corners lie on its border."""


def extract_sift(images: Iterator[Detections]) -> Iterator[Detections]:
    """Find SIFT points on the open candidates of each image; other key points stay as they are.

    Each point belongs to one candidate only, the smallest whose box contains it. Regions of both passes overlap the
    same face, and a point listed twice would fail the ratio test against itself.
    """
    sift, none = cv2.SIFT.create(), Features.empty()
    for item in images:
        if item.image.grey is None:
            yield item
            continue
        rows = item.candidates.open_rows()
        found, described = sift.detectAndCompute(item.image.grey, None) if len(rows) else ((), None)
        points, descriptors, owner = none.sign_points, none.sign_descriptors, none.sign_rows
        if described is not None:
            points = np.asarray(cv2.KeyPoint.convert(found), np.float32).reshape(-1, 2)
            number = _smallest_around(points, item.candidates.regions.box[rows])
            kept = number >= 0
            points, descriptors = points[kept], np.asarray(described, np.float32)[kept]
            owner = rows[number[kept]].astype(np.int32)
        features = replace(
            item.features, sign_points=points, sign_descriptors=descriptors, sign_rows=owner
        )
        yield replace(item, features=features)


def _smallest_around(points: NDArray[np.float32], box: NDArray[np.float32]) -> NDArray[np.int64]:
    """Number (m,) of the smallest box (n, 4) that contains each point with a margin, the first of equals; -1: none."""
    low, high = box[:, :2] - MARGIN_PX, box[:, 2:] - 1 + MARGIN_PX
    owner = np.full(len(points), -1)
    # the largest box first: smaller ones overwrite it
    for k in np.argsort((box[:, 2:] - box[:, :2]).prod(axis=1), kind="stable")[::-1]:
        owner[((points >= low[k]) & (points <= high[k])).all(axis=1)] = k
    return owner


SIFT_VIEWS = 2
"""Nearest views that place a chain of descriptors, as in report chapter 7."""
RATIO = 0.8
"""Largest distance to the nearest descriptor over that to the second nearest (Lowe 2004)."""


def match_by_descriptors(
    posed: Iterator[PosedDetections], settings: TrackSettings
) -> Iterator[TrackedFrame]:
    """Chain candidates from frame to frame by their key points; the midpoint of the two nearest rays is its landmark.

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
            pairs = match_points(previous.sign_descriptors, features.sign_descriptors, RATIO)
            ends = previous.sign_points[pairs[:, 0]], features.sign_points[pairs[:, 1]]
            frame.matches = np.concatenate(ends, axis=1)
            local_before, local_now = _faces(before), _faces(frame)
            for a, b in vote_regions(pairs, previous.sign_rows, features.sign_rows):
                old, new = local_before.get(int(a)), local_now.get(int(b))
                if old is None or new is None:
                    continue
                chain = self._chains.pop(old, ((before, old),))
                before.followed["paired"][old, 1] = frame.followed["paired"][new, 0] = True
                going[new] = (*chain, (frame, new))[-self._settings.longest :]
        ended = list(self._chains.values())
        self._window.append(frame)
        self._path.append(frame.motion)
        self._end(ended)
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
        """Measure a landmark and give it to its frames; `residual` where eq. 7.5 says that its rays do not meet.

        e is the sum of the squared distances, in pixels, of the point's projections to the views.
        """
        window = self._window
        tall_px = fit.metric[1] / fit.depth.min() * window[fit.frames[-1]].focal
        allowed_px = self._settings.gap_px + GAP_SHARE * tall_px
        e = float((fit.residual_px[fit.used] ** 2).sum())
        verdict = "sign" if e < fit.used.sum() * allowed_px**2 else "residual"
        landmark = build_landmark(
            fit,
            window,
            measure_landmark(fit, window),
            self._path.offset(fit.point),
            track_id=self._next_id,
            score=np.nan,
            verdict=verdict,
        )
        views = fit.views_in(window)
        rays = np.array([held.followed["ray"][row] for held, row in views])
        landmark = replace(
            landmark,
            facing_deg=np.nan,
            sigma_facing_deg=np.nan,
            trajectory=trajectory_of(rays, [held.motion for held, _ in views]),
        )
        window[fit.frames[0]].landmarks.append(landmark)
        for held, row in views:
            held.followed["assigned"][row] = True
        self._next_id += 1


def _faces(frame: WindowFrame) -> dict[int, int]:
    """Number among the followed ones of each row that is followed as a face."""
    return {int(one["candidate"]): i for i, one in enumerate(frame.followed) if not one["back"]}


def match_points(
    first: NDArray[np.float32], second: NDArray[np.float32], ratio: float
) -> NDArray[np.int64]:
    """Pairs (k, 2) of descriptors, (n, d) and (m, d), that are each other's nearest and pass Lowe's ratio test."""
    if len(first) < 1 or len(second) < 2:
        return np.zeros((0, 2), np.int64)
    squares = (first**2).sum(axis=1)[:, None] + (second**2).sum(axis=1)[None]
    distance = np.maximum(squares - 2 * first @ second.T, 0)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(first))
    least = distance[rows, nearest]
    back = distance.argmin(axis=0)
    distance[rows, nearest] = np.inf
    clear = least < ratio**2 * distance.min(axis=1)
    good = clear & (back[nearest] == rows)
    return np.stack([rows[good], nearest[good]], axis=1)


def vote_regions(
    pairs: NDArray[np.int64], first_region: NDArray[np.int32], second_region: NDArray[np.int32]
) -> NDArray[np.int64]:
    """Pairs of regions (k, 2) for which most of both regions' matched points vote, by second region ascending.

    `pairs` (n, 2): matched points; the others: region of each point of either image.
    """
    if len(pairs) == 0:
        return np.zeros((0, 2), np.int64)
    a, b = first_region[pairs[:, 0]], second_region[pairs[:, 1]]
    voted, votes = np.unique(np.stack([a, b], axis=1), axis=0, return_counts=True)
    chosen = []
    for region in np.unique(voted[:, 1]):
        mine = np.flatnonzero(voted[:, 1] == region)
        best = mine[np.argmax(votes[mine])]
        rival = np.flatnonzero(voted[:, 0] == voted[best, 0])
        if rival[np.argmax(votes[rival])] == best:
            chosen.append(voted[best])
    return np.array(chosen, np.int64).reshape(-1, 2)
