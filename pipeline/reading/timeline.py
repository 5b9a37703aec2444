"""What is known of each image of a log before any is processed: its time, calibration, pose and fix."""

from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from wayside.pipeline.reading.agreement import (
    MotionStream,
    believed_motion,
    image_steps,
    looks_aside,
)
from wayside.pipeline.reading.clocks import Integers, StreamTimes, clock_set_at, pair_times
from wayside.pipeline.reading.messages import Kind
from wayside.pipeline.reading.plan import Plan, shortened
from wayside.pipeline.reading.series import (
    Interpolated,
    Samples,
    Series,
    composed,
    continuous_longitudes,
    fixed,
    interpolate,
    metres,
    mount_of,
    path_of,
    possible,
)
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera, Fix, Pose, PosePrior
from wayside.stages.geometry import turn_deg
from wayside.stages.odometry import AXES, CameraPath

_STANDS = 0.02
"""Poses that stand still have no scale: the images contradict them."""
_SCALE_REACH_M, _FEWEST_SCALES, _SCALE_FACTOR = 40.0, 3, 1.6
"""Lengths of so many metres by fixes tell a scale that no receiver is off by: that of feet, or an arbitrary one."""
_STANDING = Pose(next(iter(AXES.values())), np.zeros(3))
"""Camera on a vehicle (x forward, y left, z up; ROS REP 103 and 105) whose mount the log does not state."""


@dataclass(slots=True)
class Timeline:
    """Images by their rows in the survey's index."""

    order: Integers
    """Rows by capture time."""
    times: StreamTimes
    cameras: list[Camera | None]
    """Calibration in force at each image."""
    motion: MotionStream | None = None
    """Poses that are used; None: no poses are used."""
    fixes: Interpolated | None = None
    notes: list[str] = field(default_factory=list)

    def pose(self, row: int) -> PosePrior | None:
        """The camera's pose at an image, None where the log does not tell."""
        motion = self.motion
        if motion is None or not motion.path.known[row]:
            return None
        sigma_m, sigma_rad = (None if np.isnan(s) else float(s) for s in motion.sigma[row, :2])
        pose = Pose(motion.path.rotation[row], motion.path.centre[row])
        source = "odometry" if motion.source == "odometry" else "poses"
        return PosePrior(pose, sigma_m, sigma_rad, source)

    def fix(self, row: int) -> Fix | None:
        """The satellite fix at an image, or None."""
        if self.fixes is None or not self.fixes.known[row]:
            return None
        latitude, longitude, altitude = self.fixes.value[row, :3].tolist()
        east, north, up = self.fixes.value[row, 7:].tolist()
        sigma = None if np.isnan(east) else (east, north, up)
        span_s = float(self.fixes.span_s[row])
        return Fix(latitude, turn_deg(0.0, longitude), altitude, sigma, span_s)


def make_timeline(plan: Plan) -> Timeline:
    """Time all images, and find their calibrations, poses and fixes.

    Raises InputError where the clocks of the images contradict each other, or nothing believable tells the motion.
    """
    times = plan.survey.images[plan.camera.name].times()
    if not (times.has_header or times.has_log):
        raise InputError(
            f"{plan.survey.path}: the order of the images of {shortened(plan.camera.name)} is not known. Their times "
            "go back and overlap, as after a clock was set. Cut the log there and run each part."
        )
    if row := clock_set_at(times.capture_ns):
        raise InputError(
            f"{plan.survey.path}: the clock was set back during the recording, or its parts are in the wrong order. "
            f"Image {row} of {shortened(plan.camera.name)} is {_seconds(int(np.diff(times.capture_ns)[row - 1]))} "
            "earlier than the one before it. Cut the log there and run each part, or sort it by time (mcap sort)."
        )
    order = np.argsort(times.capture_ns, kind="stable")
    timeline = Timeline(order, times, _cameras(plan, times))
    if times.off:
        timeline.notes.append(_off_words(times, plan.camera.name))
    timeline.fixes = _fixes(plan, timeline)
    streams = [one for one in _motion_streams(plan, timeline) if one.path.known.any()]
    streams = [one for one in streams if _has_scale(one, timeline)]
    if streams:
        found = image_steps(plan, order, times.capture_ns, timeline.cameras)
        motion, steps, notes = believed_motion(streams, found, order, times.capture_ns)
        if looks_aside(steps):
            raise InputError(
                f"{plan.survey.path}: the camera {shortened(plan.camera.name)} looks sideways; signs are found "
                "with a camera that looks ahead: choose another with --camera"
            )
        timeline.motion = motion
        timeline.notes += notes
    if timeline.motion is None and timeline.fixes is None and not plan.spacing_m:
        raise InputError(
            f"{plan.survey.path}: it is unknown how far the camera moved: {'; '.join(timeline.notes)}; "
            "give the distance between images, as in --spacing 26.4ft"
        )
    return timeline


