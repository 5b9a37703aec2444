"""The frames that tracking holds: their followed candidates as rays, and the path that was travelled."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import (
    LEARNED_COLORS,
    NONE,
    SHAPES,
    Candidates,
    box_centers,
    verdict_code,
)
from wayside.schemas.frame import Camera, Frame
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.measurement import Measurement
from wayside.schemas.motion import Motion, PosedDetections
from wayside.stages.detection import regions_of
from wayside.stages.geometry import (
    FrenetOffset,
    frenet_offsets,
    ideal_points,
    rays_of_ideal,
    to_rays,
)
from wayside.stages.kernels import Array, Bytes, Flags
from wayside.stages.mapping.association import WindowCandidates

WEAKEST_SCORE = -7.0
"""Log odds of the weakest refused candidate that may join a landmark that others propose."""
EDGE_PX = 2.0
"""A box nearer to the edge of the image than this is taken as cut."""
FOLLOWED = np.dtype(
    [
        ("image", np.int64),  # index of the frame in the log
        ("candidate", np.int64),  # row among the candidates of the image
        ("back", np.bool_),  # followed as the back of a panel; a row may be followed as a face, too
        ("seed", np.bool_),  # may form hypotheses
        ("predicted", np.bool_),  # a predicted view
        ("box", np.float64, 4),  # pixels
        ("ideal", np.float64, 2),  # centre, ideal pixels
        ("ray", np.float64, 2),  # the same in ideal image coordinates
        ("size", np.float64, 2),  # width and height in ideal image coordinates
        ("tall_px", np.float64),  # height in ideal pixels
        ("score", np.float64),  # log odds of what it is followed as
        ("color", np.float64, len(LEARNED_COLORS)),  # log probability of each, or nan
        ("shape", np.float64, len(SHAPES)),  # the same of each shape
        ("whole", np.bool_),  # does not touch the edge of the image
        ("assigned", np.bool_),  # belongs to a finished landmark
        ("paired", np.uint8, 2),  # whether it meets a candidate of an earlier, of a later frame
        ("standing", np.bool_),  # its landmark was in sight when the frame left the window
    ]
)
"""Columns of the followed candidates of a frame."""


@dataclass(slots=True)
class WindowFrame:
    """A frame in the window. What is known of its candidates changes until it leaves."""

    posed: PosedDetections
    """The frame as it came, with its image."""
    motion: Motion
    """Its motion."""
    camera: Camera
    """Its camera."""
    bounds: NDArray[np.float64]
    """See `image_bounds`, (4,)."""
    candidates: Candidates
    """All candidates of the image, n rows. The predicted ones come after them."""
    followed: NDArray[np.void]
    """Those that are followed, (k,), with the columns of `FOLLOWED`."""
    landmarks: list[Landmark] = field(default_factory=list)
    """Those seen first in this frame."""
    measurements: list[Measurement] = field(default_factory=list)
    """What the measurements of those landmarks rest on."""
    matches: NDArray[np.float32] | None = field(default=None, repr=False)
    """See `TrackedFrame`."""

    @classmethod
    def of(cls, posed: PosedDetections, motion: Motion, camera: Camera) -> "WindowFrame":
        """What tracking needs of a frame."""
        table = posed.detections.candidates
        faces, backs = face_rows(table), table.back_rows()
        score, behind = table.score[faces], table.back_score
        rows = np.concatenate([faces, backs])
        back = np.arange(len(rows)) >= len(faces)
        followed = followed_table(camera, table.regions.box[rows], table.ideal[rows], back)
        followed["image"], followed["candidate"] = posed.frame.index, rows
        followed["seed"] = back | (table.verdict[rows] != verdict_code("score"))
        score = score if behind is None else np.concatenate([score, behind[backs]])
        followed["score"] = np.where(np.isnan(score), 0.0, score)
        for name in ("color", "shape"):
            known = getattr(table, f"{name}_log_probability")
            if known is not None:
                followed[name] = known[rows]
        return cls(posed, motion, camera, image_bounds(camera), table, followed)

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.posed.frame

    @property
    def focal(self) -> float:
        """Focal length, pixels."""
        return (self.camera.fx + self.camera.fy) / 2

    @property
    def rgb(self) -> NDArray[np.uint8] | None:
        """The image, or None."""
        return self.posed.detections.image.rgb

    def add(self, box: NDArray[np.float32], scores: NDArray[np.float32], *, back: bool) -> range:
        """Follow predicted boxes (n, 4) with their scores (n,), too; their numbers among the followed candidates."""
        ideal = ideal_points(self.camera, box_centers(box))
        rows, before = followed_table(self.camera, box, ideal, back), len(self.followed)
        rows["predicted"], rows["score"] = True, scores
        first = len(self.candidates) + np.count_nonzero(self.followed["predicted"])
        rows["image"], rows["candidate"] = self.frame.index, first + np.arange(len(box))
        self.followed = joined([self.followed, rows])
        return range(before, len(self.followed))

    def all_candidates(self) -> Candidates:
        """The candidates of the image, then the predicted ones."""
        added = self.followed[self.followed["predicted"]]
        if self.rgb is None or not len(added):
            return self.candidates
        box, back = added["box"].astype(np.float32), added["back"]
        score = added["score"].astype(np.float32)
        more = Candidates.of(regions_of(box, np.full(len(box), NONE), self.rgb, "predicted"))
        score, behind = np.where(back, nan, score), np.where(back, score, nan)
        ideal = np.ascontiguousarray(added["ideal"])
        more = replace(more, ideal=ideal, score=score, back_score=behind)
        return Candidates.joined([self.candidates, more])

    def finished(self) -> TrackedFrame:
        """The frame; of candidates that no landmark has, the verdict says how far they went."""
        own = self.followed[~(self.followed["back"] | self.followed["assigned"])]
        candidates = self.all_candidates()
        verdict = candidates.verdict.copy()
        own = own[verdict[own["candidate"]] == verdict_code("open")]
        verdict[own["candidate"]] = unassigned_verdicts(own["paired"], own["standing"])
        return replace(
            untracked(self.posed, replace(candidates, verdict=verdict)),
            landmarks=tuple(self.landmarks),
            measurements=tuple(self.measurements),
            matches=self.matches,
        )


def untracked(posed: PosedDetections, candidates: Candidates) -> TrackedFrame:
    """A frame with these candidates, none of which belongs to a landmark."""
    found = posed.detections.segmentation
    return TrackedFrame(
        posed.frame,
        posed.motion,
        candidates,
        np.full(len(candidates), -1, np.int32),
        np.full(len(candidates), np.nan, np.float32),
        found.region_count,
        dropped=found.dropped,
    )


def face_rows(table: Candidates) -> NDArray[np.int64]:
    """Rows that are followed as faces, ascending: open ones, overlapped ones, and weak ones from a score on.

    Which of several overlapping boxes is the face shows only over several frames; and where near views place a sign,
    a weak far view may join it.
    """
    weak = (table.verdict == verdict_code("score")) & (table.score >= WEAKEST_SCORE)
    seen = (table.verdict == verdict_code("open")) | (table.verdict == verdict_code("overlap"))
    return np.flatnonzero(seen | weak)


def followed_table(
    camera: Camera, box: NDArray[np.float32], ideal: Array, back: NDArray[np.bool_] | bool
) -> NDArray[np.void]:
    """A table with the columns of `FOLLOWED`, those set that boxes (k, 4) with their centres, ideal pixels, give."""
    found = np.zeros(len(box), FOLLOWED)
    found["back"], found["box"], found["ideal"] = back, box, ideal
    found["ray"] = rays_of_ideal(camera, ideal)
    found["size"] = size = ideal_size(found["box"], camera)
    found["tall_px"] = size[:, 1] * ((camera.fx + camera.fy) / 2)
    found["color"] = found["shape"] = nan
    found["whole"] = is_whole(found["box"], camera)
    return found


def is_whole(box: Array, camera: Camera) -> NDArray[np.bool_]:
    """Which boxes (n, 4) do not touch the edge of the image."""
    far = np.array([camera.width, camera.height]) - EDGE_PX
    return np.asarray(((box[:, :2] >= EDGE_PX) & (box[:, 2:] <= far)).all(axis=1))


def joined(tables: Iterable[NDArray[np.void]]) -> NDArray[np.void]:
    """Tables with the columns of `FOLLOWED` as one: `np.concatenate` is slow, since it compares their columns."""
    return np.frombuffer(bytearray(b"".join(table.tobytes() for table in tables)), FOLLOWED)


def unassigned_verdicts(paired: NDArray[np.uint8 | np.bool_], standing: Flags) -> Bytes:
    """Verdicts (k,) of candidates that no landmark has, paired (k, 2) with an earlier and with a later candidate.

    `far_view` where it was standing (k,): a view of a landmark that was in sight still when the image left the window.
    Else `unmatched` with neither, `few_views` with one of both; with both it fits no standing point: `moving`.
    """
    by_pairs = np.take(
        [verdict_code(v) for v in ("unmatched", "few_views", "moving")], paired.sum(axis=1)
    )
    return np.asarray(np.where(standing, verdict_code("far_view"), by_pairs), np.uint8)


def ideal_size(box: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Width and height (n, 2) of distorted boxes (n, 4) as ideal image coordinates.

    Boxes are half open, so the face reaches from half a pixel before the first to half a pixel before the last number.
    """
    x0, y0, x1, y1 = (box - 0.5).T
    u, v = (x0 + x1) / 2, (y0 + y1) / 2
    ends = np.stack([x0, v, u, y0, x1, v, u, y1], axis=1).reshape(-1, 2)
    sides = to_rays(camera, ends).reshape(len(box), 2, 4)
    return np.asarray((sides[:, 1] - sides[:, 0])[:, [0, 3]])


