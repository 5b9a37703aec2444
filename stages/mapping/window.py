"""The frames that a tracker holds: candidates as rays, the travelled path, and what became of each candidate."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Candidates, Features, Regions, verdict_code
from wayside.schemas.frame import Camera, Frame
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.motion import Motion, PosedDetections
from wayside.stages.geometry import (
    FrenetOffset,
    frenet_offset,
    ideal_points,
    rays_of_ideal,
    to_rays,
)
from wayside.stages.imaging import pyramid
from wayside.stages.mapping.association import Sightings

NO_TRACK = -1
WEAKEST = -7.0
"""Log odds of the weakest candidate that may join a place; it cannot propose one."""


@dataclass(slots=True)
class Held:
    """One frame in the window; candidates and what is known of them change until it is released.

    open (k,): candidate rows that are followed; back (k,): as the back of a panel (a row may be followed as its face,
    too); leads (k,): those that may propose a place; ray, size (k, 2): ideal image coordinates of centre and extent;
    score (k,): log odds of what they are followed as; whole (k,): the box does not touch the edge of the picture;
    taken (k,): belongs to a finished place; linked (k, 2): fits something in an earlier, in a later frame; verdict,
    track, residual: of all rows; rgb: the picture, None where it is gone; levels: it at full, half and quarter size,
    made when first asked for.
    """

    frame: Frame
    motion: Motion
    candidates: Candidates
    region_count: int
    rows: tuple[int, int]
    left_out: int
    open: NDArray[np.int64]
    back: NDArray[np.bool_]
    leads: NDArray[np.bool_]
    ray: NDArray[np.float64]
    size: NDArray[np.float64]
    score: NDArray[np.float64]
    whole: NDArray[np.bool_]
    bounds: NDArray[np.float64]
    focal: float
    taken: NDArray[np.bool_]
    linked: NDArray[np.bool_]
    verdict: NDArray[np.uint8]
    track: NDArray[np.int32]
    residual: NDArray[np.float32]
    places: list[Landmark]
    rgb: NDArray[np.uint8] | None = field(default=None, repr=False)
    levels: tuple[NDArray[np.uint8], ...] | None = field(default=None, repr=False)

    @classmethod
    def of(cls, moved: PosedDetections, motion: Motion, camera: Camera) -> Held:
        """Take what tracking needs of a frame."""
        detections = moved.detections
        table = detections.candidates
        faces, backs = followed_rows(table), table.back_rows()
        rows = np.concatenate([faces, backs])
        back = np.arange(len(rows)) >= len(faces)
        box = table.regions.box[rows].astype(np.float64)
        ray = rays_of_ideal(camera, table.ideal[rows])
        score = table.score[rows].astype(np.float64)
        if table.back_score is not None:
            score[back] = table.back_score[backs]
        edge = (box[:, :2] < 2).any(axis=1)
        edge |= (box[:, 2] > camera.width - 2) | (box[:, 3] > camera.height - 2)
        return cls(
            frame=detections.frame,
            motion=motion,
            candidates=table,
            region_count=detections.segmentation.region_count,
            rows=detections.segmentation.rows,
            left_out=detections.segmentation.left_out,
            open=rows,
            back=back,
            leads=back | (table.verdict[rows] != verdict_code("score")),
            ray=np.ascontiguousarray(ray),
            size=ideal_size(box, camera),
            score=np.nan_to_num(score),
            whole=~edge,
            bounds=picture_bounds(camera),
            focal=(camera.fx + camera.fy) / 2,
            taken=np.zeros(len(rows), np.bool_),
            linked=np.zeros((len(rows), 2), np.bool_),
            verdict=table.verdict.copy(),
            track=np.full(len(table), NO_TRACK, np.int32),
            residual=np.full(len(table), np.nan, np.float32),
            places=[],
            rgb=detections.image.rgb,
        )

    def picture_levels(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The picture at full, half and quarter size, None where it is gone."""
        if self.levels is None and self.rgb is not None:
            self.levels = pyramid(self.rgb)
        return self.levels

    def add(self, region: Regions, score: float, *, back: bool = False) -> int:
        """Take one more candidate, as if it had been followed from the start; its number among the followed ones."""
        camera = self.frame.camera
        if camera is None:
            raise ValueError(
                "wanted a frame with calibration, found none; such frames are not used"
            )
        one = Candidates.of(region)
        told = np.array([score], np.float32)
        one = replace(one, ideal=ideal_points(camera, one.center))
        one = replace(one, back_score=told) if back else replace(one, score=told)
        self.open = np.append(self.open, len(self.candidates))
        self.candidates = self.candidates.joined(one)
        self.back = np.append(self.back, back)
        self.leads = np.append(self.leads, False)
        self.ray = np.vstack([self.ray, rays_of_ideal(camera, one.ideal)])
        self.size = np.vstack([self.size, ideal_size(region.box.astype(np.float64), camera)])
        self.score = np.append(self.score, score)
        self.whole = np.append(self.whole, True)
        self.taken = np.append(self.taken, False)
        self.linked = np.vstack([self.linked, np.zeros((1, 2), np.bool_)])
        self.verdict = np.append(self.verdict, np.uint8(verdict_code("open")))
        self.track = np.append(self.track, np.int32(NO_TRACK))
        self.residual = np.append(self.residual, np.float32(np.nan))
        return len(self.open) - 1

    def claim(self, local: int, track: int, verdict: str, residual: float) -> None:
        """Give one followed candidate to a place; a row that is part of a sign stays that."""
        row = self.open[local]
        self.taken[local] = True
        if self.verdict[row] != verdict_code("sign"):
            self.track[row], self.residual[row] = track, residual
            self.verdict[row] = verdict_code(verdict)

    def settle(self) -> TrackedFrame:
        """The frame with every candidate decided.

        What no place took is `unmatched` where it fits nothing nearby, `moving` where it fits something before and
        something after but no one standing thing, and else `few_views`.
        """
        rows = self.open
        rest = ~self.back & (self.track[rows] == NO_TRACK)
        rest &= self.candidates.verdict[rows] == verdict_code("open")
        before, after = self.linked[:, 0], self.linked[:, 1]
        self.verdict[rows[rest]] = verdict_code("unmatched")
        self.verdict[rows[rest & (before | after)]] = verdict_code("few_views")
        self.verdict[rows[rest & before & after]] = verdict_code("moving")
        return TrackedFrame(
            self.frame,
            self.motion,
            replace(self.candidates, verdict=self.verdict),
            self.track,
            self.residual,
            self.region_count,
            self.rows,
            tuple(self.places),
            self.left_out,
        )