def _has_scale(stream: MotionStream, timeline: Timeline) -> bool:
    """Whether poses and fixes agree on lengths, where both cover a part that is long enough to tell."""
    if timeline.fixes is None:
        return True
    rows = timeline.order[(stream.path.known & timeline.fixes.known)[timeline.order]]
    if not len(rows):
        return True
    fixes = metres(timeline.fixes.value[rows, :3])
    ratios, start = [], 0
    for end in range(1, len(rows)):
        by_fixes = float(np.linalg.norm(fixes[end, :2] - fixes[start, :2]))
        if by_fixes > _SCALE_REACH_M:
            centres = stream.path.centre[rows[[start, end]]]
            ratios.append(float(np.linalg.norm(centres[1] - centres[0])) / by_fixes)
            start = end
    ratio = float(np.median(ratios)) if len(ratios) >= _FEWEST_SCALES else 1.0
    if 1 / _SCALE_FACTOR < ratio < _SCALE_FACTOR or ratio < _STANDS:
        return True
    timeline.notes.append(
        f"the {stream.words} are left out: their lengths are {ratio:.2f} times those of the fixes; record them in "
        "metres"
    )
    return False


def _cameras(plan: Plan, times: StreamTimes) -> list[Camera | None]:
    """The calibration in force at each image: the latest, or the first for the images before it."""
    count = len(times.log_ns)
    if plan.camera_given is not None:
        return [plan.camera_given] * count
    topic = plan.calibration
    assert topic is not None
    track = plan.survey.calibrations[topic.name, topic.schema]
    by_header = times.has_header and all(header_ns for _, header_ns, _ in track)
    track = sorted(track, key=itemgetter(int(by_header)))
    own = [
        (c[by_header], c[2], plan.camera_of(c[2]))
        for c in track
        if c[2].frame_id not in plan.other_frames
    ]
    if lost := [content for _, content, camera in own if camera is None]:
        topic.failed += len(lost)
        topic.fault = topic.fault or lost[0].why or lost[0].why_rectified
    held = [(at, camera) for at, _, camera in own if camera is not None]
    if not held:
        return [None] * count
    images_ns = times.header_ns if by_header else times.log_ns
    place = np.searchsorted(np.array([at for at, _ in held]), images_ns, side="right") - 1
    return [held[max(k, 0)][1] for k in place.tolist()]


