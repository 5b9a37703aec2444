"""Finding the next record behind bytes that make no sense."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import BinaryIO

from wayside.pipeline.reading.chunks import LARGEST_HEAD, ChunkError, parse_chunk_head
from wayside.pipeline.reading.layout import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    LAST_KNOWN,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    ONLY_IN_DATA,
    ONLY_IN_SUMMARY,
    RECORD_HEAD,
    SCHEMA,
    length_is_plausible,
)

_WINDOW = 1 << 20
_CANDIDATE = re.compile(rb"[\x05\x06\x0f](?=.{4}\x00{4})", re.DOTALL)
"""A message, chunk or end of data that is shorter than four gigabytes."""


def find_record(
    stream: BinaryIO, start: int, size: int, channels: Collection[int] | None
) -> int | None:
    """Offset of the first record from `start` on that can be recognised; None where there is none.

    Parameters
    ----------
    stream, size
        The file and its size; the position of the stream is left anywhere.
    channels
        Channels of which messages are looked for; None in a file with chunks, where what looks like a message
        is the inside of a broken chunk.
    """
    while start < size:
        stream.seek(start)
        window = stream.read(_WINDOW + RECORD_HEAD.size)
        for match in _CANDIDATE.finditer(window):
            if match.start() < _WINDOW and _is_record(
                stream, start + match.start(), size, channels
            ):
                return start + match.start()
        start += _WINDOW
    return None


def _is_record(stream: BinaryIO, offset: int, size: int, channels: Collection[int] | None) -> bool:
    stream.seek(offset)
    head = stream.read(RECORD_HEAD.size + LARGEST_HEAD)
    opcode, length = RECORD_HEAD.unpack_from(head)
    content = head[RECORD_HEAD.size :]
    end = offset + RECORD_HEAD.size + length
    if not length_is_plausible(opcode, length) or end > size:
        return False
    if opcode == CHUNK:
        return is_chunk(content, length)
    if opcode == MESSAGE:
        known = channels is not None and MESSAGE_HEAD.unpack_from(content)[0] in channels
        return known and follows_a_record(stream, end, size)
    return opcode == DATA_END and length == 4 and follows_a_record(stream, end, size)


def is_chunk(content: bytes, length: int) -> bool:
    """Whether the first bytes of a record's content are the head of a chunk of this length."""
    try:
        head, _ = parse_chunk_head(content, length)
    except ChunkError:
        return False
    return head.compression in ("", "none", "lz4", "zstd") and head.start_ns <= head.end_ns


def data_ends(stream: BinaryIO, opcode: int, offset: int) -> bool:
    """Whether a record of this opcode, `DATA_END` or `FOOTER`, that ends at `offset` can be the end of the data.

    Behind the end of the data stands the summary or the footer, behind the footer the file mark.
    """
    stream.seek(offset)
    head = stream.read(RECORD_HEAD.size)
    if opcode == FOOTER:
        return MAGIC.startswith(head[: len(MAGIC)])
    return not head or head[0] not in ONLY_IN_DATA


def follows_a_record(stream: BinaryIO, offset: int, size: int) -> bool:
    """Whether a record can begin at `offset`, or the file ends there."""
    if offset == size:
        return True
    stream.seek(offset)
    head = stream.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return True  # cut off within a record's head
    opcode, length = RECORD_HEAD.unpack(head)
    return 0 < opcode <= LAST_KNOWN and length_is_plausible(opcode, length)


def end_of_log(stream: BinaryIO, offset: int, size: int) -> int | None:
    """Where the end mark of a log ends whose summary or footer begins at `offset`; None where there is no such mark."""
    while offset + RECORD_HEAD.size <= size:
        stream.seek(offset)
        opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
        offset += RECORD_HEAD.size + length
        if opcode == FOOTER and offset + len(MAGIC) <= size:
            stream.seek(offset)
            return offset + len(MAGIC) if stream.read(len(MAGIC)) == MAGIC else None
        if opcode not in (SCHEMA, CHANNEL, *ONLY_IN_SUMMARY):
            return None
    return None
