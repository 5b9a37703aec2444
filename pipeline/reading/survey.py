"""What a log holds: its topics with the first message of each that matters, times and positions of all messages."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from wayside.pipeline.reading.calibrations import parse_camera
from wayside.pipeline.reading.contents import (
    CalibrationContent,
    Content,
    ContentError,
    FixContent,
    ImageContent,
    PoseContent,
)
from wayside.pipeline.reading.image_headers import (
    format_and_size,
    format_word,
    frame_of,
    image_fault,
)
from wayside.pipeline.reading.messages import Decoders, Kind, kind_of
from wayside.pipeline.reading.records import Attachment, Message, Metadata, ScanReport, scan
from wayside.pipeline.reading.series import Series, TransformTree
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.stages.imaging import used_bits

METADATA_NAME, SPACING_KEY, BY_NUMBER_KEY = "wayside", "spacing_m", "by_number"
"""Metadata record by which `wayside import` tells the distance between images."""
NAMES_METADATA, DATES_METADATA = "wayside.image_names", "wayside.image_dates"
"""Metadata records of `wayside import`: name of each image's file, and when it was taken, by log time in ns."""

MOST_FRAMES = 32
"""Names of cameras in one topic; some write a name of its own into each image."""
_DEPTH = ("16UC1", "32FC1", "compressedDepth")


TopicKey = tuple[str, str]
"""What tells topics apart: name and schema."""


