"""The frames that tracking holds: their followed candidates as rays, the travelled path, what became of each row."""

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
from wayside.schemas.measurement import Measurement
from wayside.schemas.motion import Motion, PosedDetections
from wayside.stages.geometry import (
    FrenetOffset,
    frenet_offset,
    ideal_points,
    rays_of_ideal,
    to_rays,
)
from wayside.stages.imaging import pyramid
from wayside.stages.mapping.association import WindowCandidates
from wayside.stages.mapping.verdicts import unassigned_verdicts

WEAKEST_SCORE = -7.0
"""Log odds of the weakest refused candidate that may join a landmark that others propose."""
EDGE_PX = 2.0
"""A box nearer to the edge of the image than this is taken as cut."""
NO_TRACK = -1


@dataclass(slots=True)
class WindowFrame:
    """A frame in the window, k followed candidates. What is known of them changes until it leaves."""

    plain: TrackedFrame
    """The frame as it came."""
    frame: Frame
    """The frame."""
    camera: Camera
    """Its camera."""
    motion: Motion
    """Its motion."""
    candidates: Candidates
    """All its candidates, n rows."""
    followed: NDArray[np.int64]
    """Rows of the followed candidates, (k,)."""
    back: NDArray[np.bool_]
    """Whether it is followed as the back of a panel, (k,). A row may be followed as a face, too."""
    seeds: NDArray[np.bool_]
    """Whether it may form hypotheses, (k,)."""
    ray: NDArray[np.float64]
    """Ideal image coordinates of the centre, (k, 2)."""
    size: NDArray[np.float64]
    """Width and height in ideal image coordinates, (k, 2)."""
    score: NDArray[np.float64]
    """Log odds of what it is followed as, (k,)."""
    whole: NDArray[np.bool_]
    """Whether the box does not touch the edge of the image, (k,)."""
    bounds: NDArray[np.float64]
    """See `image_bounds`, (4,)."""
    focal: float
    """Focal length, pixels."""
    assigned: NDArray[np.bool_]
    """Whether it belongs to a finished landmark, (k,)."""
    paired: NDArray[np.bool_]
    """Whether it meets a candidate of an earlier, of a later frame, (k, 2)."""
    standing: NDArray[np.bool_]
    """Whether its landmark was still in sight when the frame left the window, (k,)."""
    verdict: NDArray[np.uint8]
    """Index into `VERDICTS`, (n,)."""
    track_id: NDArray[np.int32]
    """Landmark that each belongs to, (n,). -1: none."""
    residual_px: NDArray[np.float32]
    """Distance of each to its reprojected landmark, (n,). nan: none."""
    landmarks: list[Landmark]
    """Those seen first in this frame."""
    measurements: list[Measurement]
    """What the measurements of those landmarks rest on."""
    rgb: NDArray[np.uint8] | None = field(default=None, repr=False)
    """The image. None: there is none."""
    matches: NDArray[np.float32] | None = field(default=None, repr=False)
    """See `TrackedFrame`."""
    _pyramid: tuple[NDArray[np.uint8], ...] | None = field(default=None, repr=False)

    @classmethod
    def of(cls, posed: PosedDetections, motion: Motion, camera: Camera) -> WindowFrame:
        """What tracking needs of a frame."""
        detections = posed.detections
        table = detections.candidates
        faces, backs = followed_rows(table, WEAKEST_SCORE), table.back_rows()
        rows = np.concatenate([faces, backs])
        back = np.arange(len(rows)) >= len(faces)
        box = table.regions.box[rows].astype(np.float64)
        score = table.score[rows].astype(np.float64)
        if table.back_score is not None:
            score[back] = table.back_score[backs]
        cut = (box[:, :2] < EDGE_PX).any(axis=1)
        cut |= (box[:, 2] > camera.width - EDGE_PX) | (box[:, 3] > camera.height - EDGE_PX)
        return cls(
            plain=untracked(posed),
            frame=detections.frame,
            camera=camera,
            motion=motion,
            candidates=table,
            followed=rows,
            back=back,
            seeds=back | (table.verdict[rows] != verdict_code("score")),
            ray=np.ascontiguousarray(rays_of_ideal(camera, table.ideal[rows])),
            size=ideal_size(box, camera),
            score=np.nan_to_num(score),
            whole=~cut,
            bounds=image_bounds(camera),
            focal=(camera.fx + camera.fy) / 2,
            assigned=np.zeros(len(rows), np.bool_),
            paired=np.zeros((len(rows), 2), np.bool_),
            standing=np.zeros(len(rows), np.bool_),
            verdict=table.verdict.copy(),
            track_id=np.full(len(table), NO_TRACK, np.int32),
            residual_px=np.full(len(table), np.nan, np.float32),
            landmarks=[],
            measurements=[],
            rgb=detections.image.rgb,
            _pyramid=detections.image.levels,
        )

    def image_pyramid(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The image at full, half and quarter size, made when first requested, or None."""
        if self._pyramid is None and self.rgb is not None:
            self._pyramid = pyramid(self.rgb)
        return self._pyramid

    def add(self, region: Regions, score: float, *, back: bool = False) -> int:
        """Take one more candidate, as if it had been followed from the start; its number among the followed ones."""
        camera, one = self.camera, Candidates.of(region)
        known = np.array([score], np.float32)
        one = replace(one, ideal=ideal_points(camera, one.center))
        one = replace(one, back_score=known) if back else replace(one, score=known)
        self.followed = np.append(self.followed, len(self.candidates))
        self.candidates = self.candidates.joined(one)
        self.back = np.append(self.back, back)
        self.seeds = np.append(self.seeds, False)
        self.ray = np.vstack([self.ray, rays_of_ideal(camera, one.ideal)])
        self.size = np.vstack([self.size, ideal_size(region.box.astype(np.float64), camera)])
        self.score = np.append(self.score, score)
        self.whole = np.append(self.whole, True)
        self.assigned = np.append(self.assigned, False)
        self.paired = np.vstack([self.paired, np.zeros((1, 2), np.bool_)])
        self.standing = np.append(self.standing, False)
        self.verdict = np.append(self.verdict, np.uint8(verdict_code("open")))
        self.track_id = np.append(self.track_id, np.int32(NO_TRACK))
        self.residual_px = np.append(self.residual_px, np.float32(np.nan))
        return len(self.followed) - 1

    def assign(self, row: int, track_id: int, verdict: str, residual_px: float) -> None:
        """Give a followed candidate to a landmark; a candidate of a sign stays one."""
        own = self.followed[row]
        self.assigned[row] = True
        if self.verdict[own] != verdict_code("sign"):
            self.track_id[own], self.residual_px[own] = track_id, residual_px
            self.verdict[own] = verdict_code(verdict)

    def finished(self) -> TrackedFrame:
        """The frame with every candidate decided."""
        rest = ~self.back & (self.track_id[self.followed] == NO_TRACK)
        rest &= self.candidates.verdict[self.followed] == verdict_code("open")
        self.verdict[self.followed[rest]] = unassigned_verdicts(
            self.paired[rest], self.standing[rest]
        )
        return replace(
            self.plain,
            candidates=replace(self.candidates, verdict=self.verdict),
            track_id=self.track_id,
            residual_px=self.residual_px,
            landmarks=tuple(self.landmarks),
            measurements=tuple(self.measurements),
            matches=self.matches,
        )


class WindowTracker(Protocol):
    """Associates the candidates of the frames that it holds."""

    def append(self, frame: WindowFrame, features: Features) -> None:
        """Take the next frame."""

    def finish(self) -> None:
        """End all tracks: no frame follows."""

    def holds(self, frame: WindowFrame) -> bool:
        """Whether the frame may still change."""


def through_window(
    posed: Iterator[PosedDetections], tracker: WindowTracker
) -> Iterator[TrackedFrame]:
    """Send frames through a tracker; each comes out once, in order, when it cannot change any more."""
    waiting: deque[PosedDetections | WindowFrame] = deque()
    for item in posed:
        camera = item.frame.camera
        if item.motion is None or camera is None:
            waiting.append(item)
        else:
            frame = WindowFrame.of(item, item.motion, camera)
            waiting.append(frame)
            tracker.append(frame, item.detections.features)
        yield from _released(waiting, tracker)
    tracker.finish()
    yield from _released(waiting, tracker)


def _released(
    waiting: deque[PosedDetections | WindowFrame], tracker: WindowTracker
) -> Iterator[TrackedFrame]:
    while waiting:
        first = waiting[0]
        if isinstance(first, WindowFrame):
            if tracker.holds(first):
                return
            yield first.finished()
        else:
            yield untracked(first)
        waiting.popleft()


def untracked(posed: PosedDetections) -> TrackedFrame:
    """A frame that takes no part, as it came."""
    detections = posed.detections
    table = detections.candidates
    return TrackedFrame(
        detections.frame,
        posed.motion,
        table,
        np.full(len(table), NO_TRACK, np.int32),
        np.full(len(table), np.nan, np.float32),
        detections.segmentation.region_count,
        dropped=detections.segmentation.dropped,
    )


def followed_rows(table: Candidates, weakest: float) -> NDArray[np.int64]:
    """Rows that are followed as faces, ascending: open ones, overlapped ones, and weak ones from a score on.

    Which of several overlapping boxes is the face shows only over several frames; and where near views place a sign,
    a weak far view may join it.
    """
    weak = (table.verdict == verdict_code("score")) & (table.score >= weakest)
    return np.flatnonzero(
        (table.verdict == verdict_code("open")) | (table.verdict == verdict_code("overlap")) | weak
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


def image_bounds(camera: Camera) -> NDArray[np.float64]:
    """Rays of the middle of the left, upper, right and lower edge: (4,) as x, y, x, y."""
    right, bottom = camera.width - 1.0, camera.height - 1.0
    edges = np.array([[0, camera.cy], [camera.cx, 0], [right, camera.cy], [camera.cx, bottom]])
    rays = to_rays(camera, edges)
    return np.array([rays[0, 0], rays[1, 1], rays[2, 0], rays[3, 1]])


def candidates_of(window: Sequence[WindowFrame]) -> WindowCandidates:
    """Rays of all followed candidates of consecutive frames."""
    counts = [len(f.followed) for f in window]
    return WindowCandidates(
        rotation=np.stack([f.motion.pose.rotation for f in window]),
        centre=np.stack([f.motion.pose.centre for f in window]),
        focal=np.array([f.focal for f in window]),
        bounds=np.stack([f.bounds for f in window]),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        ray=np.concatenate([f.ray for f in window]),
        size=np.concatenate([f.size for f in window]),
        score=np.concatenate([f.score for f in window]),
        whole=np.concatenate([f.whole for f in window]),
        seeds=np.concatenate([f.seeds for f in window]),
    )


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

    def offset(self, point: NDArray[np.float64]) -> FrenetOffset:
        """Station and offset of a point (3,) of the drive's frame."""
        centres, ups, stations = (np.array(column) for column in zip(*self._points, strict=True))
        return frenet_offset(point, centres, ups, stations, self._ahead)
