"""Which topics of a log are read: one camera, its calibration and motion; or why it cannot be read."""

import difflib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from wayside.pipeline.reading.calibrations import is_rectified, read_camera_file
from wayside.pipeline.reading.contents import CalibrationContent, ImageContent
from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.image_headers import read_exif, refuse_turned
from wayside.pipeline.reading.messages import Kind
from wayside.pipeline.reading.series import bare
from wayside.pipeline.reading.survey import LogSurvey, Topic, survey_log
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings

_MOST_LISTED, _LONGEST_SHOWN = 6, 120
_TRANSPORTS = ("compressed", "theora", "ffmpeg", "h264", "zstd")


@dataclass(frozen=True, slots=True)
class Plan:
    """What is read from a log.

    `calibration`: topic, or None where `camera_given` (from `calibration_source`) is used; `notes`: on streams that
    tell nothing of motion and place, wholly or in part.
    """

    survey: LogSurvey
    camera: Topic
    calibration: Topic | None
    camera_given: Camera | None
    calibration_source: str
    fixes: Topic | None
    spacing_m: float
    notes: tuple[str, ...] = ()

    @property
    def other_cameras(self) -> frozenset[str]:
        """Names of cameras whose images share the topic with those of the chosen one."""
        same = [t for t in self.survey.cameras if t.name == self.camera.name]
        return frozenset().union(*(t.other_cameras for t in same)) - {self.camera.camera_frame}

    @property
    def other_frames(self) -> frozenset[str]:
        """Each `frame_id` of the images of other cameras; calibrations that bear it are theirs."""
        own = _bare_frame(self.camera.camera_frame)
        frames = {t.camera_frame for t in self.survey.cameras} if own else set()
        others = frozenset(name for name in frames if _bare_frame(name) not in ("", own))
        return others | self.camera.other_cameras

    @property
    def first_camera(self) -> Camera | None:
        """The camera given, else that of the first calibration."""
        content = None if self.calibration is None else self.calibration.first
        if isinstance(content, CalibrationContent):
            return self.camera_of(content)
        return self.camera_given

    def camera_of(self, content: CalibrationContent) -> Camera | None:
        """The camera that a calibration makes of the images, or None."""
        return content.camera_for(self.camera.image_size, rectified=is_rectified(self.camera.name))


def plan_reading(path: Path, settings: ReadSettings, camera: Camera | None = None) -> Plan:
    """Survey a log and choose what is read of it; `camera` replaces every calibration.

    Raises UsageError for settings that choose no one camera of the log. Raises InputError where the log has no images,
    no calibration, no information on the camera's motion, or images that Exif turns.
    """
    if camera is None and settings.calibration:
        camera = read_camera_file(Path(settings.calibration))
    return make_plan(survey_log(path, settings.camera), settings, camera)


def make_plan(survey: LogSurvey, settings: ReadSettings, given: Camera | None) -> Plan:
    """Choose from a survey; `given` is the calibration of `settings.calibration`. Raises as `plan_reading`."""
    camera = _choose_camera(survey, settings.camera)
    chosen = _choose_calibration(survey, camera, settings, given)
    fixes = next((t for t in survey.of_kind(Kind.FIX) if t.first is not None), None)
    spacing_m = settings.spacing_m or survey.spacing_m
    posed = any(t.first is not None for t in survey.of_kind(Kind.POSE, Kind.ODOMETRY))
    posed = posed or bool(survey.tree.moving(camera.camera_frame))
    if not posed and fixes is None and not spacing_m:
        found = "; ".join([_listing(survey), *_without_value(survey)])
        raise InputError(
            f"{survey.path}: signs cannot be located: the log has no poses, odometry or satellite fixes, and the "
            f"distance between images is unknown. It holds {found}. Give the distance, as in --spacing 26.4ft."
        )
    notes = (*_image_notes(camera, chosen[1]), *_without_value(survey))
    return Plan(survey, camera, *chosen, fixes, spacing_m, notes)


