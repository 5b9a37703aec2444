"""Messages of a log in the order they are wanted in, which may not be that of the file."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from wayside.pipeline.reading.records import Message, ScanReport, messages_at, scan
from wayside.pipeline.reading.stamps import Integers
from wayside.pipeline.reading.survey import LogSurvey

_MOST_KEPT_BYTES = 1 << 26
"""Size of the records kept for further messages of them, the latest one apart."""


def messages_of(
    survey: LogSurvey, order: Integers | None, report: ScanReport
) -> Iterator[tuple[int, Message]]:
    """Messages that have a row in `survey.stamps`, each with the number of that row.

    Parameters
    ----------
    survey
        Of the log.
    order
        (m,) row numbers in the order wanted; None: as in the file, in one pass.
    report
        Filled while the messages are taken; in another order than the file's with what the survey came across.
    """
    if order is None:
        number = 0
        for record in scan(survey.path, report):
            if isinstance(record, Message) and survey.is_stamped(record.channel):
                yield number, record
                number += 1
        return
    for one in fields(ScanReport):
        setattr(report, one.name, _copied(getattr(survey.scan, one.name)))
    offsets = np.array(survey.stamps.offset, np.int64)
    starts = np.flatnonzero(np.diff(offsets, prepend=-1) != 0)
    records = _Records(survey)
    for count, row in enumerate(order.tolist(), start=1):
        start = int(starts[np.searchsorted(starts, row, side="right") - 1])
        report.bytes_read = report.bytes_total * count // len(order)
        yield row, records.at(int(offsets[row]))[row - start]


class _Records:
    """Records of a log by their offset, the latest ones kept."""

    def __init__(self, survey: LogSurvey) -> None:
        self.survey = survey
        self.kept: OrderedDict[int, list[Message]] = OrderedDict()
        self.sizes: dict[int, int] = {}
        self.bytes = 0

    def at(self, offset: int) -> list[Message]:
        if offset in self.kept:
            self.kept.move_to_end(offset)
            return self.kept[offset]
        found = messages_at(self.survey.path, offset, self.survey.channels)
        messages = [m for m in found if self.survey.is_stamped(m.channel)]
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