def _motion_streams(plan: Plan, timeline: Timeline) -> list[MotionStream]:
    """All streams that may tell the camera's motion, in the order in which they are preferred."""
    tree, frame = plan.survey.tree, plan.camera.camera_frame
    found: list[MotionStream] = []
    if moving := tree.moving(frame):
        path = _chain_path(plan, tree.chain(frame), timeline)
        if path is not None:
            words = f"transforms of {', '.join(map(shortened, moving))}"
            unknown = np.full((len(path.known), 3), np.nan)
            found.append(MotionStream("transforms", "", words, path, path, unknown))
    elif edges := [name for name, edge in tree.edges.items() if edge.moves]:
        timeline.notes.append(
            f"transforms move {shortened(edges[0])}, but none of them mounts the camera "
            f"({shortened(frame) or 'its images name no frame'}) on it: they are left out"
        )
    for source, kind in (("poses", Kind.POSE), ("odometry", Kind.ODOMETRY)):
        topics = [t for t in plan.survey.of_kind(kind) if t.first is not None]
        for topic in sorted(topics, key=lambda t: -t.usable):
            positions = plan.survey.positions[topic.name, topic.schema]
            words = f"{source} of {shortened(topic.name)}"
            poses = _at_images(positions, words, timeline)
            if poses is None:
                continue
            raw, sigma = path_of(poses), poses.value[:, 7:]
            mount = mount_of(tree, positions, frame)
            if mount is None:
                inner: CameraPath | None = fixed(_STANDING, len(raw.known))
            else:
                inner = _chain_path(plan, mount, timeline)
            path = raw if inner is None else composed(raw, inner)
            found.append(MotionStream(source, topic.name, words, raw, path, sigma, mount is None))
    return found


def _chain_path(plan: Plan, chain: list[str], timeline: Timeline) -> CameraPath | None:
    """The camera in the parent of the last frame of a chain, at each image; None where it is that frame."""
    total: CameraPath | None = None
    for name in chain:
        mount = plan.survey.tree.mount([name])
        if mount is None:
            edge = plan.survey.tree.edges[name]
            poses = _at_images(edge, f"transforms of {shortened(name)}", timeline)
            if poses is None:
                return None
            outer = path_of(poses)
        else:
            outer = fixed(mount, len(timeline.order))
        total = outer if total is None else composed(outer, total)
    return total


def _at_images(
    positions: Series, words: str, timeline: Timeline, *, earth: bool = False
) -> Interpolated | None:
    """Positions at the images, of those that a vehicle can have been at; None where no clock is common to both."""
    times = positions.times()
    paired = pair_times(timeline.times, times, own_clock=earth)
    notes = timeline.notes
    if paired is None:
        notes.append(f"the images and the {words} share no clock: the {words} are left out")
        return None
    if times.off:
        notes.append(_off_words(times, words))
    if paired.apart_ns:
        way = "ahead of" if paired.apart_ns > 0 else "behind"
        notes.append(
            f"the clock of the {words} is {_seconds(paired.apart_ns)} {way} that of the images: log times pair them"
        )
    samples = Samples.sorted(paired.stream_ns, positions.values())
    if earth:
        # A receiver that has lost its satellites repeats its last fix.
        same = np.zeros(len(samples.time_ns), np.bool_)
        same[1:] = (samples.value[1:, :3] == samples.value[:-1, :3]).all(axis=1)
        if same.any():
            notes.append(
                f"{int(same.sum())} of {len(same)} {words} repeat the one before: left out"
            )
        samples = continuous_longitudes(samples.kept(~same))
    places = samples.value[:, :3]
    kept = possible(samples.time_ns, metres(places) if earth else places)
    if wrong := int((~kept).sum()):
        notes.append(f"{wrong} of {len(kept)} {words} are at impossible places: left out")
    return interpolate(samples.kept(kept), paired.images_ns)


def _off_words(times: StreamTimes, words: str) -> str:
    return (
        f"{times.off} of {len(times.log_ns)} header times of {shortened(words)} do not fit their log times: the time "
        "nearer to the rest is used"
    )


def _seconds(ns: int) -> str:
    seconds = abs(ns) / 1e9
    if seconds > 2 * 86400:
        return f"{seconds / 86400:.0f} days"
    return f"{seconds:.2f} s" if seconds < 600 else f"{seconds / 60:.0f} minutes"


def _fixes(plan: Plan, timeline: Timeline) -> Interpolated | None:
    if plan.fixes is None:
        return None
    words = f"fixes of {shortened(plan.fixes.name)}"
    found = _at_images(plan.survey.positions[plan.fixes.name, ""], words, timeline, earth=True)
    if found is not None and found.known.sum() == 1:
        timeline.notes.append(f"the {words} are left out: only one image has one near its time")
        return None
    return found
