"""The stage that lays the path on the world: the log's poses, the fixes' east-north-up, or the drive's own start.

World axes: x, y level, z up, metres. The chain of camera motions is exact between neighbours but drifts; poses and
fixes, which scatter but do not drift, bound it over the whole drive (`trajectory`). A world pose places one camera, and
everything near it is placed relative to that camera.
"""

from collections.abc import Iterator, Sequence
from math import nan, pi, radians

import numpy as np

from wayside.schemas.errors import InputError
from wayside.schemas.frame import Pose
from wayside.schemas.motion import ROUGH_LENGTHS
from wayside.schemas.settings import MotionSettings
from wayside.stages.georeference.geodesy import Globe, align_level, origin_of
from wayside.stages.georeference.measurements import AbsoluteMeasurements, RelativeMotionChain
from wayside.stages.georeference.notes import contradiction, notes_on, notes_on_spacing
from wayside.stages.georeference.path import DrivePath, PathPoint, StepScale, drive_path
from wayside.stages.georeference.placement import SCALE_STEPS
from wayside.stages.georeference.trajectory import Trajectory, smooth
from wayside.stages.kernels import Array
from wayside.stages.mapping import STEP_COVARIANCE
from wayside.stages.odometry import FIX_SIGMA_M

POSE_FLOORS = 1e-3, 1e-4
"""Smallest scatter of a pose of the log at the time of a frame, m, and of its rotation, rad (estimates)."""
WHITE_FRACTION = 0.1
"""Part of the stated scatter of a fix that is independent of the fix before (estimate)."""
WHITE_M = 0.02
"""Smallest independent scatter of a fix, that of carrier phase receivers."""
UP_FACTOR = 1.6
"""Scatter of heights over that of level positions, where the log does not say: usual satellite geometry."""
FIRST_TILT_DEG = 5.0
"""Scatter of pitch and roll of the first camera where only fixes are given (estimate)."""
WORLD_TILT_DEG = 0.5
"""Scatter of the tilt of the log's own world against the level of the globe (estimate)."""
ROLL_DEG = 10.0
"""Scatter of each camera's roll, that of its mount included, where only fixes are given (estimate)."""
POSES_DRIFT = 0.02, radians(0.002)
"""Drift of the log's poses against the globe after a metre, m, and of their rotation, rad (estimates); both grow with
the root of the distance."""
ODOMETRY_DRIFT = 0.1, radians(0.02)
"""The same of odometry (estimates)."""
HEADING_STEP_M = 1.0
"""Without poses and fixes, x of the world points along the first displacement longer than this."""


def georeference(points: Iterator[PathPoint], motion: MotionSettings) -> Iterator[DrivePath]:
    """Choose the world frame of a drive and give every used camera its pose in it: one path for all points.

    With poses in the log, theirs, smoothed by the steps between frames. With fixes only, east-north-up at the first
    fix, the chain of steps bounded by all fixes. Else `drive_start`: origin at the first used camera, x along the first
    step, y left, z the camera's own up.

    Raises InputError where fixes, the only source of lengths, contradict the motion in the images, and
    numpy.linalg.LinAlgError where the measurements do not determine the path.
    """
    path = list(points)
    if any(p.given is not None for p in path):
        yield _in_world_of_poses(path, _chain(path), motion)
        return
    poses, chain = _from_drive_start(path), _chain(path)
    if sum(p.fix is not None for p in path) < 2:
        in_order = {p.frame: q for p, q in zip(path, poses, strict=True)}
        scales, sigma = _scales_by_points(path, chain), chain.relative_length_sigma * chain.length
        notes = notes_on_spacing(path)
        yield drive_path(path, "drive_start", in_order, None, scales, notes, sigma)
        return
    tilt, roll = radians(FIRST_TILT_DEG), radians(ROLL_DEG)
    globe, notes = _on_globe(path, chain, _stacked(poses), tilt, roll, motion)
    if globe is None:
        raise InputError(
            f"{notes[0]}; it is unknown how far the camera moved: give the distance between images "
            "(--spacing 26.4ft)"
        )
    yield _smoothed_path(path, "enu", chain, globe.trajectory, globe, notes)


