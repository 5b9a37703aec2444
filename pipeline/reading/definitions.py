"""Schemas and channels of a log, from its records and from the summary at its end where that is sound."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import BinaryIO

from mcap import records
from mcap.opcode import Opcode

from wayside.pipeline.reading.layout import (
    LARGEST_RECORD,
    MAGIC,
    RECORD_HEAD,
    Channel,
    LayoutError,
    parse_record,
    records_in,
)

_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum
_STATISTICS = struct.Struct("<QHIIII")  # messages, schemas, channels, attachments, metadata, chunks


class Definitions:
    """What each channel of a log is, by its number, as far as known; one whose schema is missing is not defined."""

    def __init__(self) -> None:
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, records.Schema] = {}

    def know(self, channels: Iterable[Channel]) -> None:
        """Take channels as an earlier scan of the same log has them."""
        self.channels.update((channel.id, channel) for channel in channels)
        self._schemas.update((c.schema_id, c.schema) for c in self.channels.values() if c.schema)

    def add(self, record: object) -> None:
        """Take a record, if it is a schema or a channel."""
        if isinstance(record, records.Schema):
            self._schemas[record.id] = record
        elif isinstance(record, records.Channel):
            schema = self._schemas.get(record.schema_id)
            channel = Channel(
                record.id, record.topic, record.message_encoding, record.schema_id, schema
            )
            if schema is None and channel.schema_id:
                self.channels.pop(channel.id, None)
            elif self.channels.get(channel.id) != channel:  # some writers repeat it in every chunk
                self.channels[channel.id] = channel


@dataclass(frozen=True, slots=True)
class Summary:
    """The bytes after the data of a log, from the byte `start` on.

    definitions: its schemas and channels; messages, chunks: how many there are, None where it does not say.
    """

    start: int
    definitions: list[object]
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
    is_footer = opcode == Opcode.FOOTER and length == _FOOTER.size - RECORD_HEAD.size
    start = start or footer  # 0: there is none
    earliest = max(len(MAGIC), footer - LARGEST_RECORD)
    if not (is_footer and tail.endswith(MAGIC) and earliest <= start <= footer):
        return None
    stream.seek(start)
    section = memoryview(stream.read(footer - start))
    if checksum not in (0, zlib.crc32(tail[: _FOOTER.size - 4], zlib.crc32(section))):
        return None
    definitions: list[object] = []
    counts: tuple[int | None, ...] = (None,)
    try:
        for opcode, content in records_in(section):
            if opcode == Opcode.STATISTICS and len(content) >= _STATISTICS.size:
                counts = _STATISTICS.unpack_from(content)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                definitions.append(parse_record(opcode, content)[0])
    except LayoutError:
        return None
    return Summary(start, definitions, counts[0], counts[-1])
