"""One pass over the records of an MCAP file: what each is, and how reading goes on behind damage."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.chunks import (
    find_records,
    parse_chunk_head,
    take_records,
    unpack_chunk,
)
from wayside.pipeline.reading.definitions import Definitions
from wayside.pipeline.reading.layout import (
    ENDS,
    LAST_KNOWN,
    LATEST_NS,
    MAGIC,
    MESSAGE_HEAD,
    PARSED,
    Attachment,
    Channel,
    LayoutError,
    Metadata,
    parse_record,
)
from wayside.pipeline.reading.resync import LARGEST_ATTACHMENT, RecordFinder, RecordHead
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.summary import read_summary
from wayside.schemas.errors import InputError


class Message(NamedTuple):
    """A message as recorded; `data` is a view into its chunk, `offset` where message or chunk stand in the file."""

    channel: Channel
    sequence: int
    log_time_ns: int
    data: memoryview
    offset: int


class Scanner:
    """One pass over one file.

    A record that contradicts itself is lost, and so is what no record can be told in. Reading goes on where the record
    says that it ends, if another begins there; else at the next record that can be recognised.
    """

    def __init__(
        self,
        path: Path,
        stream: BinaryIO,
        report: ScanReport,
        allowance: Allowance,
        base: int = 0,
        part: str = "",
    ) -> None:
        """`base`: where the file begins in the log; `part`: its name where it is not all of the log."""
        self.path, self.report, self.allowance = path, report, allowance
        self.base, self.part = base, part
        self.size = os.fstat(stream.fileno()).st_size
        self.definitions = Definitions(self._tell)
        self.finder = RecordFinder(stream, self.definitions.channels, self.size)
        self.messages_stated: int | None = None
        self.searched = 0

    def _tell(self, offset: int, what: str) -> None:
        self.report.add_problem(offset, what, self.part)

    def messages_at(self, offset: int) -> list[Message]:
        """Messages of the one record that stands at an offset, as `run` gives them; raises LayoutError."""
        head = self.finder.head_at(offset)
        if head is None:
            raise LayoutError("no record begins here")
        return [one for one in self._record(head) if isinstance(one, Message)]

    def run(self) -> Iterator[Message | Metadata | Attachment]:
        """All records that can be read, in file order."""
        self._check_magic()
        summary = read_summary(self.finder.stream, self.size)
        if summary is not None:
            self.finder.end, self.finder.cut = summary.start, False
            self.finder.chunked = bool(summary.chunks)
            self.messages_stated = summary.messages
            self.definitions.expect(summary)
        finder, position = self.finder, len(MAGIC)
        whole = position
        while position < finder.end:
            head = finder.head_at(position)
            if head is not None and head.opcode in ENDS:
                self._look_behind(head)
                break
            if head is None or (head.end > finder.end and not self._is_cut_chunk(head)):
                position = self._step_over(position)
                continue
            try:
                if head.opcode == Opcode.MESSAGE:
                    self._check_length(head)
                    finder.chunked = False
                yield from self._record(head)
                position = head.end
                whole = whole if position > finder.end else position
            except LayoutError as error:
                position = self._lose(head, error)
            self.report.bytes_read = self.base + min(position, self.size)
        else:
            if finder.cut:
                rest = f" {self.size - whole} bytes behind its last whole record"
                self._tell(
                    whole,
                    f"the log ends without its end mark: the recording was cut off{rest if whole < self.size else ''}",
                )
        self.definitions.tell_lost()

    def _check_magic(self) -> None:
        found = bytes(self.finder.bytes_at(0, len(MAGIC)))
        if found != MAGIC:
            what = f"a file that begins with {found!r}" if found else "an empty file"
            raise InputError(
                f"{self.path}: wanted an MCAP log, found {what}; make a log of ROS bags with `wayside join`, "
                "of numbered images with `wayside import`, and convert other recordings to MCAP"
            )
        if self.size <= 2 * len(MAGIC):
            raise InputError(
                f"{self.path}: wanted an MCAP log, found its file mark without any record; "
                "the recording stopped before anything was written: use another"
            )

    def _record(self, head: RecordHead) -> Iterator[Message | Metadata | Attachment]:
        """What a record holds; raises LayoutError, before anything comes, where it contradicts itself."""
        opcode = head.opcode
        if opcode == Opcode.CHUNK:
            yield from self._chunk(head)
        elif opcode == Opcode.MESSAGE:
            message = self._message(self._content(head), head.start, checked=False)
            if message is not None:
                yield message
        elif opcode in PARSED and (
            opcode != Opcode.ATTACHMENT or head.length <= LARGEST_ATTACHMENT
        ):
            content = self._content(head)
            record, left = parse_record(opcode, content)
            if left:  # as fields to come may be
                self._check_length(head)
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.definitions.add(opcode, content, head.start, checked=False)
            elif opcode == Opcode.METADATA:
                yield Metadata(record.name, record.metadata)
            elif opcode == Opcode.ATTACHMENT:
                yield record
        elif opcode > LAST_KNOWN or opcode in (Opcode.ATTACHMENT, Opcode.MESSAGE_INDEX):
            self._check_length(head)
            self.report.unknown_records += opcode > LAST_KNOWN
        else:
            raise LayoutError("records of its kind have no place among messages")

    def _check_length(self, head: RecordHead) -> None:
        """Raise LayoutError where a record whose content does not tell how long it is cannot be as long as it says."""
        if not self.finder.follows(head.end):
            raise LayoutError("no other record begins where it says that it ends")

    def _chunk(self, head: RecordHead) -> Iterator[Message]:
        """Messages of a chunk; of one that the end of the file cuts off those that stand whole before the cut."""
        report, cut = self.report, head.end > self.finder.end
        report.chunks += 1
        content = self._content(head)
        chunk = parse_chunk_head(content, head.length)
        self.finder.chunked = True
        read = min(head.end, self.size)
        self.allowance.take_bytes(chunk.unpacked_size, read)
        data = unpack_chunk(chunk, content[chunk.size :], whole=not cut)
        offsets, fault = find_records(data, self.allowance.records_left(read))
        if fault and not cut:
            raise LayoutError(fault)
        self.allowance.records += len(offsets)
        report.compressions[chunk.compression or "none"] += 1
        checked = chunk.checksum != 0 and not cut
        for opcode, inner in take_records(data, offsets):
            if opcode == Opcode.MESSAGE:
                message = self._message(inner, head.start, checked=checked)
                if message is not None:
                    yield message
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.definitions.add(opcode, inner, head.start, checked=checked)
            else:
                report.unknown_records += 1

    def _message(self, content: memoryview, start: int, *, checked: bool) -> Message | None:
        channel_id, sequence, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content)
        channel = self.definitions.channels.get(channel_id)
        if channel is None:
            self.definitions.lose_message(channel_id, start)
            return None
        if log_time_ns >= LATEST_NS:
            self._tell(start, f"a message of {channel.topic} lost: its time is after the year 2116")
            return None
        self.report.add_message(log_time_ns, checked=checked)
        return Message(
            channel, sequence, log_time_ns, content[MESSAGE_HEAD.size :], self.base + start
        )

    def _lose(self, head: RecordHead, error: LayoutError) -> int:
        """Report a record that is lost; where to go on.

        Within what one damaged length covers only the first such record is searched, or the cost would be the square of
        the size.
        """
        finder = self.finder
        position: int | None = head.end
        wrong_length = head.opcode == Opcode.CHUNK and not finder.is_chunk(head)
        if wrong_length or not finder.follows(head.end):
            position = finder.find(head.content if head.start >= self.searched else head.end)
            self.searched = max(self.searched, head.end)
        position = finder.end if position is None else position
        self.report.lost_chunks += head.opcode == Opcode.CHUNK
        kind = (
            Opcode(head.opcode).name.lower().replace("_", " ")
            if head.opcode <= LAST_KNOWN
            else "record"
        )
        self._tell(head.start, f"{kind} of {position - head.start} bytes lost: {error}")
        return position

    def _step_over(self, start: int) -> int:
        """Where to go on behind bytes in which no record can begin."""
        found = self.finder.find(start + 1)
        position = self.finder.end if found is None else found
        if found is not None or not self.finder.cut:
            self._tell(start, f"{position - start} bytes lost: no record can begin here")
        return position

    def _is_cut_chunk(self, head: RecordHead) -> bool:
        """Whether the end of the file cuts off a chunk: none of what stands behind its head is a record of the file."""
        if not (self.finder.cut and self.finder.is_chunk(head)):
            return False
        self.finder.chunked = True
        return self.finder.find(head.start + 1) is None

    def _content(self, head: RecordHead) -> memoryview:
        """Content of a record up to the end of the file, whose size says that it is there."""
        count = min(head.length, self.size - head.content)
        content = self.finder.bytes_at(head.content, count)
        if len(content) < count:
            raise OSError("the file became shorter while it was read")
        return content

    def _look_behind(self, head: RecordHead) -> None:
        """Tell of bytes behind the end mark."""
        end: RecordHead | None = head
        while end is not None and end.opcode != Opcode.FOOTER:
            end = self.finder.head_at(end.end)
        behind = self.size if end is None else end.end + len(MAGIC)
        if behind < self.size:
            self._tell(
                behind,
                f"{self.size - behind} bytes lost: they stand behind the end mark of the log; "
                "if they are another log, part the file there and use `wayside join`",
            )