def _in_world_of_poses(
    path: Sequence[PathPoint], chain: RelativeMotionChain, motion: MotionSettings
) -> DrivePath:
    """The path in the world of the log's poses; on the globe by a second adjustment, since that world drifts."""
    measured = _measured_poses(path)
    inside = smooth(chain, measured, *_stacked(_follow_given(path)))
    notes = notes_on([p.frame for p in path], chain, measured, inside, "poses")
    globe = None
    if any(p.fix is not None for p in path):
        start, drifting = (inside.rotation, inside.centre), _drifting_chain(path, chain, inside)
        globe, more = _on_globe(path, drifting, start, radians(WORLD_TILT_DEG), np.inf, motion)
        notes += more
    return _smoothed_path(path, "log", chain, inside, globe, notes)


def _smoothed_path(
    path: Sequence[PathPoint],
    world: str,
    chain: RelativeMotionChain,
    found: Trajectory,
    globe: Globe | None,
    notes: tuple[str, ...],
) -> DrivePath:
    """The path of an adjustment; scales are of steps whose length was first taken from fixes, points or the speed."""
    poses = {p.frame: Pose(found.rotation[i], found.centre[i]) for i, p in enumerate(path)}
    sigma = np.sqrt(found.covariance[:, 6, 6])
    columns = np.stack([found.scale, sigma, chain.relative_length_sigma], axis=1).tolist()
    rows = zip(path, columns, strict=True)
    scales = {p.frame: StepScale(*row) for p, row in rows if p.source in ROUGH_LENGTHS}
    return drive_path(path, world, poses, globe, scales, notes, found)


def _stacked(poses: Sequence[Pose]) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and centres (n, 3)."""
    return np.stack([q.rotation for q in poses]), np.stack([q.centre for q in poses])


def _chain(path: Sequence[PathPoint]) -> RelativeMotionChain:
    """The steps as measured; lengths that came from fixes are unknowns, which these determine."""
    count = len(path)
    rotation, translation = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    covariance = np.tile(STEP_COVARIANCE, (count, 1, 1))
    for row in range(1, count):
        one = path[row].chained.relative_to(path[row - 1].chained)
        rotation[row], translation[row] = one.rotation, one.centre
        if (known := path[row].covariance) is not None and np.isfinite(known).all():
            covariance[row] = known
    free = np.array([p.source in ROUGH_LENGTHS for p in path])
    free[:1] = False
    ratio = np.array([p.length_ratio for p in path])
    return RelativeMotionChain(_times(path), rotation, translation, covariance, free, ratio)


def _drifting_chain(
    path: Sequence[PathPoint], chain: RelativeMotionChain, inside: Trajectory
) -> RelativeMotionChain:
    """Smoothed poses as steps whose sum drifts against the globe as the log's source does, in its gaps as the chain."""
    back = inside.rotation[:-1].transpose(0, 2, 1)
    rotation, translation = np.tile(np.eye(3), (len(path), 1, 1)), np.zeros((len(path), 3))
    rotation[1:] = back @ inside.rotation[1:]
    translation[1:] = np.einsum("nij,nj->ni", back, np.diff(inside.centre, axis=0))
    poses = next(p.given.source for p in path if p.given is not None) == "poses"
    drift_m, drift_rad = POSES_DRIFT if poses else ODOMETRY_DRIFT
    length = np.linalg.norm(translation, axis=1)
    covariance = length[:, None, None] * np.diag([drift_rad**2] * 3 + [drift_m**2] * 3)
    gap = np.array([p.given is None for p in path])
    gap[1:] |= gap[:-1]
    covariance[gap] += chain.covariance[gap]
    free, ratio = np.zeros(len(path), bool), np.full((len(path), 2), nan)
    return RelativeMotionChain(_times(path), rotation, translation, covariance, free, ratio)


def _times(path: Sequence[PathPoint]) -> Array:
    return np.array([(p.time_ns - path[0].time_ns) * 1e-9 for p in path])


def _measured_poses(path: Sequence[PathPoint]) -> AbsoluteMeasurements:
    given = [p.given for p in path if p.given is not None]
    sigma_m, sigma_rad = np.maximum([g.sigmas() for g in given], POSE_FLOORS).T
    rotation, position = _stacked([g.pose for g in given])
    return AbsoluteMeasurements(
        row=np.flatnonzero([p.given is not None for p in path]),
        position=position,
        sigma_m=np.tile(sigma_m[:, None], (1, 3)),
        correlated_sigma_m=np.zeros((len(path), 3)),
        rotation=rotation,
        sigma_rad=sigma_rad,
    )


