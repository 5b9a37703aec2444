"""Which topics of a log are read: one camera, its calibration, what tells its motion; or why it cannot be read."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from wayside.pipeline.reading.bounds import allowance_of
from wayside.pipeline.reading.camera_file import read_camera_file
from wayside.pipeline.reading.contents import CalibrationContent, ImageContent
from wayside.pipeline.reading.exif import read_exif, refuse_turned
from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.messages import Kind
from wayside.pipeline.reading.survey import LogSurvey, Topic, survey_log
from wayside.pipeline.reading.video import WITHOUT_DECODER, can_decode_video
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings

_MOST_LISTED, _LONGEST_SHOWN = 6, 120


@dataclass(frozen=True, slots=True)
class Plan:
    """What is read from a log.

    calibration: topic, or None where `camera_given` (from `calibration_source`) is used; by_number: message sequence
    numbers count the images taken, gaps included; notes: on streams that tell nothing of motion and place, wholly or in
    part.
    """

    survey: LogSurvey
    camera: Topic
    calibration: Topic | None
    camera_given: Camera | None
    calibration_source: str
    fixes: Topic | None
    spacing_m: float
    by_number: bool
    notes: tuple[str, ...] = ()

    @property
    def failed(self) -> list[Topic]:
        """Topics besides the images of which messages are lost though they should be of use, by name."""
        kinds = Kind.POSE, Kind.ODOMETRY, Kind.FIX, Kind.TRANSFORM
        read = [] if self.calibration is None else [self.calibration]
        return [t for t in (*read, *self.survey.of_kind(*kinds)) if t.failed]

    @property
    def other_cameras(self) -> frozenset[str]:
        """Names of cameras whose images share the topic with those of the chosen one."""
        same = [t for t in self.survey.cameras if t.name == self.camera.name]
        return frozenset().union(*(t.other_cameras for t in same)) - {self.camera_frame}

    @property
    def camera_frame(self) -> str:
        """`frame_id` of the images."""
        return self.camera.camera_frame


def check_settings(settings: ReadSettings) -> None:
    """Refuse settings that no log could satisfy; raises UsageError."""
    wanted = (
        (settings.every >= 1, "--every", "1 or more", settings.every),
        (
            settings.thin_m >= 0,
            "read.thin_m",
            "a distance, or 0 for every image",
            settings.thin_m,
        ),
        (settings.spacing_m >= 0, "--spacing", "a distance such as 26.4ft", settings.spacing_m),
        (settings.from_s >= 0, "--from", "a time after the first image", settings.from_s),
        (
            settings.until_s == 0 or settings.until_s > settings.from_s,
            "--until",
            f"a time after --from ({settings.from_s:g} s)",
            settings.until_s,
        ),
    )
    for holds, option, want, found in wanted:
        if not holds:
            raise UsageError(f"{option}: wanted {want}, found {found:g}; change or leave it out")


def plan_reading(path: Path, settings: ReadSettings, camera: Camera | None = None) -> Plan:
    """Survey a log and choose what is read of it; `camera` replaces every calibration.

    Raises
    ------
    UsageError
        Settings that make no sense, an unknown camera topic, or several cameras and none chosen.
    InputError
        The log has no images, no calibration, or nothing that tells how the camera moved, or its images are to be shown
        otherwise than they are stored.
    """
    check_settings(settings)
    given = camera
    if given is None and settings.calibration:
        given = read_camera_file(Path(settings.calibration))
    survey = survey_log(
        path,
        settings.camera,
        calibrated=given is not None,
        allowance=allowance_of(settings),
    )
    return make_plan(survey, settings, given)


def make_plan(survey: LogSurvey, settings: ReadSettings, given: Camera | None) -> Plan:
    """Choose from a survey; `given` is the calibration of `settings.calibration`. Raises as `plan_reading`."""
    camera = _choose_camera(survey, settings.camera)
    calibration, camera_given, source = _choose_calibration(survey, camera, settings, given)
    fixes = next((t for t in survey.of_kind(Kind.FIX) if t.first is not None), None)
    spacing_m = settings.spacing_m or survey.spacing_m
    posed = any(t.first is not None for t in survey.of_kind(Kind.POSE, Kind.ODOMETRY))
    posed = posed or bool(survey.tree.moving(camera.camera_frame))
    if not posed and fixes is None and not spacing_m:
        found = "; ".join([_listing(survey), *_without_value(survey)])
        raise InputError(
            f"{survey.path}: wanted poses, odometry, satellite fixes or a known spacing to place signs, "
            f"found {found}; give the distance between images, as in --spacing 26.4ft"
        )
    return Plan(
        survey,
        camera,
        calibration,
        camera_given,
        source,
        fixes,
        spacing_m,
        survey.by_number and not settings.spacing_m,
        tuple(_without_value(survey)),
    )


def _choose_camera(survey: LogSurvey, wanted: str) -> Topic:
    cameras = survey.cameras
    if not cameras:
        raise InputError(
            f"{survey.path}: wanted images, found {_listing(survey)}{_lost(survey)}; wayside needs "
            "foxglove.CompressedImage, foxglove.RawImage, foxglove.CompressedVideo or the sensor_msgs ones"
        )
    chosen = [t for t in cameras if t.name == wanted] if wanted else cameras
    if not chosen:
        near = difflib.get_close_matches(wanted, [t.name for t in cameras], 1, 0.0)
        raise UsageError(
            f"--camera: wanted an image topic of {survey.path}, found {wanted}; "
            f"there is {describe_cameras(cameras)}; nearest: {near[0] if near else cameras[0].name}"
        )
    if len({t.name for t in chosen}) > 1:
        raise UsageError(
            f"{survey.path}: wanted one camera, found {len(chosen)}: {describe_cameras(chosen)}; "
            f"choose one, as in --camera {max(chosen, key=lambda t: t.count).name}"
        )
    if chosen[0].first is None:
        raise InputError(
            f"{survey.path}: wanted images on {chosen[0].name}, found messages that cannot be decoded "
            f"({chosen[0].fault}); record them anew or choose another with --camera"
        )
    first = chosen[0].first
    if isinstance(first, ImageContent) and not first.width:
        words = f"{survey.path}: the first image of {shortened(chosen[0].name)}"
        refuse_turned(words, read_exif(first.data))
    if chosen[0].image_format == H264 and not can_decode_video():
        raise InputError(f"{survey.path}: {chosen[0].name}: {WITHOUT_DECODER}")
    return chosen[0]


def describe_cameras(cameras: list[Topic]) -> str:
    """Cameras with their counts and sizes, in a line: the most numerous, a handful of them."""
    words = []
    for topic in sorted(cameras, key=lambda t: -t.count)[:_MOST_LISTED]:
        size = topic.image_size
        shown = "size unknown" if size is None else f"{size[0]} x {size[1]}"
        words.append(f"{shortened(topic.name)} ({topic.count} images, {shown})")
    more = f" and {len(cameras) - _MOST_LISTED} more" if len(cameras) > _MOST_LISTED else ""
    return ", ".join(words) + more


def shortened(name: str) -> str:
    """A name as it fits into a line: the middle of one that is far too long is left out."""
    return name if len(name) <= _LONGEST_SHOWN else f"{name[:60]}...{name[-20:]}"


def _choose_calibration(
    survey: LogSurvey, camera: Topic, settings: ReadSettings, given: Camera | None
) -> tuple[Topic | None, Camera | None, str]:
    if given is not None:
        return None, given, settings.calibration
    topics = survey.of_kind(Kind.CALIBRATION)
    usable = [t for t in topics if isinstance(t.first, CalibrationContent)]
    if usable:
        best = max(usable, key=lambda t: _closeness(camera, t))
        return best, None, best.name
    if survey.attached_camera is not None:
        return None, survey.attached_camera, f"attachment {survey.attachment_name}"
    found = "; ".join(f"{t.name}, but {t.fault}" for t in topics) or "none"
    raise InputError(
        f"{survey.path}: wanted the calibration of {camera.name}, found {found}{_lost(survey)}; "
        "give it with --calibration camera.yaml (of ROS, OpenCV or Kalibr)"
    )


def _closeness(camera: Topic, calibration: Topic) -> tuple[bool, bool, int]:
    """How well a calibration goes with a camera: same frame, same size, topics alike."""
    content = calibration.first
    if not isinstance(content, CalibrationContent):
        return False, False, 0
    same_frame = bool(camera.camera_frame) and camera.camera_frame == content.frame_id
    size = None if content.camera is None else (content.camera.width, content.camera.height)
    shared = 0
    for a, b in zip(camera.name.split("/"), calibration.name.split("/"), strict=False):
        if a != b:
            break
        shared += 1
    return same_frame, size == camera.image_size, shared


def _without_value(survey: LogSurvey) -> Iterator[str]:
    """Notes on topics that could tell motion or place, and of which messages say nothing."""
    for topic in survey.of_kind(Kind.POSE, Kind.ODOMETRY, Kind.FIX):
        if topic.first is None:
            reason = topic.fault or "no position, or one known to a kilometre at best"
            yield f"none of the {topic.count} messages of {shortened(topic.name)} can be used: {reason}"
        elif silent := topic.count - topic.usable - topic.failed:
            yield (
                f"{silent} of {topic.count} messages of {shortened(topic.name)} hold no position, or one known to a "
                "kilometre at best"
            )
        if topic.in_part:
            yield (
                f"{topic.in_part} of {topic.count} messages of {shortened(topic.name)} state {topic.refused}: it is "
                "taken as unknown, the rest is used"
            )


def _listing(survey: LogSurvey) -> str:
    """Topics with their types, the most numerous first, a handful of them."""
    topics = sorted(survey.topics.values(), key=lambda t: (-t.count, t.name))
    words = [
        f"{shortened(t.name)} ({shortened(t.schema) or 'no schema'})" for t in topics[:_MOST_LISTED]
    ]
    more = f" and {len(topics) - _MOST_LISTED} more" if len(topics) > _MOST_LISTED else ""
    return ", ".join(words) + more if words else "no messages"


def _lost(survey: LogSurvey) -> str:
    count = survey.scan.problem_count
    return f" (and {count} damaged places)" if count else ""
