"""Where and when the images of a drive are taken.

Camera frame: x right, y down, z forward. World: x east, y north, z up, metres.
"""

from dataclasses import dataclass

import numpy as np

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Floats
from recordings.drives.spec import DriveSpec


@dataclass(frozen=True, slots=True)
class TimedPose:
    """One image: when and from where it was taken."""

    index: int
    trigger: int
    time_ns: int  # header time
    station_m: float
    offset_m: float  # of the vehicle, right of the centre line
    travelled_m: float
    after_dropped: bool
    position: Floats  # (3,), world
    rotation: Floats  # (3, 3), world from camera

    def quaternion(self) -> Floats:
        """World-from-camera rotation as x, y, z, w."""
        return quaternion_from_matrix(self.rotation)

    def to_camera(self, points: Floats) -> Floats:
        """World points (..., 3) in the camera frame."""
        return (points - self.position) @ self.rotation


def quaternion_from_matrix(r: Floats) -> Floats:
    """Unit quaternion x, y, z, w (w >= 0) of a rotation matrix, by the eigenvector of Bar-Itzhack (2000)."""
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    values, vectors = np.linalg.eigh(k, UPLO="L")
    q = vectors[:, np.argmax(values)]
    return q if q[3] >= 0 else -q


def mount_rotation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Floats:
    """Vehicle-from-camera rotation; yaw right, pitch up, roll clockwise positive."""
    a, b, c = np.radians([yaw_deg, pitch_deg, roll_deg])
    yaw = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    pitch = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    roll = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    turn: Floats = yaw @ pitch @ roll
    return turn


def _drift(rng: np.random.Generator, count: int, sigma: float, memory: float) -> Floats:
    """Stationary first-order noise of standard deviation sigma."""
    values = np.empty(count)
    value = rng.normal(0.0, sigma)
    for i in range(count):
        values[i] = value
        value = memory * value + rng.normal(0.0, sigma * np.sqrt(1 - memory * memory))
    return values


@dataclass(frozen=True, slots=True)
class _Motion:
    """What differs from trigger to trigger, each (triggers,)."""

    pitch_deg: Floats
    roll_deg: Floats
    yaw_deg: Floats
    height_m: Floats
    wander_m: Floats
    speed_mps: Floats
    step_m: Floats


def _motion(spec: DriveSpec, triggers: int) -> _Motion:
    """Jitter of the mount, drift in the lane, speed and distance of every trigger."""
    rng = np.random.default_rng([spec.seed, 1])
    camera, path = spec.camera, spec.path
    pitch = _drift(rng, triggers, camera.jitter_pitch_deg, 0.6)
    roll = _drift(rng, triggers, camera.jitter_roll_deg, 0.7)
    yaw = _drift(rng, triggers, camera.jitter_yaw_deg, 0.8)
    height = _drift(rng, triggers, camera.jitter_height_m, 0.4)
    wander = _drift(rng, triggers, path.wander_m, 0.97)
    speed = path.speed_mps * (1 + _drift(rng, triggers, 0.03, 0.95))
    step = path.spacing_m + rng.normal(0.0, path.trigger_sigma_m, triggers)
    return _Motion(pitch, roll, yaw, height, wander - wander[0], speed, step)


def drive_poses(spec: DriveSpec, road: RoadAlignment) -> list[TimedPose]:
    """True poses of all images of a drive, in order."""
    triggers = spec.frames + len(spec.path.dropped)
    motion, camera = _motion(spec, triggers), spec.camera
    mount = mount_rotation(camera.mount_yaw_deg, camera.mount_pitch_deg, camera.mount_roll_deg)
    poses: list[TimedPose] = []
    station, travelled, time_s = 0.0, 0.0, 0.0
    after_dropped = False
    for trigger in range(triggers):
        offset = road.travel_offset_m + motion.wander_m[trigger]
        if trigger > 0:
            step = motion.step_m[trigger]
            curvature = float(road.at(road.curvature, station))
            station += step / (1.0 - curvature * offset)
            travelled += step
            time_s += step / motion.speed_mps[trigger]
        if trigger in spec.path.dropped:
            after_dropped = True
            continue
        forward, right, up = road.axes(station)
        vehicle = np.column_stack([right, -up, forward])
        jitter = mount_rotation(
            motion.yaw_deg[trigger], motion.pitch_deg[trigger], motion.roll_deg[trigger]
        )
        height = camera.mount_height_m + motion.height_m[trigger]
        poses.append(
            TimedPose(
                index=len(poses),
                trigger=trigger,
                time_ns=spec.log.start_ns + round(time_s * 1e9),
                station_m=station,
                offset_m=offset,
                travelled_m=travelled,
                after_dropped=after_dropped,
                position=road.surface(station, offset) + up * height,
                rotation=vehicle @ jitter @ mount,
            )
        )
        after_dropped = False
    return poses
