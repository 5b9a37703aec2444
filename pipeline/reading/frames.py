"""Images of a log, each with the calibration, pose and fix of its own time."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from wayside.pipeline.reading.bounds import allowance_of
from wayside.pipeline.reading.contents import (
    CalibrationContent,
    FixContent,
    ImageContent,
)
from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.inspection import Inspection, inspect_log
from wayside.pipeline.reading.messages import Decoders, Kind, MessageError, kind_of
from wayside.pipeline.reading.plan import Plan, plan_reading, shortened
from wayside.pipeline.reading.poses import CameraPoses
from wayside.pipeline.reading.records import Message
from wayside.pipeline.reading.replay import messages_of
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.selection import Selection, WaitingImage
from wayside.pipeline.reading.series import TimeSeries, blend_fixes
from wayside.pipeline.reading.survey import topic_key
from wayside.pipeline.reading.video import VideoStreams
from wayside.schemas.errors import InputError
from wayside.schemas.frame import (
    NO_POSITION,
    OTHER_CAMERA,
    USED,
    WRONG_SIZE,
    Camera,
    Fix,
    Frame,
)
from wayside.schemas.settings import ReadSettings

MOST_WAITING, MOST_WAITING_BYTES = 64, 1 << 26
_OFTEN_NS = 10**9
_MUCH_SMALLER = 8
"""An image so much smaller than its chunk is copied, so that it does not keep all of the chunk in memory."""


@dataclass(slots=True)
class ReadReport(ScanReport):
    """What the reading of a log came across and chose, filled while it runs."""

    images: int = 0
    images_held: int = 0
    """Image messages of the chosen camera in the whole log."""
    with_pose: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    camera_topic: str = ""
    camera_frame: str = ""
    calibration_source: str = ""
    motion_source: str = ""
    motion_topic: str = ""
    spacing_m: float = 0.0
    first_time_ns: int | None = None
    notes: list[str] = field(default_factory=list)


def read_frames(
    path: Path, settings: ReadSettings, report: ReadReport, camera: Camera | None = None
) -> Iterator[Frame]:
    """Frames of a log's chosen camera, every image message one, in the order they were taken in.

    The log is read twice: first for what it holds, its clocks, order and faulty positions, then for the frames. Images
    that do not take part come too, with their status and without data. Memory is bounded by one chunk, the images of
    `late_s`, and a hundred bytes a message. Images are not copied where the encoding allows it.

    Parameters
    ----------
    path
        The MCAP file.
    settings
        Camera, calibration, part and thinning.
    report
        Filled while the frames are taken.
    camera
        Replaces the calibrations of the log and of the settings.

    Raises
    ------
    UsageError
        Settings that make no sense or name no camera of the log, or several cameras and none chosen; at once.
    InputError
        The log cannot be used; at once, or at the end where no image has the size of its calibration.
    """
    plan = plan_reading(path, settings, camera)
    report.camera_topic, report.calibration_source = plan.camera.name, plan.calibration_source
    report.camera_frame = plan.camera_frame
    report.images_held = plan.camera.count
    report.motion_source = plan.motion_source
    report.motion_topic = "" if plan.motion is None else plan.motion.name
    report.spacing_m = plan.spacing_m
    inspection = inspect_log(plan, settings)
    plan.survey.stamps.forget_entries()
    report.notes += [*plan.notes, *inspection.notes]
    return _Reader(plan, inspection, settings, report).frames()


class _Reader:
    """One reading of one log."""

    def __init__(
        self, plan: Plan, inspection: Inspection, settings: ReadSettings, report: ReadReport
    ) -> None:
        self.plan, self.inspection, self.report = plan, inspection, report
        self.settings = settings
        self.allowance = allowance_of(settings)
        self.window_ns = round(settings.late_s * 1e9)
        self.selection = Selection(plan, settings)
        self.decoders = Decoders()
        self.video = VideoStreams()
        self.waiting: deque[WaitingImage] = deque()
        self.waiting_bytes = 0
        self.problems = 0
        self.calibrations: TimeSeries[Camera] = TimeSeries()
        self.fixes: TimeSeries[Fix] = TimeSeries()
        is_video = plan.camera.image_format == H264  # whose streams are told apart by themselves
        self.others = frozenset() if is_video else plan.camera.other_cameras
        self.others_seen = 0
        self.poses: CameraPoses | None = None
        if plan.motion_source:
            self.poses = CameraPoses(plan.camera_frame, plan.motion_source, settings)
            self.poses.tree = (
                plan.survey.tree
            )  # mounts that come after the first image are known already
        self._seed_calibration()

    def frames(self) -> Iterator[Frame]:
        """All frames; see `read_frames`."""
        plan = self.plan
        topics = (plan.camera, plan.calibration, plan.motion, plan.fixes)
        wanted = {(t.name, t.schema) for t in topics if t is not None}
        camera = plan.camera.name, plan.camera.schema
        transforms = self.poses is not None
        messages = messages_of(plan.survey, self.inspection.order, self.report, self.allowance)
        for number, record in messages:
            key = topic_key(record.channel)
            if key in wanted or (transforms and kind_of(record.channel) is Kind.TRANSFORM):
                self._take(record, number, is_image=key == camera)
            now_ns = int(self.inspection.arrival_ns[number])
            while self.waiting and self._is_ready(now_ns):
                yield self._next_frame()
        while self.waiting:
            yield self._next_frame()
        self._finish()

    def _seed_calibration(self) -> None:
        """The first calibration serves the images before it, too."""
        topic = self.plan.calibration
        first = None if topic is None else topic.first
        if isinstance(first, CalibrationContent) and first.camera and not self._is_other(first):
            self.calibrations.add(-(1 << 62), first.camera)

    def _is_other(self, content: ImageContent | CalibrationContent) -> bool:
        """Whether an image or a calibration is of a camera that only shares the topic."""
        return content.frame_id in self.others

    def _take(self, message: Message, number: int, *, is_image: bool) -> None:
        channel, entry = message.channel, int(self.inspection.first[number])
        try:
            contents = self.decoders.decode(channel, message.data)
        except MessageError:
            if is_image:
                self._wait(message, number, None)
            return
        for content in contents:
            time_ns = int(self.inspection.time_ns[entry])
            if isinstance(content, ImageContent):
                self._wait(message, number, content)
            elif self.inspection.wrong[entry]:
                pass
            elif isinstance(content, CalibrationContent):
                if content.camera is not None and not self._is_other(content):
                    self.calibrations.add(time_ns, content.camera)
            elif isinstance(content, FixContent):
                self.fixes.add(time_ns, content.fix)
            elif self.poses is not None:
                moved = self.inspection.moved(entry, content)
                if kind_of(channel) is Kind.TRANSFORM:
                    self.poses.tree.add(time_ns, moved)
                else:
                    self.poses.add(time_ns, moved)
            entry += 1

    def _wait(self, message: Message, number: int, image: ImageContent | None) -> None:
        report, inspection = self.report, self.inspection
        entry = int(inspection.first[number])
        index = report.images
        if (
            image is not None
            and len(image.data) * _MUCH_SMALLER < memoryview(message.data.obj).nbytes
        ):
            image = replace(image, data=memoryview(bytes(image.data)))
        report.images += 1
        is_other = image is not None and self._is_other(image)
        self.others_seen += is_other
        taken = message.sequence if self.plan.by_number else index - self.others_seen
        header_ns = None if image is None else image.time_ns
        capture_ns = int(inspection.capture_ns[entry])
        self.waiting.append(
            WaitingImage(
                index,
                taken,
                message.log_time_ns,
                int(inspection.arrival_ns[number]),
                int(inspection.time_ns[entry]),
                None if capture_ns == (header_ns or message.log_time_ns) else capture_ns,
                image,
                OTHER_CAMERA if is_other else "",
                after_loss=report.problem_count > self.problems,
                channel=message.channel.id,
            )
        )
        self.problems = report.problem_count
        self.waiting_bytes += 0 if image is None else len(image.data)

    def _is_ready(self, now_ns: int) -> bool:
        """Whether the oldest waiting image has all that belongs to it, or has waited long enough."""
        oldest = self.waiting[0]
        if (
            now_ns - oldest.arrival_ns > self.window_ns
            or len(self.waiting) > MOST_WAITING
            or self.waiting_bytes > MOST_WAITING_BYTES
        ):
            return True
        time_ns = oldest.time_ns
        if self.poses is not None and not self.poses.reaches(time_ns):
            return False
        if self.plan.fixes is not None and not self.fixes.reaches(time_ns):
            return False
        times = (
            self.calibrations.times
        )  # waited for only where they come often, as one with each image
        often = len(times) > 1 and times[-1] - times[-2] < _OFTEN_NS
        return not often or self.calibrations.reaches(time_ns)

    def _next_frame(self) -> Frame:
        one = self.waiting.popleft()
        self.waiting_bytes -= 0 if one.image is None else len(one.image.data)
        camera = self.plan.camera_given or self.calibrations.latest(one.time_ns)
        if one.image is not None and one.image.encoding == H264:
            size = None if camera is None else (camera.width, camera.height)
            fault, image = self.video.decode(
                one.channel, one.image, size, after_loss=one.after_loss
            )
            one = replace(one, image=image, fault="" if fault == USED else fault)
        pose = None if self.poses is None else self.poses.at(one.time_ns)
        fix = self.fixes.at(one.time_ns, blend_fixes, self.settings)
        if fix is not None:
            fix = replace(fix, span_s=self.fixes.span_ns(one.time_ns) * 1e-9)
        frame = self.selection.decide(one, camera, pose, fix)
        report = self.report
        report.statuses[frame.status] += 1
        report.with_pose += pose is not None
        if report.first_time_ns is None:
            report.first_time_ns = frame.time_ns
        return frame

    def _finish(self) -> None:
        report = self.report
        for topic in self.plan.failed:
            report.add_problem(
                topic.failed_offset,
                f"{topic.failed} messages of {shortened(topic.name)} lost: they cannot be decoded or used "
                f"({topic.fault})",
            )
        report.notes += report.unchecked
        report.notes += [*self.selection.numbers.notes(), *self.video.notes()]
        if self.poses is not None and self.poses.assumed_mount:
            report.notes.append(
                "the log does not say how the camera is mounted: it is taken to look straight ahead"
            )
        if self.poses is not None and report.images and not report.with_pose:
            report.notes.append(
                f"no image has a pose of its own time: the times of {report.motion_topic or 'the transforms'} differ"
            )
        if self.video.counts.both_ways and not report.statuses[USED]:
            raise InputError(
                f"{self.plan.survey.path}: wanted images that can be used, found {self.video.notes()[-1]}"
            )
        if report.statuses[NO_POSITION] and not report.statuses[USED]:
            raise InputError(
                f"{self.plan.survey.path}: wanted poses or fixes at the times of images, found "
                f"{report.statuses[NO_POSITION]} images and none of them near; give the distance between images "
                "(--spacing 26.4ft)"
            )
        if report.statuses[OTHER_CAMERA]:
            names = ", ".join(sorted(map(shortened, self.others)))
            report.notes.append(
                f"{report.statuses[OTHER_CAMERA]} images of {shortened(self.plan.camera.name)} are of another camera "
                f"(frame_id {names}, not {shortened(self.plan.camera_frame)}): left out; record each camera on a topic "
                "of its own"
            )
        if report.statuses[NO_POSITION]:
            report.notes.append(
                f"{report.statuses[NO_POSITION]} images before the first pose or fix are left out; --spacing uses them"
            )
        if report.statuses[WRONG_SIZE] and not report.statuses[USED]:
            size, camera = self.plan.camera.image_size, self.selection.last_camera
            found = "other sizes" if size is None else f"{size[0]} x {size[1]}"
            wanted = "" if camera is None else f" of {camera.width} x {camera.height}"
            raise InputError(
                f"{self.plan.survey.path}: wanted images{wanted} as the calibration "
                f"({self.plan.calibration_source}) has them, found {found} on {self.plan.camera.name}; "
                "give the right one with --calibration camera.yaml"
            )
