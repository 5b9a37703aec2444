"""Records of an MCAP file, read one after the other, whatever state the file is in.

The stock readers stop at the first fault or hand on damaged bytes; here every length is checked before anything is
read, every chunk's checksum is checked before anything of it is handed on, and reading goes on behind the damage.
Layout and opcodes: MCAP specification, https://mcap.dev/spec. Neither footer nor summary is needed.
"""

from __future__ import annotations

import os
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from wayside.pipeline.reading.chunks import (
    LARGEST_HEAD,
    ChunkError,
    ChunkHead,
    parse_chunk_head,
    unpack_chunk,
)
from wayside.pipeline.reading.layout import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    LAST_KNOWN,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    METADATA,
    RECORD_HEAD,
    SCHEMA,
    Attachment,
    Channel,
    LayoutError,
    Metadata,
    Schema,
    length_is_plausible,
    parse_attachment,
    parse_channel,
    parse_metadata,
    parse_schema,
)
from wayside.pipeline.reading.resync import find_record, follows_a_record, is_chunk
from wayside.pipeline.reading.summary import has_data_checksum, read_summary
from wayside.schemas.errors import InputError

LARGEST_ATTACHMENT = 1 << 20
"""Larger attachments are passed over unread: a calibration is a few hundred bytes."""

MOST_PROBLEMS = 200
"""Problems kept in words; further ones are counted only, so that a hopeless file cannot fill the memory."""


class Message(NamedTuple):
    """A message as recorded; `data` is a view into its chunk, `offset` where message or chunk stand in the file."""

    channel: Channel
    sequence: int
    log_time_ns: int
    data: memoryview
    offset: int


@dataclass(frozen=True, slots=True)
class Problem:
    """Something in the log that could not be used, where it begins, and what it cost."""

    offset: int
    what: str

    def __str__(self) -> str:
        """One line for a person."""
        return f"at byte {self.offset}: {self.what}"


@dataclass(slots=True)
class ScanReport:
    """What a scan came across, filled while it runs."""

    bytes_total: int = 0
    bytes_read: int = 0
    messages: int = 0
    chunks: int = 0
    lost_chunks: int = 0
    compressions: Counter[str] = field(default_factory=Counter)
    first_log_ns: int | None = None
    last_log_ns: int | None = None
    problems: list[Problem] = field(default_factory=list)
    problem_count: int = 0

    @property
    def lost(self) -> bool:
        """Whether parts of the log could not be read."""
        return self.problem_count > 0

    def add_problem(self, offset: int, what: str) -> None:
        """Count a problem and keep its words while there is room."""
        self.problem_count += 1
        if self.problem_count <= MOST_PROBLEMS:
            self.problems.append(Problem(offset, what))
        elif self.problem_count == MOST_PROBLEMS + 1:
            self.problems.append(Problem(offset, "more problems follow, not listed"))


def scan(path: Path, report: ScanReport) -> Iterator[Message | Metadata | Attachment]:
    """Messages, metadata and small attachments of a log in file order.

    Memory is bounded by the largest chunk (at most `LARGEST_RECORD`). Damage is counted in `report.problems` and
    stepped over: a chunk whose checksum, compression or inner lengths are wrong is lost as a whole, a wrong record
    length costs everything up to the next record that can be recognised.

    Raises
    ------
    InputError
        The file cannot be opened, is empty, or is no MCAP.
    """
    try:
        stream = path.open("rb")
    except OSError as error:
        raise InputError(
            f"{path}: wanted a log to read, found: {error.strerror or error}; check the name"
        ) from error
    with stream:
        try:
            yield from _Scanner(path, stream, report).run()
        except OSError as error:
            raise InputError(
                f"{path}: reading stopped at byte {report.bytes_read}: {error.strerror or error}; "
                "check the disk or copy the file anew"
            ) from error


def messages_at(path: Path, offset: int, channels: dict[int, Channel]) -> list[Message]:
    """Messages of the one record at an offset of a log scanned before; `channels` by id. Raises as `scan`."""
    try:
        with path.open("rb") as stream:
            scanner = _Scanner(path, stream, ScanReport())
            scanner.channels.update(channels)
            scanner.schemas.update({c.schema_id: c.schema for c in channels.values() if c.schema})
            return scanner.messages_at(offset)
    except OSError as error:
        raise InputError(
            f"{path}: reading stopped at byte {offset}: {error.strerror or error}; "
            "check the disk or copy the file anew"
        ) from error


