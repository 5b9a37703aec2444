"""What is kept of every frame until the drive has ended, and the path that results."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan

import numpy as np

from wayside.schemas.frame import Fix, Pose, PosePrior
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.stages.geometry import FrenetOffset, frenet_offsets
from wayside.stages.georeference.geodesy import Globe
from wayside.stages.georeference.trajectory import Trajectory
from wayside.stages.kernels import Array

FRAMES_BEFORE, FRAMES_AFTER = 3, 20
"""Used frames before the best one of a sign, and from it on, in which the camera may pass it."""


@dataclass(frozen=True, slots=True)
class PathPoint:
    """One used frame: pose by the chain of steps, the log's own pose and fix where given, numbers of the step to it.

    `covariance` (6, 6), `source`, `length_ratio`, `baseline_m` (None at the first) and the rest are as in `Motion`.
    """

    frame: int
    chained: Pose
    given: PosePrior | None
    fix: Fix | None
    time_ns: int = 0
    covariance: Array | None = field(default=None, repr=False)
    source: str = ""
    length_ratio: tuple[float, float] = (nan, nan)
    station_m: float = 0.0
    baseline_m: float | None = None
    camera_height_m: float = nan


@dataclass(slots=True)
class DriveRecord:
    """What the end of the drive needs: a point for each used frame, and the landmarks that are signs."""

    points: list[PathPoint] = field(default_factory=list)
    landmarks: list[Landmark] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class StepScale:
    """Final length of a step over that first taken for it; relative scatter of both, metres a metre."""

    factor: float = 1.0
    sigma: float = 0.0
    sigma_before: float = 0.0


@dataclass(frozen=True, slots=True)
class DrivePath:
    """The camera's path in its world frame, by used frame in the order of travel.

    `world`: "log" (that of the log's poses), "enu" (east, north, up at the first fix) or "drive_start". `stations`,
    `baselines`: final, metres. `given_stations` (n,): as first taken. `globe`: the path on WGS 84, where there are
    fixes. `scales`: of the steps whose length was first taken from fixes, points or the last speed. `notes`: faults of
    the poses and fixes, in words.
    """

    world: str
    poses: dict[int, Pose]
    stations: dict[int, float]
    baselines: dict[int, float | None]
    given_stations: Array
    camera_height_m: float | None
    globe: Globe | None
    scales: dict[int, StepScale]
    notes: tuple[str, ...]
    errors: Trajectory | Array | None = field(default=None, repr=False)
    """The adjustment of `poses`; of a chain that none adjusts, the standard deviation (n,) of each step's length."""

    @property
    def is_level(self) -> bool:
        """Whether up is known, and not only by the camera's own axes."""
        return self.world != "drive_start"

    def length_variance(self, first: int, last: int) -> float:
        """Variance, m^2, of the distance travelled between two of the `poses`: of the stretch between them alone.

        Lengths by points follow each other, so their errors add up; those of other steps are independent. A wrong scale
        of the whole log is not in it. nan where nothing is known of the errors.
        """
        if self.errors is None:
            return nan
        start, end = sorted((first, last))
        if isinstance(self.errors, Trajectory):
            return self.errors.length_variance(start, end, self.is_level)
        steps = slice(start + 1, end + 1)
        follows = np.array([frame in self.scales for frame in [*self.poses][steps]], bool)
        sigma = self.errors[steps]
        return float((sigma[~follows] ** 2).sum() + sigma[follows].sum() ** 2)

    def station_of(self, given_m: float) -> float:
        """Final station of a station as first taken. Before and past the ends, the path goes on."""
        if not self.scales:
            return given_m
        before, after = self.given_stations, np.array(list(self.stations.values()))
        inside = float(np.clip(given_m, before[0], before[-1]))
        return float(np.interp(inside, before, after)) + given_m - inside

    def offset_of(self, point: Array, frame: int) -> FrenetOffset | None:
        """Offset of a world point (3,) from the path near a frame; None where only the cameras know which way is up.

        With given poses up is the world's z: a camera rolled by half a degree puts a panel 8 m aside 7 cm off in
        height.
        """
        if self.world != "log":
            return None
        frames = sorted(self.poses)
        at = bisect_left(frames, frame)
        near = [self.poses[f] for f in frames[max(0, at - FRAMES_BEFORE) : at + FRAMES_AFTER]]
        centres = np.array([pose.centre for pose in near])
        ups = np.tile([0.0, 0.0, 1.0], (len(near), 1))
        along = centres, ups, np.zeros(len(near)), near[0].rotation[:, 2]
        return frenet_offsets(point[None], *along)[0]


def collect(tracked: Iterator[TrackedFrame], record: DriveRecord) -> Iterator[TrackedFrame]:
    """Pass every frame on and note in `record` what the end of the drive needs of it: no pixels, no candidates."""
    for item in tracked:
        frame, motion = item.frame, item.motion
        record.landmarks += [landmark for landmark in item.landmarks if landmark.verdict == "sign"]
        if motion is not None:
            point = PathPoint(
                frame.index,
                motion.pose,
                motion.given,
                frame.fix,
                frame.time_ns,
                motion.covariance,
                motion.source,
                motion.length_ratio,
                motion.station_m,
                None if motion.step is None else motion.baseline_m,
                motion.camera_height_m,
            )
            record.points.append(point)
        yield item


def drive_path(
    points: Sequence[PathPoint],
    world: str,
    poses: dict[int, Pose],
    globe: Globe | None = None,
    scales: dict[int, StepScale] | None = None,
    notes: tuple[str, ...] = (),
    errors: Trajectory | Array | None = None,
) -> DrivePath:
    """The path with the stations, baselines and camera height that its final lengths give."""
    scales = scales or {}
    stations: dict[int, float] = {}
    baselines: dict[int, float | None] = {}
    gained = 0.0
    for point in points:
        baseline, scale = point.baseline_m, scales.get(point.frame)
        if scale is not None and baseline is not None:
            scaled = baseline * scale.factor
            gained += scaled - baseline
            baseline = scaled
        stations[point.frame], baselines[point.frame] = point.station_m + gained, baseline
    heights = [p.camera_height_m for p in points if isfinite(p.camera_height_m)]
    factor = sum(one.factor for one in scales.values()) / len(scales) if scales else 1.0
    height = float(np.median(heights)) * factor if heights else None
    given = np.array([p.station_m for p in points])
    return DrivePath(world, poses, stations, baselines, given, height, globe, scales, notes, errors)
