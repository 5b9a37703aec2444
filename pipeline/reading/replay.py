"""Images of a log in the order they are wanted in, which may not be that of the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import fields

import numpy as np

from wayside.pipeline.reading.clocks import Integers
from wayside.pipeline.reading.layout import Budget
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import Message, ScanReport, messages_at
from wayside.pipeline.reading.survey import LogSurvey
from wayside.schemas.errors import InputError

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
        if offset not in kept:
            kept[offset] = [
                m
                for m in messages_at(parts, offset, survey.channels_at(offset), budget)
                if m.channel.topic == topic and survey.is_indexed(m.channel)
            ]
            while len(kept) > 1 and sum(map(_size, kept.values())) > _MOST_KEPT_BYTES:
                del kept[next(iter(kept))]
        found = kept[offset]
        place = row - int(np.searchsorted(offsets, offset))
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
