"""Images of one camera, of a video too, whose pictures depend on earlier ones: in order, or as they are wanted."""

from collections import Counter
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import fields, replace
from typing import Any

import numpy as np

from wayside.pipeline.reading.clocks import Integers
from wayside.pipeline.reading.contents import ContentError, ImageContent
from wayside.pipeline.reading.h264 import H264, SequenceSet, read_stream
from wayside.pipeline.reading.image_headers import frame_of
from wayside.pipeline.reading.layout import Budget
from wayside.pipeline.reading.messages import Decoders
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.plan import Plan
from wayside.pipeline.reading.records import Message, ScanReport, messages_at
from wayside.pipeline.reading.survey import LogSurvey
from wayside.schemas.errors import InputError
from wayside.schemas.frame import (
    NO_KEY_FRAME,
    OTHER_CAMERA,
    UNDECODABLE,
    USED,
    WRONG_SIZE,
    Camera,
    Image,
)
from wayside.stages.imaging import colorfulness, decode

_BLOCK = 32
"""Pixels that a coded picture may be larger than the one shown: two rows of macroblocks, of a frame of two fields."""
_IMAGES = 9
"""Spread over the log; of a video, which is decoded from its start, the first ones."""
_COLORLESS = 0.07
"""Most colour of a grey camera's images: noise and casts give up to 0.05, colour cameras at least 0.10, in fog, too."""
_MOST_KEPT_BYTES = 1 << 25
"""Size of the records kept for further messages of them, the latest one apart."""


class CameraImages:
    """Unpacks the images of a camera, and decodes those of an H.264 stream.

    Nothing is decoded before the first key frame. Where numbers of the pictures show that one is missing, or one does
    not decode, the decoder would return wrong pictures silently. No picture is given until the next key frame. Pictures
    that refer to later ones (B) are not decoded: `foxglove.CompressedVideo` excludes them.
    """

    def __init__(self, other_cameras: frozenset[str]) -> None:
        self.without_key, self.both_ways = 0, 0
        self._others = other_cameras
        self._messages = Decoders()
        self._context: Any = None
        self._sequence: SequenceSet | None = None
        self._reference: int | None = None
        """Number of the last picture that others refer to; None: wait for a key frame."""

    def image(
        self, message: Message, camera: Camera | None, *, after_loss: bool = False
    ) -> tuple[str, ImageContent]:
        """Status of the image of a message, and what is known of it; rows of rgb8 of a picture of a video.

        `after_loss`: something of the log before it was lost, which may have been pictures.
        """
        if after_loss:
            self._reference = None
        try:
            (image,) = self._messages.decode(message.channel, message.data)
        except ContentError:
            return UNDECODABLE, ImageContent(None, "", "", memoryview(b""))
        assert isinstance(image, ImageContent)
        if image.frame_id in self._others:
            return OTHER_CAMERA, image
        if image.encoding != H264:
            return USED, image
        return self.picture(image, None if camera is None else (camera.width, camera.height))

    def picture(
        self, image: ImageContent, size: tuple[int, int] | None
    ) -> tuple[str, ImageContent]:
        """The same of a picture; of another `size` none is decoded."""
        reference, self._reference = self._reference, None
        try:
            self._sequence, head = read_stream(image.data, self._sequence)
        except ValueError:
            return UNDECODABLE, image
        sequence = self._sequence
        if sequence is None or head is None or head.both_ways:
            self._reference = reference
            self.both_ways += head is not None
            self.without_key += head is None
            return (UNDECODABLE if head else NO_KEY_FRAME), image
        if not head.key:
            # Every picture since the last that was decoded was there, and this one was not.
            rises = reference is not None and (head.number - reference) % sequence.modulus == 1
            if reference is None or not (rises or sequence.gaps):
                self.without_key += 1
                return NO_KEY_FRAME, image
        if size not in (None, sequence[:2]):
            return WRONG_SIZE, image
        if head.key:
            self._context = new_context(sequence)
        rows = _rows(self._context, image.data, sequence)
        if rows is None:
            return UNDECODABLE, image
        self._reference = head.number if head.referred else reference
        size = sequence.width, sequence.height
        return USED, ImageContent(image.time_ns, image.frame_id, "rgb8", rows, *size)

    def notes(self) -> Iterator[str]:
        """What of the video has no picture, in words."""
        if self.without_key:
            yield (
                f"images of the video without a key frame before them, or behind a missing one: {self.without_key} "
                f"(status {NO_KEY_FRAME}); they are not used"
            )
        if self.both_ways:
            yield (
                f"B-pictures in the video: {self.both_ways}; they refer to later images, which the schema excludes, "
                "and are not decoded: encode without them (x264: bframes=0)"
            )


