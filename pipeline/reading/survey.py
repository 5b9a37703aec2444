"""What a log holds: its topics, with the first message of each that matters, as far as needed to plan the reading."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.camera_file import LARGEST_FILE, parse_camera
from wayside.pipeline.reading.contents import (
    CalibrationContent,
    Content,
    ImageContent,
    PoseContent,
)
from wayside.pipeline.reading.image_headers import format_word, read_image_header
from wayside.pipeline.reading.layout import Attachment, Channel, Metadata
from wayside.pipeline.reading.messages import Decoders, Kind, MessageError, kind_of
from wayside.pipeline.reading.poses import TransformTree
from wayside.pipeline.reading.records import Message, scan
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.summary import read_summary
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera

METADATA_NAME, SPACING_KEY, BY_NUMBER_KEY = "wayside", "spacing_m", "by_number"
"""Metadata record by which `wayside import` tells the distance between images."""

_LONG_ENOUGH_NS = 2 * 10**9
_MOST_ATTACHMENTS = 16
_DEPTH = ("16UC1", "32FC1", "compressedDepth")


@dataclass(slots=True)
class Topic:
    """One topic: how much there is of it, and its first message."""

    name: str
    schema: str
    encoding: str
    kind: Kind | None
    count: int = 0
    size: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    first: Content | None = None
    fault: str = ""

    @property
    def is_camera(self) -> bool:
        """Whether these are images of a camera, depth images excluded."""
        if self.kind is not Kind.IMAGE:
            return False
        image = self.first
        return not (isinstance(image, ImageContent) and any(d in image.encoding for d in _DEPTH))

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height of the first image, None where it does not tell."""
        image = self.first
        if not isinstance(image, ImageContent):
            return None
        if image.width:
            return image.width, image.height
        header = read_image_header(image.data)
        return None if header is None else (header.width, header.height)

    @property
    def image_format(self) -> str:
        """Encoding of the first image, in a word."""
        image = self.first
        return format_word(image.encoding) if isinstance(image, ImageContent) else "unknown"

    @property
    def header_offset_ns(self) -> int | None:
        """Header time less log time of the first message; None where it has no header time."""
        if self.first is None or self.first.time_ns is None:
            return None
        return self.first.time_ns - self.first_log_ns


@dataclass(slots=True)
class LogSurvey:
    """What was found in a log, in the whole of it or at its beginning."""

    path: Path
    scan: ScanReport = field(default_factory=ScanReport)
    topics: dict[tuple[str, str], Topic] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    attached_camera: Camera | None = None
    attachment_name: str = ""
    attachments_tried: int = 0
    spacing_m: float = 0.0
    by_number: bool = False

    def of_kind(self, *kinds: Kind) -> list[Topic]:
        """Topics of some kinds, by name."""
        return sorted((t for t in self.topics.values() if t.kind in kinds), key=lambda t: t.name)

    @property
    def cameras(self) -> list[Topic]:
        """Topics of camera images, by name."""
        return [t for t in self.of_kind(Kind.IMAGE) if t.is_camera]


def survey_log(
    path: Path,
    *,
    whole: bool,
    camera: str = "",
    calibrated: bool = False,
    spaced: bool = False,
    allowance: Allowance | None = None,
) -> LogSurvey:
    """Look into a log.

    Parameters
    ----------
    path
        The MCAP file.
    whole
        Read all of it and count. Otherwise stop once the log is known to be usable and two seconds of it have passed,
        or before, where its summary tells that every topic was seen: a usable log costs little, an unusable one is
        read to its end.
    camera
        The image topic that is wanted; empty: any.
    calibrated, spaced
        Whether calibration or spacing come from elsewhere, and need not be found.
    allowance
        How far the log may unpack; None: as the default settings say.

    Raises
    ------
    InputError
        The file is no MCAP log or cannot be read.
    """
    survey = LogSurvey(path)
    expected = set() if whole else _expected_topics(path)
    decoders = Decoders()
    for record in scan(path, survey.scan, allowance):
        if isinstance(record, Metadata):
            _take_metadata(survey, record)
        elif isinstance(record, Attachment):
            if not calibrated:
                _take_attachment(survey, record)
        else:
            news = _take_message(survey, record, decoders)
            passed = record.log_time_ns - (survey.scan.first_log_ns or 0)
            if (
                not whole
                and (news or passed > _LONG_ENOUGH_NS)
                and _is_usable(survey, camera, calibrated, spaced)
                and (passed > _LONG_ENOUGH_NS or _has_all(survey, expected))
            ):
                break
    return survey