def _choose_camera(survey: LogSurvey, wanted: str) -> Topic:
    cameras = survey.cameras
    if not cameras:
        raise InputError(
            f"{survey.path}: the log has no images. It holds {_listing(survey)}{_lost(survey)}. Wayside reads "
            "foxglove.CompressedImage, foxglove.RawImage, foxglove.CompressedVideo and those of sensor_msgs."
        )
    chosen = [t for t in cameras if t.name == wanted] if wanted else cameras
    if not chosen:
        near = difflib.get_close_matches(wanted, [t.name for t in cameras], 1, 0.0)
        raise UsageError(
            f"--camera: {survey.path} has no image topic {wanted}. It has {describe_cameras(cameras)}; the nearest is "
            f"{near[0] if near else cameras[0].name}."
        )
    if len({t.name for t in chosen}) > 1:
        raise UsageError(
            f"{survey.path}: the log has {len(chosen)} cameras: {describe_cameras(chosen)}. Choose one, as in "
            f"--camera {max(chosen, key=lambda t: t.count).name}."
        )
    camera = chosen[0]
    first = camera.first
    if not isinstance(first, ImageContent) or camera.flaw:
        raise InputError(
            f"{survey.path}: none of the images on {camera.name} can be decoded: {camera.flaw or camera.fault}. "
            "Record or convert them again, or choose another topic with --camera."
        )
    refuse_turned(
        f"{survey.path}: the first image of {shortened(camera.name)}", read_exif(first.data)
    )
    if camera.image_format == H264 and find_spec("av") is None:
        raise InputError(
            f"{survey.path}: {camera.name}: the H.264 video needs PyAV, which is not installed. Install it with pip "
            "install 'wayside[video]'."
        )
    return camera


def describe_cameras(cameras: list[Topic]) -> str:
    """Cameras with their counts and sizes, in a line: the most numerous, a handful of them."""
    words = []
    for topic in sorted(cameras, key=lambda t: -t.count):
        size = topic.image_size
        shown = "size unknown" if size is None else f"{size[0]} x {size[1]}"
        words.append(f"{shortened(topic.name)} ({topic.count} images, {shown})")
    return listed(words)


def listed(words: Sequence[str], most: int = _MOST_LISTED) -> str:
    """The first `most` of some words, in a line, and how many more there are."""
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more


def shortened(name: str) -> str:
    """A name that fits into a line: a long one loses its middle."""
    return name if len(name) <= _LONGEST_SHOWN else f"{name[:60]}...{name[-20:]}"


def _choose_calibration(
    survey: LogSurvey, camera: Topic, settings: ReadSettings, given: Camera | None
) -> tuple[Topic | None, Camera | None, str]:
    if given is not None:
        return None, given, settings.calibration
    rectified, faults = is_rectified(camera.name), []
    found = [
        (topic, content, content.camera_for(camera.image_size, rectified=rectified))
        for topic in survey.of_kind(Kind.CALIBRATION)
        if isinstance(content := topic.first, CalibrationContent)
    ]
    found.sort(key=lambda one: _closeness(camera, *one), reverse=True)
    usable: list[tuple[Topic, CalibrationContent, Camera]] = []
    for topic, content, own in found[:_MOST_LISTED]:
        fault = content.why_rectified if rectified else content.why
        if own is not None:
            fault = _of_another(survey, camera, topic.name, content.frame_id, own)
        if own is not None and not fault:
            usable.append((topic, content, own))
        else:
            faults.append(f"{topic.name}, but {fault}")
    if usable:
        best, close = usable[0], _closeness(camera, *usable[0])
        level = (one for one in usable if _closeness(camera, *one) == close and one[2] != best[2])
        other = next(level, None)
        if other is None:
            return best[0], None, best[0].name
        faults.append(f"{best[0].name} and {other[0].name}, which differ")
    elif survey.attached is not None:
        name, attached = survey.attached
        fault = _of_another(survey, camera, name, "", attached)
        if not fault:
            return None, attached, f"attachment {name}"
        faults.append(f"attachment {name}, but {fault}")
    unread = [t for t in survey.of_kind(Kind.CALIBRATION) if t.first is None][:_MOST_LISTED]
    faults += [f"{topic.name}, but {topic.fault}" for topic in unread]
    raise InputError(
        f"{survey.path}: there is no calibration of {camera.name}: {'; '.join(faults) or 'none in the log'}"
        f"{_lost(survey)}. Give it with --calibration camera.yaml (of ROS, OpenCV or Kalibr), or run with "
        "--self-calibrate."
    )


