"""Records of an MCAP file, read one after the other, whatever state the file is in.

The stock readers stop at the first fault or return damaged bytes. Here every length is checked before reading, and
every chunk's checksum before anything of it is returned. Reading continues after the damage. Neither footer nor summary
is needed.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata

from wayside.pipeline.files.input_files import open_input
from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.definitions import Definitions, read_summary
from wayside.pipeline.reading.layout import (
    ENDS,
    LAST_KNOWN,
    LATEST_NS,
    MAGIC,
    MESSAGE_HEAD,
    PARSED,
    Channel,
    LayoutError,
    RecordHead,
    parse_chunk_head,
    parse_record,
    records_in,
    unpack_chunk,
)
from wayside.pipeline.reading.parts import LogParts, log_parts
from wayside.pipeline.reading.resync import LARGEST_ATTACHMENT, RecordFinder
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.schemas.errors import InputError

__all__ = ["Attachment", "Message", "Metadata", "messages_at", "scan"]


class Message(NamedTuple):
    """A message as recorded; `data` is a view into its chunk, `offset` where message or chunk stand in the log."""

    channel: Channel
    sequence: int
    log_time_ns: int
    data: memoryview
    offset: int


Content = Message | Metadata | Attachment


def scan(path: Path, report: ScanReport, allowance: Allowance | None = None) -> Iterator[Content]:
    """Messages, metadata and small attachments of a log in file order; of a bag directory, one part after the other.

    Memory is bounded by the largest chunk (at most `LARGEST_RECORD`), time by the allowance. Damage is counted in
    `report.problems` and stepped over: a chunk whose checksum, compression or inner lengths are wrong is lost as a
    whole, a wrong record length costs that record. Of a chunk that the end of the file cuts off, the whole messages
    before the cut come.

    Raises
    ------
    InputError
        The file cannot be opened, is empty, or is no MCAP; a directory is no ROS 2 bag of MCAP parts.
    """
    parts = log_parts(path)
    report.bytes_total, stated = parts.size, []
    for file, start in zip(parts.files, parts.starts, strict=True):
        report.part = file.name if len(parts.files) > 1 else ""
        with _opened(file, report, replace(allowance or Allowance()), start) as scanner:
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
    parts: LogParts, offset: int, channels: Iterable[Channel], allowance: Allowance
) -> list[Message]:
    """Messages of the one record at an offset of a log scanned before, of the channels known there.

    Raises InputError as `scan`, and where the record cannot be read any more, or only beyond the allowance.
    """
    path, place = parts.at(offset)
    with _opened(path, ScanReport(bytes_read=place), allowance, offset - place) as scanner:
        scanner.definitions.know(channels)
        try:
            head = scanner.finder.head_at(place)
            if head is None:
                raise LayoutError("no record begins here")
            return [one for one in scanner.content(head) if isinstance(one, Message)]
        except LayoutError as error:
            raise InputError(
                f"{path}: the messages at byte {place} cannot be read in the order of their times: {error}. "
                "Either the log changed while it was read, or it must be sorted by time first (mcap sort)."
            ) from error


@contextmanager
def _opened(path: Path, report: ScanReport, allowance: Allowance, start: int) -> Iterator[_Scanner]:
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
            yield _Scanner(path, stream, report, allowance, start)
        except OSError as error:
            raise InputError(
                f"{path}: reading stopped at byte {report.bytes_read}: {error.strerror or error}. "
                "Check the disk, or copy the file again."
            ) from error


class _Scanner:
    """One pass over one file, which begins at `base` of the log.

    A record that contradicts itself is lost, and so is what no record can be told in. Reading goes on where the record
    says that it ends, if another begins there; else at the next record that can be recognised.
    """

    def __init__(
        self, path: Path, stream: BinaryIO, report: ScanReport, allowance: Allowance, base: int
    ) -> None:
        self.path, self.report, self.allowance, self.base = path, report, allowance, base
        self.size = os.fstat(stream.fileno()).st_size
        self.definitions = Definitions()
        self.finder = RecordFinder(stream, self.definitions.channels, self.size)
        self.messages_stated: int | None = None
        self.searched = 0
        self.lost: dict[int, tuple[int, int]] = {}  # by channel: first message and count

    def run(self) -> Iterator[Content]:
        """All records that can be read, in file order."""
        self._check_magic()
        finder, position = self.finder, len(MAGIC)
        summary = read_summary(finder.stream, self.size)
        if summary is not None:
            finder.end, finder.cut, finder.chunked = summary.start, False, bool(summary.chunks)
            self.messages_stated = summary.messages
            for record in summary.definitions:
                self.definitions.add(record)
        whole = position
        while position < finder.end:
            head = finder.head_at(position)
            if head is not None and head.opcode in ENDS:
                self._look_behind(head)
                break
            if head is not None and head.end > finder.end and not self._is_cut_chunk(head):
                head = None
            try:
                if head is None:
                    raise LayoutError("no record can begin here")
                if head.opcode == Opcode.MESSAGE:
                    self._check_length(head)
                    finder.chunked = False
                yield from self.content(head)
                position = head.end
                whole = whole if position > finder.end else position
            except LayoutError as error:
                position = self._lose(position, head, error)
            self.report.bytes_read = self.base + min(position, self.size)
        else:
            if finder.cut:
                self.report.add_problem(
                    whole,
                    "the log ends without its end mark: the recording was cut off "
                    f"{self.size - whole} bytes behind its last whole record",
                )
        for channel_id, (start, count) in self.lost.items():
            self.report.add_problem(
                start,
                f"{count} messages of channel {channel_id} lost: its definition, or that of its schema, is missing",
            )

    def _look_behind(self, head: RecordHead) -> None:
        """Count bytes behind the end mark, as where two logs were put into one file."""
        end: RecordHead | None = head
        while end is not None and end.opcode != Opcode.FOOTER:
            end = self.finder.head_at(end.end)
        behind = self.size if end is None else end.end + len(MAGIC)
        if behind < self.size:
            self.report.add_problem(
                behind,
                f"{self.size - behind} bytes lost: they lie behind the end mark of the log; if they are another log, "
                "part the file there and use `wayside join`",
            )

    def _check_magic(self) -> None:
        found = bytes(self.finder.bytes_at(0, len(MAGIC)))
        if found == MAGIC and self.size > 2 * len(MAGIC):
            return
        what = f"a file that begins with {found!r}" if found else "an empty file"
        if found == MAGIC:
            what = "its file mark without any record"
        raise InputError(
            f"{self.path}: this is not an MCAP log but {what}. Make a log of ROS bags with `wayside join`, of "
            "numbered images with `wayside import`, and convert other recordings to MCAP."
        )

    def content(self, head: RecordHead) -> Iterator[Content]:
        """What a record holds; raises LayoutError, before anything comes, where it contradicts itself."""
        opcode = head.opcode
        if opcode == Opcode.CHUNK:
            yield from self._chunk(head)
        elif opcode == Opcode.MESSAGE:
            yield from self._message(self._bytes(head), head.start, checked=False)
        elif opcode in PARSED and (
            opcode != Opcode.ATTACHMENT or head.length <= LARGEST_ATTACHMENT
        ):
            record, left = parse_record(opcode, self._bytes(head))
            if left:  # as fields to come may be
                self._check_length(head)
            if isinstance(record, Metadata | Attachment):
                yield record
            else:
                self.definitions.add(record)
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
        content = self._bytes(head)
        chunk = parse_chunk_head(content, head.length)
        self.finder.chunked = True
        read = min(head.end, self.size)
        self.allowance.take_bytes(chunk.unpacked_size, read)
        data = unpack_chunk(chunk, content[chunk.size :], whole=not cut)
        most = self.allowance.records_left(read)
        if not cut:  # as a whole or not at all
            self.allowance.take_records(sum(1 for _ in islice(records_in(data), most + 1)), read)
        report.compressions[chunk.compression or "none"] += 1
        try:
            for opcode, inner in islice(records_in(data), most):
                if opcode == Opcode.MESSAGE:
                    checked = chunk.checksum != 0 and not cut
                    yield from self._message(inner, head.start, checked=checked)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self.definitions.add(parse_record(opcode, inner)[0])
        except LayoutError:
            if not cut:
                raise

    def _message(self, content: memoryview, start: int, *, checked: bool) -> Iterator[Message]:
        """The message, if its channel and time are known."""
        channel_id, sequence, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content)
        channel = self.definitions.channels.get(channel_id)
        if channel is None:
            first, count = self.lost.get(channel_id, (start, 0))
            self.lost[channel_id] = first, count + 1
        elif log_time_ns >= LATEST_NS:
            self.report.add_problem(
                start, f"a message of {channel.topic} lost: its time is after the year 2116"
            )
        else:
            self.report.add_message(log_time_ns, checked=checked)
            data = content[MESSAGE_HEAD.size :]
            yield Message(channel, sequence, log_time_ns, data, self.base + start)

    def _lose(self, start: int, head: RecordHead | None, error: LayoutError) -> int:
        """Report what is lost from `start` on, where `head` stands if any can; where to go on.

        Within what one damaged length covers only the first such record is searched, or the cost would be the square of
        the size.
        """
        finder, kind = self.finder, "record"
        if head is None:
            position = finder.find(start + 1)
            if position is None and finder.cut:
                return finder.end  # told as the cut
        else:
            position = head.end
            if head.opcode <= LAST_KNOWN:
                kind = Opcode(head.opcode).name.lower().replace("_", " ")
            if not finder.follows(head.end):
                position = finder.find(head.content if start >= self.searched else head.end)
                self.searched = max(self.searched, head.end)
            self.report.lost_chunks += head.opcode == Opcode.CHUNK
        position = finder.end if position is None else position
        self.report.add_problem(start, f"{kind} of {position - start} bytes lost: {error}")
        return position

    def _is_cut_chunk(self, head: RecordHead) -> bool:
        """Whether the end of the file cuts off a chunk. Bytes after its head are then not records of the file."""
        if not (self.finder.cut and self.finder.is_chunk(head)):
            return False
        self.finder.chunked = True
        return self.finder.find(head.start + 1) is None

    def _bytes(self, head: RecordHead) -> memoryview:
        """Content of a record up to the end of the file, whose size says that it is there."""
        count = min(head.length, self.size - head.content)
        content = self.finder.bytes_at(head.content, count)
        if len(content) < count:
            raise OSError("the file became shorter while it was read")
        return content