def _on_globe(
    path: Sequence[PathPoint],
    chain: RelativeMotionChain,
    start: tuple[Array, Array],
    tilt_rad: float,
    roll_rad: float,
    motion: MotionSettings,
) -> tuple[Globe | None, tuple[str, ...]]:
    """The path in east, north, up, bounded by the fixes, and notes on these; None where the fixes contradict it.

    `start`: rotations and centres, level. `tilt_rad`, `roll_rad`: how level the first camera is, and all are.
    """
    fixes = [p.fix for p in path if p.fix is not None]
    rows = np.flatnonzero([p.fix is not None for p in path])
    origin = origin_of(fixes)
    position = origin.local(fixes)
    unknown = (FIX_SIGMA_M, FIX_SIGMA_M, UP_FACTOR * FIX_SIGMA_M)
    sigma = np.array([unknown if f.sigma_m is None else f.sigma_m for f in fixes])
    latest = np.maximum(np.searchsorted(rows, np.arange(len(path)), side="right") - 1, 0)
    lever_arm, (rotation, centre) = np.array(motion.antenna_m), start
    sagitta = _acceleration(chain.time_s, centre)[rows] * np.square([f.span_s for f in fixes]) / 8
    measured = AbsoluteMeasurements(
        row=rows,
        position=position,
        sigma_m=np.hypot(np.hypot(WHITE_FRACTION * sigma, WHITE_M), sagitta[:, None]),
        correlated_sigma_m=sigma[latest],
        lever_arm_m=lever_arm,
        first_sigma_rad=np.array([tilt_rad, tilt_rad, pi]),
        roll_sigma_rad=roll_rad,
    )
    heading, shift = align_level(centre[rows] + rotation[rows] @ lever_arm, position)
    found = smooth(chain, measured, heading @ rotation, centre @ heading.T + shift)
    frames = [p.frame for p in path]
    if reason := contradiction(chain, found):
        return None, (f"the fixes are left out, as they contradict the motion: {reason}",)
    notes = notes_on(frames, chain, measured, found, "fixes")
    return Globe(origin, {frame: row for row, frame in enumerate(frames)}, found), notes


def _acceleration(time_s: Array, centre: Array) -> Array:
    """Acceleration (n,), m/s^2: a chord over t seconds has the sagitta acceleration * t^2 / 8."""
    if len(centre) < 3:
        return np.zeros(len(centre))
    interval = np.maximum(np.diff(time_s), 1e-3)
    velocity = np.diff(centre, axis=0) / interval[:, None]
    change = 2 * np.diff(velocity, axis=0) / (interval[1:] + interval[:-1])[:, None]
    return np.pad(np.linalg.norm(change, axis=1), 1, mode="edge")


def _scales_by_points(
    path: Sequence[PathPoint], chain: RelativeMotionChain
) -> dict[int, StepScale]:
    """Scales of the steps whose length follows points, each from the one before.

    `SCALE_STEPS` of them have one error, which positions have in their covariance (`local_adjustment`), but sizes have
    not.
    """
    sigma = chain.relative_length_sigma
    return {
        p.frame: StepScale(1.0, float(sigma[row]), float(sigma[row]) * SCALE_STEPS**0.5)
        for row, p in enumerate(path)
        if p.source == "points"
    }


def _follow_given(path: Sequence[PathPoint]) -> list[Pose]:
    """Given poses; between them and before the first the chain, from the nearest given one before (or the first)."""
    anchor, pose = next((p.chained, p.given.pose) for p in path if p.given is not None)
    result = []
    for point in path:
        if point.given is not None:
            anchor, pose = point.chained, point.given.pose
        result.append(pose.compose(point.chained.relative_to(anchor)))
    return result


def _from_drive_start(path: Sequence[PathPoint]) -> list[Pose]:
    """The cameras in the frame `drive_start`; without a step, travel is along the optical axis."""
    if not path:
        return []
    first = path[0].chained
    steps = (first.to_camera(p.chained.centre) for p in path[1:])
    optical_axis = np.array([0.0, 0.0, 1.0])
    ahead = next((step for step in steps if np.linalg.norm(step) > HEADING_STEP_M), optical_axis)
    forward = ahead / np.linalg.norm(ahead)
    camera_up = np.array([0.0, -1.0, 0.0])
    up = camera_up - (camera_up @ forward) * forward
    up /= np.linalg.norm(up)
    axes = np.stack([forward, np.cross(up, forward), up])  # world axes in the first camera's frame
    rotation = axes @ first.rotation.T
    start = Pose(rotation, -rotation @ first.centre)
    return [start.compose(p.chained) for p in path]
