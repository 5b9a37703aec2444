"""Images of a log in the order they are wanted in, which may not be that of the file."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.clocks import Integers
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import Message, messages_at, scan
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.streams import ImageIndex
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
        Rows in the order wanted. All of them as in the file are read in one pass.
    report
        Filled while the messages are taken; in another order than the file's with what the survey came across.
    allowance
        How far the log may unpack; in another order, how far all of what is read again may.

    Raises
    ------
    InputError
        As `scan`; and a log that changed since, or so far out of order that reading it exceeds the allowance.
    """
    index = survey.images[topic]
    if len(order) == len(index.offset) and (np.diff(order) > 0).all():
        yield from _in_the_file(survey, topic, index, report, allowance)
        return
    for one in fields(ScanReport):
        setattr(report, one.name, _copied(getattr(survey.scan, one.name)))
    offsets = np.array(index.offset, np.int64)
    starts = np.flatnonzero(np.diff(offsets, prepend=-1) != 0)
    ends = np.append(starts[1:], len(offsets))
    # The log is known as a whole: what may come does not depend on the place in it.
    whole = replace(allowance, extra_bytes=allowance.extra_bytes + report.bytes_total)
    records = _Records(survey, topic, whole)
    for count, row in enumerate(order.tolist(), start=1):
        k = int(np.searchsorted(starts, row, side="right")) - 1
        report.bytes_read = report.bytes_total * count // len(order)
        found = records.at(int(offsets[row]))
        if len(found) != ends[k] - starts[k]:
            raise _changed(survey)
        yield row, found[row - int(starts[k])]


def _in_the_file(
    survey: LogSurvey, topic: str, index: ImageIndex, report: ScanReport, allowance: Allowance
) -> Iterator[tuple[int, Message]]:
    """All images in one pass; of a log that is still written, those that stood there before."""
    row = 0
    for record in scan(survey.path, report, allowance):
        if not (isinstance(record, Message) and _is_of(survey, topic, record)):
            continue
        if row == len(index.offset):
            report.add_problem(
                record.offset,
                f"the log grew while it was read: its first {row} images are used; run it again once it is written",
            )
            return
        if record.offset != index.offset[row]:
            raise _changed(survey)
        yield row, record
        row += 1
    if row < len(index.offset):
        raise _changed(survey)


def _is_of(survey: LogSurvey, topic: str, message: Message) -> bool:
    return message.channel.topic == topic and survey.is_indexed(message.channel)


def _changed(survey: LogSurvey) -> InputError:
    return InputError(
        f"{survey.path}: the log changed while it was read; run it again once it is written"
    )


class _Records:
    """Image messages of the records of a log by their offset, the latest ones kept."""

    def __init__(self, survey: LogSurvey, topic: str, allowance: Allowance) -> None:
        self.survey, self.topic, self.allowance = survey, topic, allowance
        self.parts = log_parts(survey.path)
        self.kept: OrderedDict[int, list[Message]] = OrderedDict()
        self.sizes: dict[int, int] = {}
        self.bytes = 0

    def at(self, offset: int) -> list[Message]:
        if offset in self.kept:
            self.kept.move_to_end(offset)
            return self.kept[offset]
        known = self.survey.channels_at(offset)
        found = messages_at(self.parts, offset, known, self.allowance)
        messages = [m for m in found if _is_of(self.survey, self.topic, m)]
        self.kept[offset] = messages
        # A message of a chunk keeps all of the chunk.
        self.sizes[offset] = max((memoryview(m.data.obj).nbytes for m in messages), default=0)
        self.bytes += self.sizes[offset]
        while len(self.kept) > 1 and self.bytes > _MOST_KEPT_BYTES:
            oldest, _ = self.kept.popitem(last=False)
            self.bytes -= self.sizes.pop(oldest)
        return messages


def _copied(value: object) -> object:
    """Counts and lists of their own, so that what is added later leaves the survey as it is."""
    if isinstance(value, Counter):
        return Counter(value)
    return list(value) if isinstance(value, list) else value
