"""Records of an MCAP file, read one after the other, whatever state the file is in.

The stock readers stop at the first fault or hand on damaged bytes; here every length is checked before anything is
read, every chunk's checksum is checked before anything of it is handed on, and reading goes on behind the damage.
Layout and opcodes: MCAP specification, https://mcap.dev/spec. Neither footer nor summary is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from wayside.pipeline.input_files import open_input
from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.layout import Attachment, Channel, Metadata
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
    whole, a wrong record length costs everything up to the next record that can be recognised. Of a chunk that the
    end of the file cuts off, the whole messages before the cut come.

    Raises
    ------
    InputError
        The file cannot be opened, is empty, or is no MCAP; a directory is no ROS 2 bag of MCAP parts.
    """
    parts = log_parts(path)
    if len(parts.files) == 1:
        yield from _scan_file(parts.files[0], report, allowance or Allowance())
        return
    report.bytes_total = parts.size
    for number, (file, start) in enumerate(zip(parts.files, parts.starts, strict=True)):
        one = ScanReport()
        try:
            for record in _scan_file(file, one, replace(allowance or Allowance())):
                report.bytes_read = start + one.bytes_read
                yield (
                    record._replace(offset=start + record.offset)
                    if isinstance(record, Message)
                    else record
                )
        finally:
            report.bytes_read = start + one.bytes_read
            report.absorb(one, file.name, first=number == 0)


def _scan_file(
    path: Path, report: ScanReport, allowance: Allowance
) -> Iterator[Message | Metadata | Attachment]:
    try:
        stream = open_input(path)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(
            f"{path}: wanted a log to read, found: {reason or error}; check the name"
        ) from error
    with stream:
        try:
            yield from Scanner(path, stream, report, allowance).run()
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
    try:
        with open_input(path) as stream:
            scanner = Scanner(path, stream, ScanReport(), allowance or Allowance())
            scanner.definitions.know(channels)
            found = scanner.messages_at(place)
            if scanner.report.lost_chunks:
                raise InputError(
                    f"{path}: wanted the messages once more, in the order of their times, found "
                    f"{scanner.report.problems[0]}; sort the log by time first (mcap sort)"
                )
            return [one._replace(offset=offset) for one in found] if place != offset else found
    except OSError as error:
        raise InputError(
            f"{path}: reading stopped at byte {place}: {error.strerror or error}; "
            "check the disk or copy the file anew"
        ) from error
