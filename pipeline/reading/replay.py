"""Images of a log in the order they are wanted in; whether its camera sees colour."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import fields, replace

import numpy as np

from wayside.pipeline.reading.clocks import Integers
from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.image_headers import frame_of
from wayside.pipeline.reading.layout import Budget
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.plan import Plan
from wayside.pipeline.reading.records import Message, ScanReport, messages_at
from wayside.pipeline.reading.survey import LogSurvey
from wayside.pipeline.reading.video import CameraImages
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera, Image
from wayside.stages.imaging import colorfulness, decode

_IMAGES = 9
"""Spread over the log; of a video, which is decoded from its start, the first ones."""
_COLORLESS = 0.07
"""Most colour of a grey camera's images: noise and casts give up to 0.05, colour cameras at least 0.10, in fog, too."""
_MOST_KEPT_BYTES = 1 << 25
"""Size of the records kept for further messages of them, the latest one apart."""


def image_messages(
    survey: LogSurvey, topic: str, order: Integers, report: ScanReport
) -> Iterator[tuple[int, Message]]:
    """Image messages of a topic, each with its row in `survey.images`; `order`: rows in the order wanted.

    report: filled with what the survey came across. Raises InputError as `messages_at`: for a log that changed since,
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
                f"{survey.path}: the log changed while it was read; run it again once it is written"
            )
        yield row, found[place]
        wanted[offset] -= 1
        if not wanted[offset]:
            del kept[offset]
    if log_parts(survey.path).size > report.bytes_total:
        report.add_problem(
            report.bytes_total,
            "the log grew while it was read: what stood there before is used; run it again once it is written",
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
        frame = replace(frame_of(content), status=status, camera=cameras[row])
        (image,) = decode(iter([frame]))
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
