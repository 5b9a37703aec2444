"""Records of an MCAP file, read one after the other, whatever state the file is in.

The stock readers stop at the first fault or hand on damaged bytes; here every length is checked before anything is
read, every chunk's checksum is checked before anything of it is handed on, and reading goes on behind the damage.
Neither footer nor summary is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from wayside.pipeline.input_files import open_input
from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.layout import Attachment, Channel, LayoutError, Metadata
from wayside.pipeline.reading.parts import LogParts, log_parts
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.scanner import Message, Scanner
from wayside.schemas.errors import InputError

__all__ = ["Attachment", "Message", "Metadata", "messages_at", "scan"]


def scan(
    path: Path, report: ScanReport, allowance: Allowance | None = None
) -> Iterator[Message | Metadata | Attachment]:
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
        own = replace(allowance or Allowance())
        part = file.name if len(parts.files) > 1 else ""
        with _scanner(file, report, own, start, part) as scanner:
            yield from scanner.run()
            stated.append(scanner.messages_stated)
    report.bytes_read = report.bytes_total
    report.messages_stated = None if None in stated else sum(filter(None, stated))
    lost = (report.messages_stated or 0) - report.messages
    if lost > 0 and not report.problem_count:
        report.add_problem(
            report.bytes_total,
            f"{lost} messages lost: the summary counts {report.messages_stated}, {report.messages} were found",
        )


@contextmanager
def _scanner(
    path: Path, report: ScanReport, allowance: Allowance, start: int, part: str
) -> Iterator[Scanner]:
    """A scanner of one file; what the system refuses becomes an InputError."""
    try:
        stream = open_input(path)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(
            f"{path}: wanted a log to read, found: {reason or error}; check the name"
        ) from error
    with stream:
        try:
            yield Scanner(path, stream, report, allowance, start, part)
        except OSError as error:
            raise InputError(
                f"{path}: reading stopped at byte {report.bytes_read}: {error.strerror or error}; "
                "check the disk or copy the file anew"
            ) from error


def messages_at(
    parts: LogParts,
    offset: int,
    channels: Iterable[Channel],
    allowance: Allowance | None = None,
) -> list[Message]:
    """Messages of the one record at an offset of a log scanned before, of the channels known there.

    Raises
    ------
    InputError
        As `scan`, and where the record can no longer be read as it was, or only beyond the allowance.
    """
    path, place = parts.at(offset)
    report = ScanReport(bytes_read=place)
    with _scanner(path, report, allowance or Allowance(), offset - place, "") as scanner:
        scanner.definitions.know(channels)
        try:
            return scanner.messages_at(place)
        except LayoutError as error:
            raise InputError(
                f"{path}: the messages at byte {place} cannot be read once more, in the order of their times: {error}; "
                "sort the log by time first (mcap sort)"
            ) from error
