"""Images of a log, each with the calibration, pose and fix of its own time."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from wayside.pipeline.files.settings_file import by_full_name, load_settings
from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.reading.image_headers import frame_of
from wayside.pipeline.reading.messages import Kind
from wayside.pipeline.reading.plan import Plan, plan_reading, shortened
from wayside.pipeline.reading.records import Message, ScanReport
from wayside.pipeline.reading.selection import Selection
from wayside.pipeline.reading.timeline import Timeline, make_timeline
from wayside.pipeline.reading.video import CameraImages, image_messages, is_grey
from wayside.schemas.errors import InputError
from wayside.schemas.frame import NO_POSITION, OTHER_CAMERA, USED, WRONG_SIZE, Camera, Frame
from wayside.schemas.settings import ReadSettings, Settings
from wayside.stages.imaging import used_bits


@dataclass(slots=True)
class ReadReport(ScanReport):
    """What the reading of a log found and chose, filled while it runs."""

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
    notes: list[str] = field(default_factory=list)


def read_frames(
    path: Path, settings: ReadSettings, report: ReadReport, camera: Camera | None = None
) -> Iterator[Frame]:
    """Frames of a log's chosen camera, every image message one, in the order they were taken in.

    The log is read twice: first for what it holds and when, then for the images. Images that do not take part come too,
    with their status and without data. Memory is bounded by one chunk and a hundred bytes a message. Images are not
    copied where the encoding allows it.

    `report`: filled while the frames are taken; `camera`: replaces the calibrations of the log and of the settings.
    Raises as `load_settings`, `plan_reading` and `make_timeline`, at once; and InputError at the end, where no image
    could be used.
    """
    load_settings(options=by_full_name(Settings(read=settings)))
    plan = plan_reading(path, settings, camera)
    timeline = make_timeline(plan)
    plan.survey.positions.clear()  # what they tell of the images is in the timeline
    report.camera_topic, report.calibration_source = plan.camera.name, plan.calibration_source
    report.camera_frame = plan.camera.camera_frame
    report.images_held = len(timeline.order)
    if timeline.motion is not None:
        report.motion_source = timeline.motion.source
        report.motion_topic = timeline.motion.topic
    report.notes += [*plan.notes, *timeline.notes]
    reader = _Reader(plan, timeline, settings, report)
    if reader.grey:
        report.notes.append(
            "the camera sees no colour: colours are not stated, and codes follow from shape, size and pattern"
        )
    return reader.frames()


class _Reader:
    """One reading of one log."""

    def __init__(
        self, plan: Plan, timeline: Timeline, settings: ReadSettings, report: ReadReport
    ) -> None:
        self.plan, self.timeline, self.report = plan, timeline, report
        self.grey = is_grey(plan, timeline.order, timeline.cameras)
        self.selection = Selection(settings, plan.spacing_m)
        self.by_number = plan.survey.by_number and not settings.spacing_m
        self.images = CameraImages(plan.other_cameras)
        self.problems = 0

    def frames(self) -> Iterator[Frame]:
        """All frames; see `read_frames`."""
        survey, camera = self.plan.survey, self.plan.camera.name
        for row, message in image_messages(survey, camera, self.timeline.order, self.report):
            yield self._frame(row, message)
        self._finish()

    def _frame(self, row: int, message: Message) -> Frame:
        report, timeline = self.report, self.timeline
        camera, lost = timeline.cameras[row], report.problem_count > self.problems
        self.problems = report.problem_count
        status, image = self.images.image(message, camera, after_loss=lost)
        if image.width and used_bits(frame_of(image)):
            image = replace(image, encoding=f"{image.encoding}:{self.plan.camera.bits}")
        time_ns = int(timeline.times.capture_ns[row])
        known = time_ns == (image.time_ns or message.log_time_ns)
        pose, log_time = timeline.pose(row), str(message.log_time_ns)
        frame = replace(
            frame_of(image),
            index=report.images,
            log_time_ns=message.log_time_ns,
            header_time_ns=image.time_ns,
            status=status,
            camera=camera,
            pose=pose,
            fix=timeline.fix(row),
            settled_time_ns=None if known else time_ns,
            name=self.plan.survey.image_names.get(log_time, ""),
            date=self.plan.survey.image_dates.get(log_time, ""),
            grey=self.grey,
        )
        # The numbers of imported messages count the images taken, gaps included.
        counted = report.images - report.statuses[OTHER_CAMERA]
        frame = self.selection.decide(frame, message.sequence if self.by_number else counted)
        report.images += 1
        report.statuses[frame.status] += 1
        report.with_pose += pose is not None
        return frame

    def _finish(self) -> None:
        report, plan = self.report, self.plan
        kinds = Kind.POSE, Kind.ODOMETRY, Kind.FIX, Kind.TRANSFORM
        read = [] if plan.calibration is None else [plan.calibration]
        for topic in (t for t in (*read, *plan.survey.of_kind(*kinds)) if t.failed):
            report.add_problem(
                topic.failed_offset,
                f"{counted(topic.failed, 'message')} of {shortened(topic.name)} lost: they cannot be decoded or used "
                f"({topic.fault})",
            )
        report.notes += [*report.unchecked, *self.selection.notes(), *self.images.notes()]
        if report.motion_source and report.images and not report.with_pose:
            report.notes.append(
                f"no image has a pose of its own time: the times of {report.motion_topic or 'the transforms'} differ"
            )
        used = bool(report.statuses[USED])
        if self.images.both_ways and not used:
            raise InputError(
                f"{plan.survey.path}: none of its images can be used: {list(self.images.notes())[-1]}"
            )
        if report.statuses[NO_POSITION] and not used:
            raise InputError(
                f"{plan.survey.path}: none of its {report.statuses[NO_POSITION]} images has a pose or fix near its "
                "time; give the distance between images (--spacing 26.4ft)"
            )
        if report.statuses[OTHER_CAMERA]:
            names = ", ".join(sorted(map(shortened, plan.other_cameras)))
            report.notes.append(
                f"{counted(report.statuses[OTHER_CAMERA], 'image')} of {shortened(plan.camera.name)} of another camera "
                f"(frame_id {names}, not {shortened(plan.camera.camera_frame)}): left out; record each camera on a "
                "topic of its own"
            )
        if report.statuses[NO_POSITION]:
            report.notes.append(
                f"{counted(report.statuses[NO_POSITION], 'image')} left out, without a pose or fix near in time; "
                "with --spacing all are used"
            )
        if report.statuses[WRONG_SIZE] and not used:
            size, camera = plan.camera.image_size, self.timeline.cameras[self.timeline.order[-1]]
            found = "other sizes" if size is None else f"{size[0]} x {size[1]}"
            wanted = "the calibration" if camera is None else f"{camera.width} x {camera.height}"
            raise InputError(
                f"{plan.survey.path}: the images of {plan.camera.name} have {found} pixels, their calibration "
                f"({plan.calibration_source}) has {wanted}; give the right one with --calibration camera.yaml"
            )
