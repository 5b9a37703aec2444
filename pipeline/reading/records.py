"""Records of an MCAP file, read one after the other, even if the file is damaged.

The stock readers stop at the first fault or return damaged bytes. Here every length is checked before reading, and
every chunk's checksum before anything of it is returned. Reading continues after the damage. Neither footer nor summary
is needed.
"""

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Metadata, Schema, Statistics
from mcap.records import Channel as ChannelRecord

from wayside.pipeline.files.input_files import open_input
from wayside.pipeline.reading.layout import (
    ENDS,
    LAST_KNOWN,
    LATEST_NS,
    MAGIC,
    MESSAGE_HEAD,
    PARSED,
    RECORD_HEAD,
    Budget,
    Channel,
    LayoutError,
    RecordHead,
    parse_head,
    parse_record,
    read_summary,
    unpack_chunk,
)
from wayside.pipeline.reading.parts import LogParts, ScanReport, log_parts
from wayside.schemas.errors import InputError

__all__ = ["Attachment", "Message", "Metadata", "ScanReport", "messages_at", "scan"]

_LARGEST_ATTACHMENT = 1 << 20
"""Larger attachments are passed over unread: a calibration is a few hundred bytes."""
_WINDOW = 1 << 14
# Records shorter than four gigabytes. Messages and definitions stand in chunks as well: where there are chunks, what
# looks like one is the inside of a broken chunk.
_OUTSIDE_CHUNKS = re.compile(rb"[\x06\x09\x0c\x0f](?=.{4}\x00{4})", re.DOTALL)
_ANYWHERE = re.compile(rb"[\x03-\x06\x09\x0c\x0f](?=.{4}\x00{4})", re.DOTALL)


class Message(NamedTuple):
    """A message as recorded; `data` is a view into its chunk, `offset` where message or chunk stand in the log."""

    channel: Channel
    sequence: int
    log_time_ns: int
    data: memoryview
    offset: int


Content = Message | Metadata | Attachment


def scan(path: Path, report: ScanReport) -> Iterator[Content]:
    """Messages, metadata and small attachments of a log in file order; of a bag directory, one part after the other.

    Memory is bounded by the largest chunk (at most `LARGEST_RECORD`), time by the size of the log. Damage is counted in
    `report.problems` and skipped. A chunk with a wrong checksum, compression or inner length is lost as a whole, and so
    is a chunk that the end of the file cuts off. A wrong record length costs that record, and the one before where
    nothing else tells its length.

    Raises InputError where the file cannot be opened, is empty, or is no MCAP, or a directory is no ROS 2 bag of MCAP.
    """
    parts = log_parts(path)
    report.bytes_total, stated, budget = parts.size, [], Budget.of(parts.size)
    for file, start in zip(parts.files, parts.starts, strict=True):
        report.part = file.name if len(parts.files) > 1 else ""
        with _opened(file, report, budget, start) as scanner:
            yield from scanner.run()
            stated.append(scanner.messages_stated)
    report.part, report.bytes_read = "", report.bytes_total
    report.messages_stated = None if None in stated else sum(filter(None, stated))
    lost = (report.messages_stated or 0) - report.messages
    if lost > 0 and not report.problem_count:
        report.add_problem(
            report.bytes_total,
            f"{lost} messages lost: the summary counts {report.messages_stated}, {report.messages} were found",
        )


def messages_at(
    parts: LogParts, offset: int, channels: Iterable[Channel], budget: Budget
) -> list[Message]:
    """Messages of the one record at an offset of a log scanned before, of the channels known there.

    Raises InputError as `scan`, and where the record cannot be read any more, or only beyond the budget.
    """
    path, place = parts.at(offset)
    with _opened(path, ScanReport(bytes_read=place), budget, offset - place) as scanner:
        scanner.channels = {channel.id: channel for channel in channels}
        scanner.schemas = {c.schema_id: c.schema for c in scanner.channels.values() if c.schema}
        try:
            head = scanner.head_at(place)
            if head is None:
                raise LayoutError("no record begins here")
            return [one for one in scanner.content(head) if isinstance(one, Message)]
        except LayoutError as error:
            raise InputError(
                f"{path}: the messages at byte {place} cannot be read in the order of their times: {error}. "
                "Either the log changed while it was read, or it must be sorted by time first (mcap sort)."
            ) from error


