"""One pass over the records of an MCAP file: what each is, and how reading goes on behind damage."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.chunks import (
    LARGEST_HEAD,
    ChunkError,
    TooMuchError,
    check_chunk,
    find_records,
    parse_chunk_head,
    take_records,
    unpack_chunk,
)
from wayside.pipeline.reading.definitions import Definitions
from wayside.pipeline.reading.layout import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    LAST_KNOWN,
    LATEST_NS,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    ONLY_IN_SUMMARY,
    RECORD_HEAD,
    SCHEMA,
    Attachment,
    Channel,
    LayoutError,
    Metadata,
    is_message_index,
    length_is_plausible,
    parse_attachment,
    parse_metadata,
)
from wayside.pipeline.reading.resync import (
    data_ends,
    end_of_log,
    find_record,
    follows_a_record,
    is_chunk,
)
from wayside.pipeline.reading.salvage import unpack_front
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.summary import Summary, has_data_checksum, read_summary
from wayside.schemas.errors import InputError

LARGEST_ATTACHMENT = 1 << 20
"""Larger attachments are passed over unread: a calibration is a few hundred bytes."""


class Message(NamedTuple):
    """A message as recorded; `data` is a view into its chunk, `offset` where message or chunk stand in the file."""

    channel: Channel
    sequence: int
    log_time_ns: int
    data: memoryview
    offset: int


class Scanner:
    """One pass over one file."""

    def __init__(
        self, path: Path, stream: BinaryIO, report: ScanReport, allowance: Allowance
    ) -> None:
        self.path, self.stream, self.report, self.allowance = path, stream, report, allowance
        self.size = os.fstat(stream.fileno()).st_size
        report.bytes_total = self.size
        self.definitions = Definitions(self._summary, report.add_problem, report.add_remark)
        self.chunked = False
        self.cut = False
        self.position = 0
        self.stray: tuple[int, int] | None = None
        self.gone_back = 0
        # Of all bytes so far; None where the log has none to compare with or some bytes were passed over.
        self.checksum = 0 if has_data_checksum(stream) else None
        stream.seek(0)

    def messages_at(self, offset: int) -> list[Message]:
        """Messages of the one record that stands at an offset; of a chunk that is cut off, those before the cut."""
        self.chunked = True
        self.stream.seek(offset)
        self.position = offset
        opcode, length = RECORD_HEAD.unpack(self._take(RECORD_HEAD.size))
        if self.position + length > self.size:
            return list(self._front_of_cut_chunk(offset, length))
        found = self._record(opcode, length, offset)
        return [one for one in found if isinstance(one, Message)]

    def run(self) -> Iterator[Message | Metadata | Attachment]:
        """All records that can be read, in file order."""
        self._check_magic()
        opcode = 0
        while opcode not in (DATA_END, FOOTER) and self.position < self.size:
            start, before = self.position, self.checksum
            head = self._take(min(RECORD_HEAD.size, self.size - start))
            opcode, length = RECORD_HEAD.unpack(head.ljust(RECORD_HEAD.size, b"\0"))
            if len(head) < RECORD_HEAD.size or not self._is_plausible(opcode, length):
                yield from self._step_over(start, opcode, length)
                opcode = 0
                continue
            if opcode == DATA_END:
                self._end_data(self._take(length), start, before)
            else:
                yield from self._record(opcode, length, start)
            self.report.bytes_read = self.position
        if opcode in (DATA_END, FOOTER):
            self._look_behind(start if opcode == FOOTER else self.position)
        elif not self.cut:
            self.report.add_problem(
                self.position, "the log ends without its end mark: the recording was cut off"
            )
        self._reconcile()
        self.report.bytes_read = self.size

    def _check_magic(self) -> None:
        found = self._take(min(len(MAGIC), self.size))
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

    def _is_plausible(self, opcode: int, length: int) -> bool:
        """Whether the record whose head was just read can be true."""
        end = self.position + length
        if opcode == 0 or end > self.size or not length_is_plausible(opcode, length):
            return False
        if opcode in (DATA_END, FOOTER):
            sound = data_ends(self.stream, opcode, end)
        elif opcode <= LAST_KNOWN:
            return True
        else:
            # Private opcodes and those to come are to be ignored, but garbage looks the same: ask what lies behind.
            sound = follows_a_record(self.stream, end, self.size)
        self.stream.seek(self.position)
        return sound

    def _record(
        self, opcode: int, length: int, start: int
    ) -> Iterator[Message | Metadata | Attachment]:
        if opcode in (CHUNK, MESSAGE) and self.stray is not None:
            place, other = self.stray
            self.report.add_problem(
                place, f"a record lost: its kind (opcode {other}) has no place among messages"
            )
            self.stray = None
        if opcode == CHUNK or self._is_disguised_chunk(opcode, length, start):
            yield from self._chunk(length, start)
        elif opcode == MESSAGE:
            message = self._message(memoryview(self._take(length)), start)
            if message is not None:
                yield message
        elif opcode in (SCHEMA, CHANNEL):
            self.definitions.add(opcode, memoryview(self._take(length)), start)
        elif opcode == METADATA or (opcode == ATTACHMENT and length <= LARGEST_ATTACHMENT):
            content = memoryview(self._take(length))
            try:
                yield parse_metadata(content) if opcode == METADATA else parse_attachment(content)
            except LayoutError as error:
                kind = "a metadata record" if opcode == METADATA else "an attachment"
                self.report.add_problem(start, f"{kind} lost: {error}")
        elif opcode == MESSAGE_INDEX and length <= LARGEST_ATTACHMENT:
            if not is_message_index(memoryview(self._take(length))):
                self.report.add_problem(
                    start, "a record lost: it is called a message index and is none"
                )
        else:
            if opcode in ONLY_IN_SUMMARY or (opcode == HEADER and start > len(MAGIC)):
                self.stray = start, opcode
            elif opcode > LAST_KNOWN:
                self.report.unknown_records += 1
            self._skip(length)

    def _is_disguised_chunk(self, opcode: int, length: int, start: int) -> bool:
        """Whether a record that calls itself something else holds a chunk: its opcode is damaged."""
        if (
            opcode in (MESSAGE, MESSAGE_INDEX, HEADER)
            and self.definitions.channels
            and not self.chunked
        ):
            return False  # a log that defines its channels outside of chunks has none
        disguised = is_chunk(self.stream.read(min(length, LARGEST_HEAD)), length)
        self.stream.seek(self.position)
        if disguised:
            self.report.add_problem(
                start, f"the kind of a chunk (opcode {opcode}) is damaged; what it holds is used"
            )
        return disguised

    def _chunk(self, length: int, start: int) -> Iterator[Message]:
        self.report.chunks += 1
        probe = self.stream.read(min(length, LARGEST_HEAD))
        self.stream.seek(self.position)
        try:
            head, head_size = parse_chunk_head(probe, length)
        except ChunkError as error:
            self._lose_chunk(start, length, "", error)
            self._go_to_next(start)  # a length that the head contradicts leads nowhere
            return
        self.chunked = True
        if head.checksum:
            self.checksum = None  # each chunk has its own
        else:
            self.report.unchecked_chunks += 1
        packed = memoryview(self._take(length))[head_size:]
        data = None
        try:
            self.allowance.take_bytes(head.unpacked_size, self.position)
            data = unpack_chunk(head, packed)
            check_chunk(head, data)
            found = find_records(data, self.allowance.records_left(self.position))
            if found.fault:
                raise ChunkError(found.fault)
        except ChunkError as error:
            self._lose_chunk(start, length, head.span_after(self.report.first_log_ns), error)
            if not isinstance(error, TooMuchError):
                front = unpack_front(head, packed, head.unpacked_size) if data is None else data
                self._salvage_definitions(front, start)
            self._find_next(start)
            return
        self.allowance.records += found.records
        if found.misplaced:
            self.report.add_problem(
                start, f"{found.misplaced} records in a chunk lost: their kinds have no place there"
            )
        self.report.compressions[head.compression or "none"] += 1
        yield from self._messages(data, found.offsets, start)

    def _messages(self, data: memoryview, offsets: Iterable[int], start: int) -> Iterator[Message]:
        for opcode, content in take_records(data, offsets):
            if opcode != MESSAGE:
                self.definitions.add(opcode, content, start)
            elif (message := self._message(content, start)) is not None:
                yield message

    def _lose_chunk(self, start: int, length: int, span: str, error: ChunkError) -> None:
        self.report.lost_chunks += 1
        self.report.add_problem(start, f"a chunk of {length} bytes{span} lost: {error}")

    def _salvage_definitions(self, front: memoryview, start: int) -> None:
        try:
            found = find_records(front, self.allowance.records_left(self.position))
        except TooMuchError:
            return
        self.allowance.records += found.records
        records = take_records(front, found.offsets)
        self.definitions.remember((r for r in records if r[0] != MESSAGE), start)

    def _find_next(self, start: int) -> None:
        """Go on behind a damaged chunk, or inside of what its length covers where bytes of it are missing."""
        end = self.position
        sound = follows_a_record(self.stream, end, self.size)
        self.stream.seek(end)
        if not sound and self.gone_back <= self.size + LARGEST_ATTACHMENT:
            self._go_to_next(start)
            self.gone_back += max(end - self.position, 0)  # bounded, or nested heads cost n^2

    def _front_of_cut_chunk(self, start: int, length: int) -> Iterator[Message]:
        """The whole messages of a chunk that the end of the file cuts off; nothing can check them."""
        self.stream.seek(start + RECORD_HEAD.size)
        content = self.stream.read(self.size - start - RECORD_HEAD.size)
        head, head_size = parse_chunk_head(content[:LARGEST_HEAD], length)
        before = self.report.messages
        why = ""
        try:
            self.allowance.take_bytes(head.unpacked_size, self.size)
            front = unpack_front(head, memoryview(content)[head_size:], head.unpacked_size)
            found = find_records(front, self.allowance.records_left(self.size))
            self.report.chunks += 1
            self.report.unchecked_chunks += 1
            yield from self._messages(front, found.offsets, start)
        except ChunkError as error:
            why = f" ({error})"
        self.report.add_problem(
            start,
            "the log ends without its end mark, in the middle of a chunk: "
            f"{self.report.messages - before} messages before the cut are used, the rest of the chunk is lost{why}",
        )

    def _message(self, content: memoryview, start: int) -> Message | None:
        channel_id, sequence, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content)
        channel = self.definitions.channel(channel_id, start)
        if channel is None:
            return None
        report = self.report
        if log_time_ns >= LATEST_NS:
            report.add_problem(
                start, f"a message of {channel.topic} lost: its time is after the year 2116"
            )
            return None
        report.messages += 1
        if report.first_log_ns is None or log_time_ns < report.first_log_ns:
            report.first_log_ns = log_time_ns
        if report.last_log_ns is None or log_time_ns > report.last_log_ns:
            report.last_log_ns = log_time_ns
        return Message(channel, sequence, log_time_ns, content[MESSAGE_HEAD.size :], start)

    def _summary(self) -> Summary | None:
        here = self.stream.tell()
        summary = read_summary(self.stream)
        self.stream.seek(here)
        return summary

    def _reconcile(self) -> None:
        """Compare the messages that were read with those that the summary counts."""
        summary = self._summary()
        stated = None if summary is None else summary.messages
        self.report.messages_stated = stated
        if stated is not None and stated > self.report.messages and not self.report.problem_count:
            self.report.add_problem(
                self.size,
                f"{stated - self.report.messages} messages lost: the summary counts {stated}, "
                f"{self.report.messages} were found",
            )

    def _look_behind(self, summary: int) -> None:
        """Tell of bytes behind the end mark, as where two logs were put into one file."""
        end = end_of_log(self.stream, summary, self.size)
        if end is not None and end < self.size:
            self.report.add_problem(
                end,
                f"{self.size - end} bytes lost: they stand behind the end mark of the log; "
                "if they are another log, part the file there and use `wayside join`",
            )

    def _end_data(self, content: bytes, start: int, checksum: int | None) -> None:
        """Check all data before `start`; messages outside chunks have no other checksum."""
        expected = int.from_bytes(content[:4], "little")
        self.report.data_checked = bool(expected) and checksum is not None
        if self.report.data_checked and expected != checksum:
            self.report.add_problem(
                start, "the checksum over the whole log differs: some of its messages are damaged"
            )

    def _step_over(self, start: int, opcode: int, length: int) -> Iterator[Message]:
        """Go on behind a record head that cannot be true."""
        in_chunk = opcode == CHUNK and is_chunk(self.stream.read(LARGEST_HEAD), length)
        # What a chunk that is cut off holds is not to be taken for records of the file.
        self.chunked |= in_chunk
        self._go_to_next(start)
        lost = self.position - start
        if self.position < self.size:
            self.report.add_problem(
                start, f"{lost} bytes lost: no record can begin here (opcode {opcode})"
            )
            return
        self.cut = True
        if in_chunk:
            yield from self._front_of_cut_chunk(start, length)
        else:
            self.report.add_problem(
                start,
                f"the last {lost} bytes lost: the log ends without its end mark, in the middle of a record",
            )

    def _go_to_next(self, start: int) -> None:
        channels = None if self.chunked else self.definitions.channels.keys()
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
