"""Images of a log in the order they are wanted in, which may not be that of the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import fields, replace

import numpy as np

from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.clocks import Integers
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import Message, messages_at
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.survey import LogSurvey
from wayside.schemas.errors import InputError

_MOST_KEPT_BYTES = 1 << 26
"""Size of the records kept for further messages of them, the latest one apart."""


def image_messages(
    survey: LogSurvey, topic: str, order: Integers, report: ScanReport, allowance: Allowance
) -> Iterator[tuple[int, Message]]:
    """Image messages of a topic, each with its row in `survey.images`.

    Parameters
    ----------
    survey, topic
        Of the log, and the image topic.
    order
        Rows in the order wanted.
    report
        Filled with what the survey came across.
    allowance
        How far all of what is read may unpack.

    Raises
    ------
    InputError
        As `messages_at`: a log that changed since, or so far out of order that reading it exceeds the allowance.
    """
    scanned = deepcopy(survey.scan)
    for one in fields(ScanReport):
        setattr(report, one.name, getattr(scanned, one.name))
    index = survey.images[topic]
    offsets = np.array(index.offset, np.int64)
    # The log is known as a whole: what may come does not depend on the place in it.
    whole = replace(allowance, extra_bytes=allowance.extra_bytes + report.bytes_total)
    parts = log_parts(survey.path)
    wanted = Counter(offsets[order].tolist())
    kept: dict[int, list[Message]] = {}
    held = 0
    for count, row in enumerate(order.tolist(), start=1):
        report.bytes_read = report.bytes_total * count // len(order)
        offset = int(offsets[row])
        if offset not in kept:
            kept[offset] = [
                m
                for m in messages_at(parts, offset, survey.channels_at(offset), whole)
                if m.channel.topic == topic and survey.is_indexed(m.channel)
            ]
            held += _size(kept[offset])
            while len(kept) > 1 and held > _MOST_KEPT_BYTES:
                held -= _size(kept.pop(next(iter(kept))))
        found = kept[offset]
        place = row - int(np.searchsorted(offsets, offset))
        if place >= len(found) or found[place].log_time_ns != index.log_ns[row]:
            raise InputError(
                f"{survey.path}: the log changed while it was read; run it again once it is written"
            )
        yield row, found[place]
        wanted[offset] -= 1
        if not wanted[offset]:
            held -= _size(kept.pop(offset))
    if log_parts(survey.path).size > report.bytes_total:
        report.add_problem(
            report.bytes_total,
            "the log grew while it was read: what stood there before is used; run it again once it is written",
        )


def _size(messages: list[Message]) -> int:
    """Bytes that messages of one record keep: those of a chunk keep all of it."""
    return max((memoryview(m.data.obj).nbytes for m in messages), default=0)
