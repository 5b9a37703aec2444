"""Which world the results stand in: the log's poses, the fixes' east-north-up, or the drive's own start.

World axes: x, y level, z up, metres. The chain of camera motions is exact between neighbours but drifts; poses and
fixes, which scatter but do not drift, hold it in place over the whole drive (`numerics.trajectory`). A world pose
places one camera, and everything near it is placed relative to that camera.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import nan, radians

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.earth import Earth, align_level, origin_of
from wayside.pipeline.path_notes import notes_on
from wayside.schemas.frame import Fix, Pose, PosePrior
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.settings import LandmarkSettings
from wayside.stages.geometry import FrenetOffset, frenet_offset
from wayside.stages.georeference import Chain, Seen, Trajectory, smooth
from wayside.stages.kernels import Array
from wayside.stages.odometry import FIX_SIGMA_M, POSE_SIGMA_M, POSE_SIGMA_RAD

BEFORE, AFTER = 3, 20
"""Used frames around the best view of a sign among which the camera passes it."""
FIX_MEMORY_S, FIX_NEW_SHARE, FIX_NEW_M, FIX_UP = 60.0, 0.1, 0.02, 1.6
"""The error of fixes fades over minutes (atmosphere, orbits, reflections); this share of it is new with each fix, at
least so much. Heights err by this factor more, where the log does not say."""
DRIFT = {"poses": (0.02, radians(0.002)), "odometry": (0.1, radians(0.02))}
"""How far the log's own poses may drift against the earth: metres and radians after a metre, growing with its root."""
LEAST_M, LEAST_RAD = 1e-3, 1e-4
"""No pose is surer than that at the moment of a picture, whatever the log says."""
CHAIN_TILT, POSES_TILT, LEVEL, ANY_TURN = radians(5.0), radians(0.5), radians(10.0), radians(180.0)
"""How level cameras are at first, and worlds of given poses; each camera again, the mount's own roll in it; unknown."""


@dataclass(frozen=True, slots=True)
class PathPoint:
    """What one used frame knows of its place: chained pose, the log's own pose and fix where given.

    covariance (6, 6), source, ratio: of the step to it, as in `Motion`.
    """

    frame: int
    chained: Pose
    given: PosePrior | None
    fix: Fix | None
    time_ns: int = 0
    covariance: Array | None = field(default=None, repr=False)
    source: str = ""
    ratio: tuple[float, float] = (nan, nan)

    @classmethod
    def of(cls, settled: TrackedFrame) -> PathPoint | None:
        """What a frame knows; None where it is not used."""
        frame, motion = settled.frame, settled.motion
        if motion is None:
            return None
        return cls(
            frame.index,
            motion.pose,
            frame.pose,
            frame.fix,
            frame.time_ns,
            motion.covariance,
            motion.source,
            motion.length_ratio,
        )


@dataclass(frozen=True, slots=True)
class Length:
    """A step's length over the one first taken for it, and the relative scatter of both, metres per metre."""

    stretch: float
    sigma: float
    sigma_before: float


@dataclass(frozen=True, slots=True)
class World:
    """World poses of the used frames by index; `earth` knows their places on WGS 84 where fixes exist.

    lengths: of the steps to frames whose length was first taken from fixes; notes: what was found wrong with poses and
    fixes, in words.
    """

    name: str  # "log", "enu" or "drive_start"
    poses: dict[int, Pose]
    earth: Earth | None
    lengths: dict[int, Length] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def stretch(self) -> float:
        """Mean of all lengths over those first taken."""
        every = self.lengths.values()
        return sum(one.stretch for one in every) / len(every) if every else 1.0


def beside_in_world(
    world: World, frames: Sequence[int], frame: int, point: NDArray[np.float64]
) -> FrenetOffset | None:
    """Offset of a point (3,) from the path near a frame, by the world's own up; None where only cameras know up.

    A camera rolled by half a degree puts a panel 8 m aside 7 cm too high or low; given poses know better.

    Parameters
    ----------
    frames
        All frames that have a pose in the world, ascending.
    """
    if world.name != "log":
        return None
    at = bisect_left(frames, frame)
    near = [world.poses[f] for f in frames[max(0, at - BEFORE) : at + AFTER]]
    centres = np.array([pose.centre for pose in near])
    ups = np.tile([0.0, 0.0, 1.0], (len(near), 1))
    return frenet_offset(point, centres, ups, np.zeros(len(near)), near[0].rotation[:, 2])