@dataclass(slots=True)
class Topic:
    """One topic: how much there is of it, how much can be used, its first usable message, and what the others lack.

    `first`: of images the first that decodes; where none does the first, with the reason in `flaw`. `bits`: those that
    its images of 16 bits use (0: none are). `frames`: `frame_id` of images, up to `MOST_FRAMES`, each with the number
    of images and those of the first and the last of them.
    """

    name: str
    schema: str
    encoding: str
    kind: Kind | None
    count: int = 0
    usable: int = 0
    failed: int = 0
    failed_offset: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    first: Content | None = None
    flaw: str = ""
    bits: int = 0
    fault: str = ""
    frames: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    @property
    def camera_frame(self) -> str:
        """The `frame_id` of most images; of as many, the first."""
        return max(self.frames, key=lambda name: self.frames[name][0], default="")

    @property
    def other_cameras(self) -> frozenset[str]:
        """Each `frame_id` of images that stand between those of `camera_frame`: two cameras share the topic.

        One that comes before or behind them all is a new name of the same camera; an empty one tells nothing, nor do
        more than a rig has cameras.
        """
        own = self.camera_frame
        if not own or len(self.frames) >= MOST_FRAMES:
            return frozenset()
        _, begin, end = self.frames[own]
        between = (n for n, (_, first, last) in self.frames.items() if last > begin and first < end)
        return frozenset(n for n in between if n not in ("", own))

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height of the first image, None where it does not tell."""
        image = self.first
        size = format_and_size(image)[1:] if isinstance(image, ImageContent) else (0, 0)
        return size if size[0] else None

    @property
    def image_format(self) -> str:
        """Encoding of the first image, in a word."""
        return format_word(getattr(self.first, "encoding", "unknown"))


@dataclass(slots=True)
class LogSurvey:
    """What was found in a log.

    `images`: of each image topic, of `camera` alone where that is chosen. `calibrations`, `positions`: of each topic
    and schema, the former with log and header time. `tree`: of all transforms.
    """

    path: Path
    camera: str = ""
    scan: ScanReport = field(default_factory=ScanReport)
    topics: dict[TopicKey, Topic] = field(default_factory=dict)
    images: dict[str, Series] = field(default_factory=dict)
    calibrations: dict[TopicKey, list[tuple[int, int, CalibrationContent]]] = field(
        default_factory=dict
    )
    positions: dict[TopicKey, Series] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    attached: tuple[str, Camera] | None = None
    spacing_m: float = 0.0
    by_number: bool = False
    image_names: dict[str, str] = field(default_factory=dict)
    image_dates: dict[str, str] = field(default_factory=dict)

    def of_kind(self, *kinds: Kind) -> list[Topic]:
        """Topics of some kinds, by name."""
        return sorted((t for t in self.topics.values() if t.kind in kinds), key=lambda t: t.name)

    @property
    def cameras(self) -> list[Topic]:
        """Topics of camera images, depth images excluded, by name."""
        images = [(t, getattr(t.first, "encoding", "")) for t in self.of_kind(Kind.IMAGE)]
        return [topic for topic, encoding in images if not any(d in encoding for d in _DEPTH)]


def survey_log(path: Path, camera: str = "") -> LogSurvey:
    """Read all of a log, in memory that holds no images, and tell what is in it.

    `camera`: the image topic that is wanted; empty: any. Raises InputError where the file is no MCAP log or cannot be
    read.
    """
    survey = LogSurvey(path, camera)
    decoders = Decoders()
    for record in scan(path, survey.scan):
        if isinstance(record, Metadata):
            _take_metadata(survey, record)
        elif isinstance(record, Attachment):
            _take_attachment(survey, record)
        else:
            _take_message(survey, record, decoders)
    return survey


def _take_message(survey: LogSurvey, message: Message, decoders: Decoders) -> None:
    """Count a message, decode it, and note its times and positions."""
    channel = message.channel
    key = channel.topic, channel.schema_name
    topic = survey.topics.get(key)
    if topic is None:
        topic = Topic(channel.topic, channel.schema_name, channel.encoding, kind_of(channel))
        survey.topics[key] = topic
    first = topic.first_log_ns if topic.count else message.log_time_ns
    topic.first_log_ns = min(first, message.log_time_ns)
    topic.count += 1
    topic.last_log_ns = max(topic.last_log_ns, message.log_time_ns)
    is_image = topic.kind is Kind.IMAGE
    is_wanted = is_image and survey.camera in ("", channel.topic)
    if topic.kind is None or (is_image and topic.first is not None and not is_wanted):
        return
    contents: Sequence[Content] = ()
    try:
        contents = decoders.decode(channel, message.data)
    except ContentError as error:
        _fail(topic, message.offset, str(error))
    if is_wanted:
        index = survey.images.setdefault(channel.topic, Series())
        index.stamp(message.log_time_ns, contents[0].time_ns if contents else None)
        index.offset.append(message.offset)
        index.channels.append(channel)
    for content in contents:
        _take_content(survey, topic, key, message, content)


def _take_content(
    survey: LogSurvey, topic: Topic, key: TopicKey, message: Message, content: Content
) -> None:
    if isinstance(content, CalibrationContent):
        if not (content.raw or content.rectified):
            _fail(topic, message.offset, content.why)
            return
        track = survey.calibrations.setdefault(key, [])
        untimed = replace(content, time_ns=None)
        same = track[-1][2] if track and track[-1][2] == untimed else untimed  # kept once
        track.append((message.log_time_ns, content.time_ns or 0, same))
    elif isinstance(content, ImageContent):
        count, first, _ = topic.frames.get(content.frame_id, (0, topic.usable, 0))
        if count or len(topic.frames) < MOST_FRAMES:
            topic.frames[content.frame_id] = count + 1, first, topic.usable
        if content.width:
            topic.bits = max(topic.bits, used_bits(frame_of(content)))
        if topic.first is None or (topic.flaw and not image_fault(content)):
            topic.first, topic.flaw = content, image_fault(content)
    elif topic.kind is Kind.TRANSFORM and isinstance(content, PoseContent):
        survey.tree.add(message.log_time_ns, content)
    else:
        if isinstance(content, FixContent):
            key = key[0], ""  # fixes of one topic are one stream, whatever their schemas
        survey.positions.setdefault(key, Series()).add(message.log_time_ns, content)
    topic.usable += 1
    topic.first = topic.first or content


def _fail(topic: Topic, offset: int, why: str) -> None:
    topic.failed += 1
    if topic.failed == 1:
        topic.fault, topic.failed_offset = why, offset


def _take_metadata(survey: LogSurvey, record: Metadata) -> None:
    texts = {NAMES_METADATA: survey.image_names, DATES_METADATA: survey.image_dates}
    texts.get(record.name, {}).update(record.metadata)
    if record.name != METADATA_NAME:
        return
    try:
        spacing_m = float(record.metadata.get(SPACING_KEY, "0"))
    except ValueError:
        return
    if 0 < spacing_m < 1e4:
        survey.spacing_m = spacing_m
        survey.by_number = record.metadata.get(BY_NUMBER_KEY) == "yes"


def _take_attachment(survey: LogSurvey, record: Attachment) -> None:
    """Read an attached calibration: a text with its words, and none after the first."""
    if b"camera_matrix" not in record.data or survey.attached is not None:
        return
    with suppress(UnicodeDecodeError, InputError):  # some other file
        survey.attached = record.name, parse_camera(record.data.decode("utf-8"), record.name)
