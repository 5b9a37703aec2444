"""The summary at the end of an MCAP file: definitions and counts where it is sound, never needed."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import BinaryIO

from mcap.opcode import Opcode

from wayside.pipeline.reading.chunks import find_records, take_records
from wayside.pipeline.reading.layout import (
    MAGIC,
    RECORD_HEAD,
)

_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum
_STATISTICS = struct.Struct("<QHIIII")  # messages, schemas, channels, attachments, metadata, chunks
_LARGEST = 1 << 28


@dataclass(frozen=True, slots=True)
class Summary:
    """What stands behind the data of a log.

    start: where it begins in the file, as the data end; checked: it has a checksum, which is right; definitions: opcode
    and content of its schemas and channels; messages, chunks: how many there are, None where it does not say.
    """

    start: int
    checked: bool
    definitions: tuple[tuple[int, memoryview], ...] = ()
    messages: int | None = None
    chunks: int | None = None


def read_summary(stream: BinaryIO, size: int) -> Summary | None:
    """The summary of a log of `size` bytes, None where it does not end in one or it is damaged; moves the stream."""
    footer = size - len(MAGIC) - _FOOTER.size
    if footer < len(MAGIC):
        return None
    stream.seek(footer)
    tail = stream.read(_FOOTER.size + len(MAGIC))
    opcode, length, start, _, checksum = _FOOTER.unpack_from(tail)
    if (opcode, length) != (Opcode.FOOTER, _FOOTER.size - RECORD_HEAD.size) or not tail.endswith(
        MAGIC
    ):
        return None
    start = start or footer  # 0: there is none
    if not len(MAGIC) <= start <= footer or footer - start > _LARGEST:
        return None
    stream.seek(start)
    section = memoryview(stream.read(footer - start))
    offsets, fault = find_records(section, len(section))
    if fault or (
        checksum and zlib.crc32(tail[: _FOOTER.size - 4], zlib.crc32(section)) != checksum
    ):
        return None
    records = list(take_records(section, offsets))
    counts: tuple[int | None, ...] = (None,)
    for opcode, content in records:
        if opcode == Opcode.STATISTICS and len(content) >= _STATISTICS.size:
            counts = _STATISTICS.unpack_from(content)
    definitions = tuple(
        record for record in records if record[0] in (Opcode.SCHEMA, Opcode.CHANNEL)
    )
    return Summary(start, checksum != 0, definitions, counts[0], counts[-1])