def topic_key(channel: Channel) -> tuple[str, str]:
    """What tells topics apart: name and schema."""
    return channel.topic, channel.schema_name


def _expected_topics(path: Path) -> set[tuple[str, str]]:
    try:
        with path.open("rb") as stream:
            summary = read_summary(stream)
    except OSError:
        return set()  # the scan says it better
    if summary is None:
        return set()
    return {
        topic_key(channel)
        for channel in summary.channels.values()
        if kind_of(channel) is not None and summary.message_counts.get(channel.id, 1)
    }


def _has_all(survey: LogSurvey, expected: set[tuple[str, str]]) -> bool:
    """Whether each expected topic was seen, once being enough; of transforms, many come on one topic."""
    if not expected or survey.of_kind(Kind.TRANSFORM):
        return False
    return expected <= survey.topics.keys()


def _take_message(survey: LogSurvey, message: Message, decoders: Decoders) -> bool:
    """Count a message; True where it tells something new."""
    channel = message.channel
    key = topic_key(channel)
    topic = survey.topics.get(key)
    if topic is None:
        topic = Topic(channel.topic, channel.schema_name, channel.encoding, kind_of(channel))
        topic.first_log_ns = message.log_time_ns
        survey.topics[key] = topic
    topic.count += 1
    topic.size += len(message.data)
    topic.last_log_ns = max(topic.last_log_ns, message.log_time_ns)
    if topic.kind is None or (topic.first is not None and topic.kind is not Kind.TRANSFORM):
        return False
    try:
        contents = decoders.decode(channel, message.data)
    except MessageError as error:
        topic.fault = topic.fault or str(error)
        return False
    for content in contents:
        if isinstance(content, CalibrationContent) and content.camera is None:
            topic.fault = topic.fault or content.why
            continue
        if isinstance(content, PoseContent) and topic.kind is Kind.TRANSFORM:
            survey.tree.add(content.time_ns or message.log_time_ns, content)
        if topic.first is None:
            topic.first, topic.first_log_ns = content, message.log_time_ns
    return True


def _take_metadata(survey: LogSurvey, record: Metadata) -> None:
    if record.name != METADATA_NAME:
        return
    try:
        spacing_m = float(record.values.get(SPACING_KEY, "0"))
    except ValueError:
        return
    if 0 < spacing_m < 1e4:
        survey.spacing_m = spacing_m
        survey.by_number = record.values.get(BY_NUMBER_KEY) == "yes"


def _take_attachment(survey: LogSurvey, record: Attachment) -> None:
    """Read an attached calibration: only a small YAML file that has its words, and none after the first."""
    is_yaml = record.name.lower().endswith((".yaml", ".yml")) or "yaml" in record.media_type
    if not is_yaml or survey.attached_camera is not None or len(record.data) > LARGEST_FILE:
        return
    if b"camera_matrix" not in record.data or survey.attachments_tried >= _MOST_ATTACHMENTS:
        return
    survey.attachments_tried += 1
    try:
        text = record.data.decode("utf-8")
        survey.attached_camera = parse_camera(text, record.name)
        survey.attachment_name = record.name
    except (UnicodeDecodeError, InputError):
        return  # some other YAML file


def _is_usable(survey: LogSurvey, camera: str, calibrated: bool, spaced: bool) -> bool:
    images = [
        t.first
        for t in survey.cameras
        if isinstance(t.first, ImageContent) and camera in ("", t.name)
    ]
    if not images:
        return False
    calibrated = calibrated or survey.attached_camera is not None
    if not (calibrated or any(t.first is not None for t in survey.of_kind(Kind.CALIBRATION))):
        return False
    if spaced or survey.spacing_m:
        return True
    if any(t.first is not None for t in survey.of_kind(Kind.POSE, Kind.ODOMETRY, Kind.FIX)):
        return True
    return any(survey.tree.moves(image.frame_id) for image in images)