@contextmanager
def _opened(path: Path, report: ScanReport, budget: Budget, start: int) -> "Iterator[_Scanner]":
    """One file, open; what the system refuses becomes an InputError."""
    try:
        stream = open_input(path)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(
            f"{path}: the log cannot be read: {reason or error}. Check the name."
        ) from error
    with stream:
        try:
            yield _Scanner(path, stream, report, budget, start)
        except OSError as error:
            raise InputError(
                f"{path}: reading stopped at byte {report.bytes_read}: {error.strerror or error}. "
                "Check the disk, or copy the file again."
            ) from error


class _Scanner:
    """One pass over one file, which begins at `base` of the log.

    A record that contradicts itself is lost, and so is what no record can be told in. Reading goes on where the record
    says that it ends, if another can begin there; else at the next record that can be recognised.
    """

    def __init__(
        self, path: Path, stream: BinaryIO, report: ScanReport, budget: Budget, base: int
    ) -> None:
        self.path, self.stream, self.report, self.base = path, stream, report, base
        self.size = os.fstat(stream.fileno()).st_size
        self.budget = budget
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.chunked = False
        self.messages_stated: int | None = None
        self.searched = 0
        self.undefined: dict[int, tuple[int, int]] = {}  # by channel: first message and count

    def run(self) -> Iterator[Content]:
        """All records that can be read, in file order."""
        self._check_magic()
        for record in read_summary(self.stream, self.size):
            self._define(record)
        whole = len(MAGIC)
        position: int | None = whole
        while position is not None and position < self.size:
            head = self.head_at(position)
            if head is not None and head.opcode in ENDS:
                self._look_behind(head)
                break
            try:
                if head is None or head.end > self.size:
                    raise LayoutError("no record can begin here")
                yield from self.content(head)
                position = whole = head.end
            except LayoutError as error:
                position = self._lose(position, head, error)
            self.report.bytes_read = self.base + (position or self.size)
        else:
            self.report.add_problem(
                whole,
                "the log ends without its end mark: the recording was cut off "
                f"{self.size - whole} bytes after its last complete record",
            )
        for channel_id, (start, count) in self.undefined.items():
            self.report.add_problem(
                start,
                f"{count} messages of channel {channel_id} lost: its definition, or that of its schema, is missing",
            )

    def _check_magic(self) -> None:
        found = self._bytes_at(0, len(MAGIC))
        if found == MAGIC and self.size > 2 * len(MAGIC):
            return
        what = f"a file that begins with {found!r}" if found else "an empty file"
        if found == MAGIC:
            what = "its file mark without any record"
        raise InputError(
            f"{self.path}: this is not an MCAP log but {what}. Make a log of ROS bags with `wayside join`, of "
            "numbered images with `wayside import`, and convert other recordings to MCAP."
        )

    def _look_behind(self, head: RecordHead) -> None:
        """Count bytes after the end mark, as in a file of two logs."""
        end: RecordHead | None = head
        while end is not None and end.opcode != Opcode.FOOTER:
            end = self.head_at(end.end)
        behind = self.size if end is None else end.end + len(MAGIC)
        if behind < self.size:
            self.report.add_problem(
                behind,
                f"{self.size - behind} bytes lost: they are after the end mark of the log; if they are another "
                "log, split the file there and use `wayside join`",
            )

    def content(self, head: RecordHead) -> Iterator[Content]:
        """What a record holds; raises LayoutError, before anything comes, where it contradicts itself."""
        opcode, report = head.opcode, self.report
        report.chunks += opcode == Opcode.CHUNK
        report.unknown_records += opcode > LAST_KNOWN
        unread = opcode > LAST_KNOWN or opcode == Opcode.MESSAGE_INDEX
        if unread or (opcode == Opcode.ATTACHMENT and head.end - head.start > _LARGEST_ATTACHMENT):
            self._check_length(head)
        elif opcode == Opcode.MESSAGE:
            self._check_length(head)
            yield from self._message(memoryview(self._content(head)), head.start, checked=False)
        elif opcode in PARSED:
            record, left = parse_record(opcode, memoryview(self._content(head)))
            if left:  # as fields to come may be
                self._check_length(head)
            if isinstance(record, Chunk):
                yield from self._chunk(record, head.start)
            elif isinstance(record, Metadata | Attachment):
                yield record
            else:
                self._define(record)
        else:
            raise LayoutError("records of its kind do not belong among messages")

    def _chunk(self, chunk: Chunk, start: int) -> Iterator[Message]:
        self.chunked = True
        found = unpack_chunk(chunk, self.budget)
        self.report.compressions[chunk.compression or "none"] += 1
        for opcode, inner in found:
            if opcode == Opcode.MESSAGE:
                yield from self._message(inner, start, checked=chunk.uncompressed_crc != 0)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(parse_record(opcode, inner)[0])

    def _message(self, content: memoryview, start: int, *, checked: bool) -> Iterator[Message]:
        """The message, if its channel and time are known."""
        channel_id, sequence, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content)
        channel = self.channels.get(channel_id)
        if channel is None:
            first, count = self.undefined.get(channel_id, (start, 0))
            self.undefined[channel_id] = first, count + 1
        elif log_time_ns >= LATEST_NS:
            self.report.add_problem(
                start, f"a message of {channel.topic} lost: its time is after the year 2116"
            )
        else:
            self.report.messages += 1
            self.report.unchecked_messages += not checked
            data = content[MESSAGE_HEAD.size :]
            yield Message(channel, sequence, log_time_ns, data, self.base + start)

    def _define(self, record: object) -> None:
        """Take in a definition; a channel whose schema is missing is not defined."""
        if isinstance(record, Statistics):
            self.messages_stated, self.chunked = record.message_count, record.chunk_count > 0
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, ChannelRecord):
            schema = self.schemas.get(record.schema_id)
            channel = Channel(
                record.id, record.topic, record.message_encoding, record.schema_id, schema
            )
            if schema is None and channel.schema_id:
                self.channels.pop(channel.id, None)
            elif self.channels.get(channel.id) != channel:  # some writers repeat it in every chunk
                self.channels[channel.id] = channel

    def _lose(self, start: int, head: RecordHead | None, error: LayoutError) -> int | None:
        """Report what is lost from `start` on, where `head` stands if any can; where to go on, None: nowhere.

        Within what one damaged length covers only the first such record is searched, or the cost would be the square of
        the size.
        """
        kind, position = "record", None
        if head is None:
            position = self._find(start + 1)
        else:
            if head.opcode <= LAST_KNOWN:
                kind = Opcode(head.opcode).name.lower().replace("_", " ")
            if self._can_follow(head.end):
                position = head.end
            else:
                position = self._find(head.content if start >= self.searched else head.end)
                self.searched = max(self.searched, head.end)
        if position is not None:
            self.report.lost_chunks += kind == "chunk"
            self.report.add_problem(start, f"{kind} of {position - start} bytes lost: {error}")
        return position

    def _find(self, start: int) -> int | None:
        """Offset of the first record from `start` on behind which another can begin, or None."""
        pattern = _OUTSIDE_CHUNKS if self.chunked else _ANYWHERE
        while start < self.size:
            window = self._bytes_at(start, _WINDOW + RECORD_HEAD.size)
            for match in pattern.finditer(window):
                head = self.head_at(start + match.start())
                if head is not None and match.start() < _WINDOW and self._can_follow(head.end):
                    return head.start
            start += _WINDOW
        return None

    def _check_length(self, head: RecordHead) -> None:
        """Raise LayoutError where a record whose content does not tell how long it is cannot be as long as it says."""
        if not self._can_follow(head.end):
            raise LayoutError("no other record begins where it says that it ends")

    def _can_follow(self, offset: int) -> bool:
        """Whether a record can begin here, or too little is left of the file for one.

        Records of unknown kinds look like garbage: behind them another must begin.
        """
        head = self.head_at(offset)
        if head is None:
            return 0 <= self.size - offset < RECORD_HEAD.size
        return head.opcode <= LAST_KNOWN or self.head_at(head.end) is not None

    def head_at(self, offset: int) -> RecordHead | None:
        """Head of a record, None where none can begin; it may reach beyond the end."""
        return parse_head(self._bytes_at(offset, RECORD_HEAD.size), offset)

    def _bytes_at(self, offset: int, count: int) -> bytes:
        """This many bytes, or as many as there are."""
        self.stream.seek(min(offset, self.size))  # a damaged length leads beyond 2^63
        return self.stream.read(count)

    def _content(self, head: RecordHead) -> bytes:
        content = self._bytes_at(head.content, head.end - head.content)
        if len(content) < head.end - head.content:
            raise OSError("the file became shorter while it was read")
        return content