class Follower(Protocol):
    """Finds the views that belong together among the frames it holds."""

    def append(self, one: Held, features: Features) -> None:
        """Take the next frame."""

    def finish(self) -> None:
        """Nothing more comes: let go of everything."""

    def holds(self, one: Held) -> bool:
        """Whether the frame may still change."""


def through_window(moved: Iterator[PosedDetections], follower: Follower) -> Iterator[TrackedFrame]:
    """Send frames through a follower's window; each comes out once, in order, when it cannot change any more."""
    waiting: deque[PosedDetections | Held] = deque()
    for item in moved:
        camera = item.frame.camera
        if item.motion is None or camera is None:
            waiting.append(item)
        else:
            held = Held.of(item, item.motion, camera)
            waiting.append(held)
            follower.append(held, item.detections.features)
        yield from _released(waiting, follower)
    follower.finish()
    yield from _released(waiting, follower)


def _released(waiting: deque[PosedDetections | Held], follower: Follower) -> Iterator[TrackedFrame]:
    while waiting:
        first = waiting[0]
        if isinstance(first, Held):
            if follower.holds(first):
                return
            yield first.settle()
        else:
            yield settle_unused(first)
        waiting.popleft()


def followed_rows(table: Candidates) -> NDArray[np.int64]:
    """Rows worth following: open ones, those that gave way to a better box, and weak ones, ascending.

    Which of several overlapping boxes is the face shows only over several frames; and where near views place a sign,
    a weak far view may join it.
    """
    weak = (table.verdict == verdict_code("score")) & (table.score >= WEAKEST)
    return np.flatnonzero(
        (table.verdict == verdict_code("open")) | (table.verdict == verdict_code("overlap")) | weak
    )