def _of_another(survey: LogSurvey, camera: Topic, name: str, frame: str, own: Camera) -> str:
    """Why a calibration `name` is of another camera, or may be; empty where it is of this one.

    The calibration belongs to the camera with the same `frame_id`, else namespace, else the most words of its name in
    common. A calibration whose `frame_id` and namespace both differ is not used.
    """
    mine, here, there = _affinity(camera, name, frame), _namespace(camera.name), _namespace(name)
    same_frame, same_place, _ = mine
    if not same_frame and _bare_frame(frame) and _bare_frame(camera.camera_frame):
        if not same_place or any(_affinity(topic, name, frame)[0] for topic in survey.cameras):
            return (
                f"it is of another camera: its frame_id is {shortened(frame)}, that of the images "
                f"{shortened(camera.camera_frame)}"
            )
    if same_place:
        return ""
    alike = _words("/".join(here)) & _words("/".join(there))
    if not same_frame and len(here) == len(there) and alike:  # as cam_left and cam_right
        return "it is of another camera by its name"
    for rival in survey.cameras:
        fits = rival.image_size in (None, (own.width, own.height))
        if not fits or _namespace(rival.name) == here:
            continue
        theirs = _affinity(rival, name, frame)
        if theirs > mine:
            return f"it is of another camera by frame_id or name, that of {shortened(rival.name)}"
        if theirs == mine and not same_frame:
            return (
                f"nothing tells whether it is of this camera or of that of {shortened(rival.name)}"
            )
    return ""


def _bare_frame(frame: str) -> str:
    """A frame's name without words that only mean frame: `/camera_optical_frame` is `camera`."""
    return re.sub(r"(?:_(?:optical|link|frame))+$", "", bare(frame))


def _namespace(topic: str) -> tuple[str, ...]:
    """Namespace of a topic; image transports are below the image topic."""
    parts = topic.strip("/").split("/")
    return tuple(parts[: -2 if parts[-1] in _TRANSPORTS else -1])


def _words(topic: str) -> set[str]:
    return set(re.findall(r"[a-z]+|\d+", topic.lower()))


def _affinity(topic: Topic, name: str, frame: str) -> tuple[bool, bool, int]:
    """What a calibration and a topic of images have in common: `frame_id`, namespace, number of words in the names."""
    same_frame = _bare_frame(topic.camera_frame) == _bare_frame(frame) != ""
    same_place = _namespace(topic.name) == _namespace(name)
    return same_frame, same_place, len(_words(topic.name) & _words(name))


def _closeness(
    camera: Topic, topic: Topic, content: CalibrationContent, own: Camera | None
) -> tuple[bool, bool, bool, bool, int]:
    """How well a calibration fits a camera: same size, same frame, both rectified or not, similar names."""
    same_size = own is not None and (own.width, own.height) == camera.image_size
    same_frame, same_place, shared = _affinity(camera, topic.name, content.frame_id)
    alike = is_rectified(camera.name) == is_rectified(topic.name)
    return same_size, same_frame, alike, same_place, shared


def _image_notes(camera: Topic, given: Camera | None) -> Iterator[str]:
    """Notes on how pixels are interpreted where their message does not say it."""
    if 0 < camera.bits < 16:
        yield (
            f"the samples of 16 bits on {shortened(camera.name)} use {camera.bits} of them: these are taken for the "
            "range from black to white"
        )
    if given is not None and given.distortion and is_rectified(camera.name):
        yield (
            f"the images on {shortened(camera.name)} are rectified by their name, and the calibration given states "
            "distortion: it is applied, which is wrong if the name is right"
        )


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


def _listing(survey: LogSurvey) -> str:
    """Topics with their types, the most numerous first, a handful of them."""
    topics = sorted(survey.topics.values(), key=lambda t: (-t.count, t.name))
    words = [f"{shortened(t.name)} ({shortened(t.schema) or 'no schema'})" for t in topics]
    return listed(words) or "no messages"


def _lost(survey: LogSurvey) -> str:
    count = survey.scan.problem_count
    return f" (and {count} damaged places)" if count else ""