class _Scanner:
    """One pass over one file."""

    def __init__(self, path: Path, stream: BinaryIO, report: ScanReport) -> None:
        self.path, self.stream, self.report = path, stream, report
        self.size = os.fstat(stream.fileno()).st_size
        report.bytes_total = self.size
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.missing_channels: set[int] = set()
        self.summary_asked = False
        self.chunked = False
        self.cut = False
        self.position = 0
        # Of all bytes so far; None where the log has none to compare with or some bytes were passed over.
        self.checksum = 0 if has_data_checksum(stream) else None
        stream.seek(0)

    def run(self) -> Iterator[Message | Metadata | Attachment]:
        """All records that can be read, in file order."""
        self._check_magic()
        opcode = 0
        while opcode not in (DATA_END, FOOTER) and self.position < self.size:
            start, before = self.position, self.checksum
            head = self._take(min(RECORD_HEAD.size, self.size - start))
            opcode, length = RECORD_HEAD.unpack(head.ljust(RECORD_HEAD.size, b"\0"))
            if len(head) < RECORD_HEAD.size or not self._is_plausible(opcode, length):
                self._step_over(start, opcode, length)
                opcode = 0
                continue
            if opcode == DATA_END:
                self._end_data(self._take(length), start, before)
            else:
                yield from self._record(opcode, length, start)
            self.report.bytes_read = self.position
        if opcode not in (DATA_END, FOOTER) and not self.cut:
            self.report.add_problem(
                self.position, "the log ends without its end mark: the recording was cut off"
            )
        self.report.bytes_read = self.size

    def messages_at(self, offset: int) -> list[Message]:
        """Messages of one record."""
        self.stream.seek(offset)
        self.position = offset
        opcode, length = RECORD_HEAD.unpack(self._take(RECORD_HEAD.size))
        found = self._record(opcode, length, offset)
        return [one for one in found if isinstance(one, Message)]

    def _check_magic(self) -> None:
        found = self._take(min(len(MAGIC), self.size))
        if found != MAGIC:
            what = f"a file that begins with {found!r}" if found else "an empty file"
            raise InputError(
                f"{self.path}: wanted an MCAP log, found {what}; convert other recordings to MCAP, "
                "or make a log of numbered images with `wayside import`"
            )
        if self.size <= 2 * len(MAGIC):
            raise InputError(
                f"{self.path}: wanted an MCAP log, found its file mark without any record; "
                "the recording stopped before anything was written: use another"
            )

    def _is_plausible(self, opcode: int, length: int) -> bool:
        """Whether the record whose head was just read can be true."""
        end = self.position + length
        if opcode == 0 or end > self.size or not length_is_plausible(opcode, length):
            return False
        if opcode <= LAST_KNOWN:
            return True
        # Private opcodes and those to come are to be ignored, but garbage looks the same: ask what lies behind.
        sound = follows_a_record(self.stream, end, self.size)
        self.stream.seek(self.position)
        return sound

    def _record(
        self, opcode: int, length: int, start: int
    ) -> Iterator[Message | Metadata | Attachment]:
        if opcode == CHUNK:
            yield from self._chunk(length, start)
        elif opcode == MESSAGE:
            message = self._message(memoryview(self._take(length)), start)
            if message is not None:
                yield message
        elif opcode in (SCHEMA, CHANNEL):
            self._define(opcode, memoryview(self._take(length)), start)
        elif opcode == METADATA or (opcode == ATTACHMENT and length <= LARGEST_ATTACHMENT):
            content = memoryview(self._take(length))
            try:
                yield parse_metadata(content) if opcode == METADATA else parse_attachment(content)
            except LayoutError as error:
                kind = "a metadata record" if opcode == METADATA else "an attachment"
                self.report.add_problem(start, f"{kind} lost: {error}")
        else:
            self._skip(length)

    def _chunk(self, length: int, start: int) -> Iterator[Message]:
        self.chunked, self.checksum = True, None
        self.report.chunks += 1
        body = self.position
        probe = self.stream.read(min(length, LARGEST_HEAD))
        try:
            head, head_size = parse_chunk_head(probe, length)
        except ChunkError as error:
            self._lose_chunk(start, length, "", error)
            self._go_to_next(start)  # a length that the head contradicts leads nowhere
            return
        self.position = body + head_size
        self.stream.seek(self.position)
        try:
            records = unpack_chunk(head, self._take(head.packed_size))
        except ChunkError as error:
            self._lose_chunk(start, length, self._time_span(head), error)
            return
        self.report.compressions[head.compression or "none"] += 1
        for opcode, content in records:
            if opcode != MESSAGE:
                self._define(opcode, content, start)
            elif (message := self._message(content, start)) is not None:
                yield message

    def _lose_chunk(self, start: int, length: int, span: str, error: ChunkError) -> None:
        self.report.lost_chunks += 1
        self.report.add_problem(start, f"a chunk of {length} bytes{span} lost: {error}")

    def _time_span(self, head: ChunkHead) -> str:
        zero = self.report.first_log_ns
        if zero is None or not head.times_known:
            return ""
        begin, end = (head.start_ns - zero) / 1e9, (head.end_ns - zero) / 1e9
        return f" ({begin:.2f} s to {end:.2f} s after the first message)"

    def _message(self, content: memoryview, start: int) -> Message | None:
        channel_id, sequence, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content)
        channel = self.channels.get(channel_id) or self._missing_channel(channel_id, start)
        if channel is None:
            return None
        report = self.report
        report.messages += 1
        if report.first_log_ns is None or log_time_ns < report.first_log_ns:
            report.first_log_ns = log_time_ns
        if report.last_log_ns is None or log_time_ns > report.last_log_ns:
            report.last_log_ns = log_time_ns
        return Message(channel, sequence, log_time_ns, content[MESSAGE_HEAD.size :], start)

    def _missing_channel(self, channel_id: int, start: int) -> Channel | None:
        """A channel whose definition was lost with its chunk: the summary may repeat it."""
        if not self.summary_asked:
            self.summary_asked = True
            here = self.stream.tell()
            summary = read_summary(self.stream)
            self.stream.seek(here)
            for channel in () if summary is None else summary.channels.values():
                self.channels.setdefault(channel.id, channel)
        if channel_id not in self.channels and channel_id not in self.missing_channels:
            self.missing_channels.add(channel_id)
            self.report.add_problem(
                start, f"messages of channel {channel_id} lost: its definition is missing"
            )
        return self.channels.get(channel_id)

    def _define(self, opcode: int, content: memoryview, start: int) -> None:
        try:
            if opcode == SCHEMA:
                schema = parse_schema(content)
                self.schemas[schema.id] = schema
                return
            channel = parse_channel(content, self.schemas)
        except LayoutError as error:
            kind = "schema" if opcode == SCHEMA else "channel"
            self.report.add_problem(start, f"a {kind} definition lost: {error}")
            return
        if self.channels.get(channel.id) == channel:
            return  # repeated in every chunk by some writers
        self.channels[channel.id] = channel
        if channel.schema is None and channel.schema_id:
            self.report.add_problem(
                start, f"channel {channel.topic} names schema {channel.schema_id}, which is missing"
            )

    def _end_data(self, content: bytes, start: int, checksum: int | None) -> None:
        """Check all data before `start`; messages outside chunks have no other checksum."""
        expected = int.from_bytes(content[:4], "little")
        if expected and checksum is not None and expected != checksum:
            self.report.add_problem(
                start, "the checksum over the whole log differs: some of its messages are damaged"
            )

    def _step_over(self, start: int, opcode: int, length: int) -> None:
        """Go on behind a record head that cannot be true."""
        if opcode == CHUNK and is_chunk(self.stream.read(LARGEST_HEAD), length):
            self.chunked = (
                True  # a chunk cut off: what it holds is not to be taken for records of the file
            )
        self._go_to_next(start)
        lost = self.position - start
        if self.position < self.size:
            self.report.add_problem(
                start, f"{lost} bytes lost: no record can begin here (opcode {opcode})"
            )
        else:
            self.cut = True
            self.report.add_problem(
                start,
                f"the last {lost} bytes lost: the log ends without its end mark, in the middle of a record",
            )

    def _go_to_next(self, start: int) -> None:
        channels = None if self.chunked else self.channels.keys()
        found = find_record(self.stream, start + 1, self.size, channels)
        self.position, self.checksum = self.size if found is None else found, None
        self.stream.seek(self.position)

    def _take(self, count: int) -> bytes:
        """Exactly `count` bytes, which the size of the file says are there."""
        data = self.stream.read(count)
        if len(data) < count:
            raise OSError("the file became shorter while it was read")
        self.position += count
        if self.checksum is not None:
            self.checksum = zlib.crc32(data, self.checksum)
        return data

    def _skip(self, count: int) -> None:
        if self.checksum is not None and count <= LARGEST_ATTACHMENT:
            self._take(count)
        else:
            self.checksum = None
            self.position += count
            self.stream.seek(self.position)
