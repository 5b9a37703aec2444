"""The summary at the end of an MCAP file: a shortcut where it is sound, never needed."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass, field, replace
from typing import BinaryIO

from wayside.pipeline.reading.layout import (
    CHANNEL,
    DATA_END,
    FOOTER,
    MAGIC,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    Channel,
    Fields,
    LayoutError,
    Schema,
    parse_channel,
    parse_schema,
)

_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum
_DATA_END = struct.Struct("<BQI")  # opcode, length, checksum
_TAIL = RECORD_HEAD.size + _FOOTER.size + len(MAGIC)
_LARGEST = 1 << 28


@dataclass(frozen=True, slots=True)
class Summary:
    """Channels by id, and how many messages there are (None where the log does not say)."""

    channels: dict[int, Channel] = field(default_factory=dict)
    messages: int | None = None


def read_summary(stream: BinaryIO) -> Summary | None:
    """The summary of a log, None where there is none or it is damaged; moves the stream."""
    tail = _read_tail(stream)
    if tail is None:
        return None
    start, _, checksum = _FOOTER.unpack_from(tail, RECORD_HEAD.size)
    end = _size(stream) - _TAIL
    if not len(MAGIC) <= start <= end or end - start > _LARGEST:
        return None
    stream.seek(start)
    section = stream.read(end - start)
    if checksum and zlib.crc32(tail[: -len(MAGIC) - 4], zlib.crc32(section)) != checksum:
        return None
    try:
        return _parse(memoryview(section))
    except LayoutError:
        return None


def has_data_checksum(stream: BinaryIO) -> bool:
    """Whether the end of the data, just before summary or footer, carries a checksum; moves the stream."""
    tail = _read_tail(stream)
    if tail is None:
        return False
    start, _, _ = _FOOTER.unpack_from(tail, RECORD_HEAD.size)
    end = start or _size(stream) - _TAIL
    if not len(MAGIC) + _DATA_END.size <= end <= _size(stream) - _TAIL:
        return False
    stream.seek(end - _DATA_END.size)
    opcode, length, checksum = _DATA_END.unpack(stream.read(_DATA_END.size))
    return bool(opcode == DATA_END and length == 4 and checksum != 0)


def _size(stream: BinaryIO) -> int:
    return os.fstat(stream.fileno()).st_size


def _read_tail(stream: BinaryIO) -> bytes | None:
    """Footer record and closing mark, None where the file does not end in them."""
    size = _size(stream)
    if size < len(MAGIC) + _TAIL:
        return None
    stream.seek(size - _TAIL)
    tail = stream.read(_TAIL)
    opcode, length = RECORD_HEAD.unpack_from(tail)
    sound = opcode == FOOTER and length == _FOOTER.size and tail.endswith(MAGIC)
    return tail if sound else None


def _parse(section: memoryview) -> Summary:
    schemas: dict[int, Schema] = {}
    summary, messages = Summary(), None
    position = 0
    while position + RECORD_HEAD.size <= len(section):
        opcode, length = RECORD_HEAD.unpack_from(section, position)
        position += RECORD_HEAD.size
        if length > len(section) - position:
            raise LayoutError("a record of the summary reaches beyond its end")
        content = section[position : position + length]
        position += length
        if opcode == SCHEMA:
            schema = parse_schema(content)
            schemas[schema.id] = schema
        elif opcode == CHANNEL:
            channel = parse_channel(content, schemas)
            summary.channels[channel.id] = channel
        elif opcode == STATISTICS:
            messages = Fields(content).integer(8)
    return replace(summary, messages=messages)