def place_in_world(
    path: Sequence[PathPoint], antenna_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> World:
    """Choose the world frame of a drive and give every used camera its pose in it.

    With poses in the log, theirs, smoothed by the steps between the pictures. With fixes only, east-north-up at the
    first fix, the chain of steps held by all fixes. Else `drive_start`: origin at the first used camera, x along the
    first step, y left, z the camera's own up.

    Parameters
    ----------
    antenna_m
        Where the fixes' antenna is: right, down, ahead of the camera.
    """
    if not path:
        return World("drive_start", {}, None)
    rows = {p.frame: row for row, p in enumerate(path)}
    if any(p.given is not None for p in path):
        chain = _chain(path)
        seen, start = _poses_seen(path), _follow_given(path)
        inside = smooth(chain, seen, *_stacked(start))
        notes = notes_on(list(rows), chain, seen, inside, "poses")
        earth = None
        if any(p.fix is not None for p in path):
            rough = inside.rotation, inside.centre
            drifting = _drifting_chain(path, chain, inside)
            earth, told = _hold_by_fixes(path, drifting, rough, antenna_m, POSES_TILT, np.inf)
            notes += told
        return World("log", _poses(rows, inside), earth, _lengths(path, chain, inside), notes)
    origin = _drive_start(path)
    poses = [origin.compose(p.chained) for p in path]
    if sum(p.fix is not None for p in path) < 2:
        return World("drive_start", {p.frame: q for p, q in zip(path, poses, strict=True)}, None)
    chain = _chain(path)
    earth, notes = _hold_by_fixes(path, chain, _stacked(poses), antenna_m, CHAIN_TILT, LEVEL)
    lengths = _lengths(path, chain, earth.path)
    return World("enu", _poses(rows, earth.path), earth, lengths, notes)


def _poses(rows: dict[int, int], path: Trajectory) -> dict[int, Pose]:
    return {frame: Pose(path.rotation[row], path.centre[row]) for frame, row in rows.items()}


def _stacked(poses: Sequence[Pose]) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and centres (n, 3)."""
    return np.stack([q.rotation for q in poses]), np.stack([q.centre for q in poses])


def _chain(path: Sequence[PathPoint]) -> Chain:
    """The steps as measured; lengths that came from fixes are left to these."""
    count = len(path)
    rotation, step = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    covariance = np.tile(np.diag(np.square(LandmarkSettings().step_sigma)), (count, 1, 1))
    for row in range(1, count):
        one = path[row].chained.relative_to(path[row - 1].chained)
        rotation[row], step[row] = one.rotation, one.centre
        known = path[row].covariance
        if known is not None and np.isfinite(known).all():
            covariance[row] = known
    free = np.array([p.source == "fixes" for p in path])
    free[0] = False
    return Chain(_times(path), rotation, step, covariance, free, np.array([p.ratio for p in path]))


def _drifting_chain(path: Sequence[PathPoint], chain: Chain, inside: Trajectory) -> Chain:
    """Smoothed poses as steps whose sum drifts against the earth as the log's source does, in its gaps as the chain."""
    back = inside.rotation[:-1].transpose(0, 2, 1)
    rotation, step = np.tile(np.eye(3), (len(path), 1, 1)), np.zeros((len(path), 3))
    rotation[1:] = back @ inside.rotation[1:]
    step[1:] = np.einsum("nij,nj->ni", back, np.diff(inside.centre, axis=0))
    source = next(p.given.source for p in path if p.given is not None)
    metres, turn = DRIFT.get(source, DRIFT["odometry"])
    length = np.linalg.norm(step, axis=1)
    covariance = length[:, None, None] * np.diag([turn**2] * 3 + [metres**2] * 3)
    lone = np.array([p.given is None for p in path])
    lone[1:] |= lone[:-1]
    covariance[lone] += chain.covariance[lone]
    free, ratio = np.zeros(len(path), bool), np.full((len(path), 2), nan)
    return Chain(_times(path), rotation, step, covariance, free, ratio)


def _times(path: Sequence[PathPoint]) -> Array:
    return np.array([(p.time_ns - path[0].time_ns) * 1e-9 for p in path])


def _poses_seen(path: Sequence[PathPoint]) -> Seen:
    """The log's own poses."""
    given = [(row, p.given) for row, p in enumerate(path) if p.given is not None]
    sigma = np.array([max(_or(g.sigma_m, POSE_SIGMA_M), LEAST_M) for _, g in given])
    return Seen(
        np.array([row for row, _ in given]),
        np.stack([g.pose.centre for _, g in given]),
        np.tile(sigma[:, None], (1, 3)),
        np.zeros((len(path), 3)),
        FIX_MEMORY_S,
        np.zeros(3),
        np.stack([g.pose.rotation for _, g in given]),
        np.array([max(_or(g.sigma_rad, POSE_SIGMA_RAD), LEAST_RAD) for _, g in given]),
        np.full(3, ANY_TURN),
        np.inf,
    )


def _hold_by_fixes(
    path: Sequence[PathPoint],
    chain: Chain,
    start: tuple[Array, Array],
    antenna_m: tuple[float, float, float],
    tilt: float,
    level: float,
) -> tuple[Earth, tuple[str, ...]]:
    """Steps held by the fixes, in east, north, up, and notes on these; start: rotations and centres, level."""
    fixed = [(row, p.fix) for row, p in enumerate(path) if p.fix is not None]
    rows = np.array([row for row, _ in fixed])
    fixes = [fix for _, fix in fixed]
    origin = origin_of(fixes)
    place = origin.local(fixes)
    unknown = (FIX_SIGMA_M, FIX_SIGMA_M, FIX_UP * FIX_SIGMA_M)
    sigma = np.array([unknown if f.sigma_m is None else f.sigma_m for f in fixes])
    latest = np.maximum(np.searchsorted(rows, np.arange(len(path)), side="right") - 1, 0)
    arm = np.array(antenna_m)
    rotation, centre = start
    bow = _bow(chain.time_s, centre)[rows] * np.array([f.span_s for f in fixes]) ** 2 / 8
    seen = Seen(
        rows,
        place,
        np.hypot(np.hypot(FIX_NEW_SHARE * sigma, FIX_NEW_M), bow[:, None]),
        sigma[latest],
        FIX_MEMORY_S,
        arm,
        None,
        None,
        np.array([tilt, tilt, ANY_TURN]),
        level,
    )
    turn, shift = align_level(centre[rows] + rotation[rows] @ arm, place)
    found = smooth(chain, seen, turn @ rotation, centre @ turn.T + shift)
    frames = {p.frame: row for row, p in enumerate(path)}
    notes = notes_on(list(frames), chain, seen, found, "fixes")
    return Earth(origin, frames, found), notes


def _bow(time_s: Array, centre: Array) -> Array:
    """Acceleration (n,), m/s^2: a line between two fixes cuts the bow by an eighth of it times the time squared."""
    if len(centre) < 3:
        return np.zeros(len(centre))
    gap = np.maximum(np.diff(time_s), 1e-3)
    speed = np.diff(centre, axis=0) / gap[:, None]
    change = 2 * np.diff(speed, axis=0) / (gap[1:] + gap[:-1])[:, None]
    return np.pad(np.linalg.norm(change, axis=1), 1, mode="edge")


def _lengths(path: Sequence[PathPoint], chain: Chain, found: Trajectory) -> dict[int, Length]:
    """What became of lengths that were first taken from fixes."""
    ahead = chain.step / chain.length[:, None]
    before = np.einsum("ni,nij,nj->n", ahead, chain.covariance[:, 3:, 3:], ahead)
    relative = np.sqrt(before) / chain.length
    sigma = np.sqrt(found.covariance[:, 6, 6])
    return {
        p.frame: Length(float(found.stretch[row]), float(sigma[row]), float(relative[row]))
        for row, p in enumerate(path)
        if p.source == "fixes"
    }


def _follow_given(path: Sequence[PathPoint]) -> list[Pose]:
    """Given poses; before the first and between them the chain, hung on the nearest given one before (or the first)."""
    anchor = next(p for p in path if p.given is not None)
    result = []
    for point in path:
        if point.given is not None:
            anchor = point
        if anchor.given is None:  # narrows the type: every anchor has a pose
            continue
        result.append(anchor.given.pose.compose(point.chained.relative_to(anchor.chained)))
    return result


def _drive_start(path: Sequence[PathPoint]) -> Pose:
    """The first camera in the frame `drive_start`; without a step, travel is along the optical axis."""
    first = path[0].chained
    ahead = next(
        (step for p in path[1:] if np.linalg.norm(step := first.to_camera(p.chained.centre)) > 1.0),
        np.array([0.0, 0.0, 1.0]),
    )
    forward = ahead / np.linalg.norm(ahead)
    camera_up = np.array([0.0, -1.0, 0.0])
    up = camera_up - (camera_up @ forward) * forward
    up /= np.linalg.norm(up)
    axes = np.stack(
        [forward, np.cross(up, forward), up]
    )  # rows: world axes in the first camera's frame
    turn = axes @ first.rotation.T
    return Pose(turn, -turn @ first.centre)


def _or(value: float | None, default: float) -> float:
    return default if value is None or not value > 0 else value