def _rows(context: Any, data: memoryview, sequence: SequenceSet) -> memoryview | None:
    """Pixels of a picture, None where it does not decode."""
    import av

    try:
        frames = context.decode(av.Packet(bytes(data)))
    except av.FFmpegError:
        return None
    if len(frames) != 1 or frames[0].is_corrupt:
        return None
    pixels = frames[0].to_ndarray(format="rgb24")
    fits = pixels.shape[:2] == (sequence.height, sequence.width)
    return pixels.reshape(-1).data if fits else None


def new_context(sequence: SequenceSet) -> Any:
    """A decoder that gives each picture at once, in one thread, and none larger than the sequence set says.

    A stream may hold several sequence sets and mean another one than the last.
    """
    import av

    context = av.CodecContext.create(H264, "r")
    context.options = {"max_pixels": str((sequence.width + _BLOCK) * (sequence.height + _BLOCK))}
    context.flags |= av.codec.context.Flags.low_delay
    context.thread_count = 1
    return context


def image_messages(
    survey: LogSurvey, topic: str, order: Integers, report: ScanReport
) -> Iterator[tuple[int, Message]]:
    """Image messages of a topic, each with its row in `survey.images`; `order`: rows in the order wanted.

    `report`: filled with what the survey came across. Raises InputError as `messages_at`: for a log that changed since,
    or so far out of order that reading it costs too much.
    """
    scanned = deepcopy(survey.scan)
    for one in fields(ScanReport):
        setattr(report, one.name, getattr(scanned, one.name))
    index = survey.images[topic]
    offsets = np.array(index.offset, np.int64)
    budget = Budget.of(report.bytes_total)
    parts = log_parts(survey.path)
    wanted = Counter(offsets[order].tolist())
    kept: dict[int, list[Message]] = {}
    for count, row in enumerate(order.tolist(), start=1):
        report.bytes_read = report.bytes_total * count // len(order)
        offset = int(offsets[row])
        first, end = np.searchsorted(offsets, offset), np.searchsorted(offsets, offset, "right")
        if offset not in kept:
            channels = index.channels[first:end]
            held = messages_at(parts, offset, channels, budget)
            kept[offset] = [message for message in held if message.channel in channels]
            while len(kept) > 1 and sum(map(_size, kept.values())) > _MOST_KEPT_BYTES:
                del kept[next(iter(kept))]
        found = kept[offset]
        place = row - int(first)
        if place >= len(found) or found[place].log_time_ns != index.log_ns[row]:
            raise InputError(
                f"{survey.path}: the log changed while it was read; run again once it is complete"
            )
        yield row, found[place]
        wanted[offset] -= 1
        if not wanted[offset]:
            del kept[offset]
    if log_parts(survey.path).size > report.bytes_total:
        report.add_problem(
            report.bytes_total,
            "the log grew while it was read: what was there before is used; run again once it is complete",
        )


def _size(messages: list[Message]) -> int:
    """Bytes that messages of one record keep: those of a chunk keep all of it."""
    return max((memoryview(m.data.obj).nbytes for m in messages), default=0)


def decoded_images(
    plan: Plan, rows: Integers, cameras: Sequence[Camera | None], images: CameraImages
) -> Iterator[tuple[int, Image]]:
    """Images with their rows, in the order given; those without pixels are not used."""
    for row, message in image_messages(plan.survey, plan.camera.name, rows, ScanReport()):
        status, content = images.image(message, cameras[row])
        (image,) = decode(iter([replace(frame_of(content), status=status, camera=cameras[row])]))
        yield row, image


def is_grey(plan: Plan, order: Integers, cameras: Sequence[Camera | None]) -> bool:
    """Whether none of some images shows colour, and at least one has pixels; mostly the first one tells."""
    of_video = plan.camera.image_format == H264
    places = np.arange(len(order)) if of_video else np.linspace(0, len(order) - 1, _IMAGES)
    rows = order[np.unique(places.astype(int))[:_IMAGES]]
    seen = False
    for _, image in decoded_images(plan, rows, cameras, CameraImages(plan.other_cameras)):
        if image.rgb is not None:
            seen = True
            if colorfulness(image.rgb) > _COLORLESS:
                return False
    return seen