def settle_unused(moved: PosedDetections) -> TrackedFrame:
    """A frame that takes no part, as it came."""
    table = moved.detections.candidates
    return TrackedFrame(
        moved.detections.frame,
        moved.motion,
        table,
        np.full(len(table), NO_TRACK, np.int32),
        np.full(len(table), np.nan, np.float32),
        moved.detections.segmentation.region_count,
        moved.detections.segmentation.rows,
        left_out=moved.detections.segmentation.left_out,
    )


def ideal_size(box: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Width and height (n, 2) of distorted boxes (n, 4) as ideal image coordinates.

    Boxes are half open, so the face reaches from half a pixel before the first to half a pixel before the last number.
    """
    x0, y0, x1, y1 = (box - 0.5).T
    u, v = (x0 + x1) / 2, (y0 + y1) / 2
    ends = np.concatenate([np.stack(pair, axis=1) for pair in ((x0, v), (x1, v), (u, y0), (u, y1))])
    left, right, top, bottom = to_rays(camera, ends).reshape(4, len(box), 2)
    return np.ascontiguousarray(np.stack([right[:, 0] - left[:, 0], bottom[:, 1] - top[:, 1]], 1))


def picture_bounds(camera: Camera) -> NDArray[np.float64]:
    """Rays of the middle of the left, upper, right and lower edge: (4,) as x, y, x, y."""
    right, bottom = camera.width - 1.0, camera.height - 1.0
    edges = np.array([[0, camera.cy], [camera.cx, 0], [right, camera.cy], [camera.cx, bottom]])
    rays = to_rays(camera, edges)
    return np.array([rays[0, 0], rays[1, 1], rays[2, 0], rays[3, 1]])


def sightings_of(held: Sequence[Held]) -> Sightings:
    """Rays of all followed candidates of a stretch of frames."""
    counts = [len(h.open) for h in held]
    return Sightings(
        rotation=np.stack([h.motion.pose.rotation for h in held]),
        centre=np.stack([h.motion.pose.centre for h in held]),
        focal=np.array([h.focal for h in held]),
        bounds=np.stack([h.bounds for h in held]),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        ray=np.concatenate([h.ray for h in held]),
        size=np.concatenate([h.size for h in held]),
        score=np.concatenate([h.score for h in held]),
        whole=np.concatenate([h.whole for h in held]),
        leads=np.concatenate([h.leads for h in held]),
    )


def first_rows(held: Sequence[Held]) -> NDArray[np.int64]:
    """Row of the window's sightings at which each frame's begin, (n + 1,)."""
    return np.concatenate([[0], np.cumsum([len(h.open) for h in held])]).astype(np.int64)


def frames_of(rows: NDArray[np.int64], held: Sequence[Held]) -> NDArray[np.int64]:
    """Frame in the window of each sighting."""
    return np.asarray(np.searchsorted(first_rows(held), rows, side="right") - 1, np.int64)


def local_rows(
    rows: NDArray[np.int64], frames: NDArray[np.int64], held: Sequence[Held]
) -> NDArray[np.int64]:
    """Sightings as rows among the followed candidates of their own frames."""
    return np.asarray(rows - first_rows(held)[frames], np.int64)


class TravelledPath:
    """The last stretch of the chain of camera centres."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._points: list[tuple[NDArray[np.float64], NDArray[np.float64], float]] = []
        self._ahead = np.array([0.0, 0.0, 1.0])

    def append(self, motion: Motion) -> None:
        """Go one frame further."""
        pose = motion.pose
        self._points.append((pose.centre, -pose.rotation[:, 1], motion.station_m))
        self._ahead = pose.rotation[:, 2]
        del self._points[: -self._longest]

    def beside(self, point: NDArray[np.float64]) -> FrenetOffset:
        """Station and offset of a point of the drive's frame."""
        centres, ups, stations = (np.array(column) for column in zip(*self._points, strict=True))
        return frenet_offset(point, centres, ups, stations, self._ahead)