def image_bounds(camera: Camera) -> NDArray[np.float64]:
    """Rays of the middle of the left, upper, right and lower edge: (4,) as x, y, x, y."""
    right, bottom = camera.width - 1.0, camera.height - 1.0
    edges = np.array([[0, camera.cy], [camera.cx, 0], [right, camera.cy], [camera.cx, bottom]])
    rays = to_rays(camera, edges)
    return np.array([rays[0, 0], rays[1, 1], rays[2, 0], rays[3, 1]])


class WindowPoses(NamedTuple):
    """Number (n,), rotation (n, 3, 3) and centre (n, 3) of the n images of a window."""

    number: NDArray[np.int64]
    rotation: NDArray[np.float64]
    centre: NDArray[np.float64]

    @classmethod
    def of(cls, window: Sequence[WindowFrame]) -> "WindowPoses":
        """Of these frames."""
        poses = [(f.frame.index, f.motion.pose.rotation, f.motion.pose.centre) for f in window]
        return cls._make(np.array(column) for column in zip(*poses, strict=True))


def candidates_of(window: Sequence[WindowFrame]) -> WindowCandidates:
    """Rays of all followed candidates of consecutive frames."""
    focal, bounds = np.array([f.focal for f in window]), np.stack([f.bounds for f in window])
    first = np.cumsum([0, *(len(f.followed) for f in window)], dtype=np.int64)
    poses = *WindowPoses.of(window)[1:], focal, bounds
    return WindowCandidates.of(poses, first, joined(f.followed for f in window))


class TravelledPath:
    """The last stretch of the chain of camera centres."""

    def __init__(self, longest: int) -> None:
        self._motions: deque[Motion] = deque(maxlen=longest)

    def append(self, motion: Motion) -> None:
        """Go one frame further."""
        self._motions.append(motion)

    def offsets(self, points: Sequence[NDArray[np.float64]]) -> list[FrenetOffset]:
        """Stations and offsets of points (3,) of the drive's frame."""
        stations = np.array([one.station_m for one in self._motions])
        rotations = np.array([one.pose.rotation for one in self._motions])
        along = np.array([one.pose.centre for one in self._motions]), -rotations[:, :, 1], stations
        return frenet_offsets(np.reshape(points, (-1, 3)), *along, rotations[-1, :, 2])
