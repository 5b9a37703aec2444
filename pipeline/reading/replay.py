"""Messages of a log in the order they are wanted in, which may not be that of the file."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import Message, messages_at, scan
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.stamps import Integers
from wayside.pipeline.reading.survey import LogSurvey
from wayside.schemas.errors import InputError

_MOST_KEPT_BYTES = 1 << 26
"""Size of the records kept for further messages of them, the latest one apart."""


def messages_of(
    survey: LogSurvey, order: Integers | None, report: ScanReport, allowance: Allowance
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
    allowance
        How far the log may unpack; in another order, how far all of what is read again may.

    Raises
    ------
    InputError
        As `scan`; and a log so far out of order that reading it in another exceeds the allowance, or changed meanwhile.
    """
    if order is None:
        yield from _as_in_the_file(survey, report, allowance)
        return
    for one in fields(ScanReport):
        setattr(report, one.name, _copied(getattr(survey.scan, one.name)))
    offsets = np.array(survey.stamps.offset, np.int64)
    starts = np.flatnonzero(np.diff(offsets, prepend=-1) != 0)
    ends = np.append(starts[1:], len(offsets))
    # The log is known as a whole: what may come does not depend on the place in it.
    whole = replace(allowance, extra_bytes=allowance.extra_bytes + report.bytes_total)
    records = _Records(survey, whole)
    for count, row in enumerate(order.tolist(), start=1):
        k = int(np.searchsorted(starts, row, side="right")) - 1
        report.bytes_read = report.bytes_total * count // len(order)
        found = records.at(int(offsets[row]))
        if len(found) != ends[k] - starts[k]:
            raise InputError(
                f"{survey.path}: wanted {ends[k] - starts[k]} messages at byte {offsets[row]} once more, found "
                f"{len(found)}; leave the log alone while it is read, or sort it by time first (mcap sort)"
            )
        yield row, found[row - int(starts[k])]


def _as_in_the_file(
    survey: LogSurvey, report: ScanReport, allowance: Allowance
) -> Iterator[tuple[int, Message]]:
    """The messages of the survey in one pass; of a log that is still written, those that stood there then."""
    known = survey.stamps.offset
    messages = (r for r in scan(survey.path, report, allowance) if isinstance(r, Message))
    for number, message in enumerate(m for m in messages if survey.is_stamped(m.channel)):
        if number == len(known):
            report.add_problem(
                message.offset,
                f"the log grew while it was read: its first {number} messages are used; run it again once "
                "it is written",
            )
            return
        if message.offset != known[number]:
            raise InputError(
                f"{survey.path}: wanted message {number} at byte {known[number]} once more, found it at byte "
                f"{message.offset}; leave the log alone while it is read"
            )
        yield number, message


class _Records:
    """Records of a log by their offset, the latest ones kept."""

    def __init__(self, survey: LogSurvey, allowance: Allowance) -> None:
        self.survey, self.allowance = survey, allowance
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
