"""Chunks of an MCAP file: unpacked within bounds, checked, and only then taken apart."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from wayside.pipeline.reading.layout import (
    CHANNEL,
    LARGEST_RECORD,
    MESSAGE,
    MESSAGE_HEAD,
    RECORD_HEAD,
    SCHEMA,
)

_FIXED = struct.Struct(
    "<QQQII"
)  # start, end, unpacked size, checksum, length of the compression's name
_LONGEST_NAME = 64
_LARGEST_WINDOW = 1 << 29


class ChunkError(ValueError):
    """A chunk that cannot be used, in words that follow "a chunk lost:"."""


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What stands before a chunk's records."""

    start_ns: int
    end_ns: int
    unpacked_size: int
    checksum: int
    compression: str
    packed_size: int

    @property
    def times_known(self) -> bool:
        """Whether the chunk says from when to when its messages are."""
        return 0 < self.start_ns <= self.end_ns


LARGEST_HEAD = _FIXED.size + _LONGEST_NAME + 8


def parse_chunk_head(content: bytes, record_length: int) -> tuple[ChunkHead, int]:
    """Head of a chunk record, and its size in bytes.

    Parameters
    ----------
    content
        The first bytes of the record's content, `LARGEST_HEAD` or as many as there are.
    record_length
        Length of the whole content, which the head must agree with.

    Raises
    ------
    ChunkError
        The head contradicts the record's length: one of them is damaged.
    """
    if len(content) < _FIXED.size + 8:
        raise ChunkError("its head is incomplete")
    start, end, unpacked, checksum, name_length = _FIXED.unpack_from(content)
    size = _FIXED.size + name_length + 8
    if name_length > _LONGEST_NAME or size > len(content):
        raise ChunkError("the name of its compression is too long")
    name = content[_FIXED.size : size - 8].decode("ascii", "replace")
    packed = int.from_bytes(content[size - 8 : size], "little")
    if size + packed != record_length:
        raise ChunkError(
            f"its records have {packed} bytes, its length leaves room for {record_length - size}"
        )
    return ChunkHead(start, end, unpacked, checksum, name, packed), size


def unpack_chunk(head: ChunkHead, packed: bytes) -> list[tuple[int, memoryview]]:
    """Opcode and content of each schema, channel and message in a chunk, as views into the unpacked bytes.

    Raises
    ------
    ChunkError
        Size, compression, checksum or an inner length is wrong; nothing of the chunk is to be trusted then.
    """
    if head.unpacked_size > LARGEST_RECORD:
        raise ChunkError(f"it says it unpacks to {head.unpacked_size} bytes")
    data = _decompress(head, packed)
    if len(data) != head.unpacked_size:
        raise ChunkError(f"it unpacks to {len(data)} bytes instead of {head.unpacked_size}")
    if head.checksum and zlib.crc32(data) != head.checksum:
        raise ChunkError("its checksum differs")
    return _take_apart(memoryview(data))


def _decompress(head: ChunkHead, packed: bytes) -> bytes:
    """At most one byte more than the head says, whatever the compressed data would grow to."""
    limit = head.unpacked_size + 1
    try:
        if head.compression in ("", "none"):
            return packed
        if head.compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=limit))
        if head.compression == "zstd":
            unpacker = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)
            if zstandard.frame_content_size(packed) == head.unpacked_size:
                return unpacker.decompress(packed)
            with unpacker.stream_reader(packed, read_across_frames=True) as reader:
                return reader.read(limit)
    except (RuntimeError, EOFError, ValueError, MemoryError, zstandard.ZstdError) as error:
        raise ChunkError(f"{head.compression} cannot unpack it ({error})") from error
    raise ChunkError(f"its compression {head.compression!r} is unknown")


def _take_apart(data: memoryview) -> list[tuple[int, memoryview]]:
    records: list[tuple[int, memoryview]] = []
    position, end = 0, len(data)
    while position < end:
        if position + RECORD_HEAD.size > end:
            raise ChunkError("a record in it is cut off")
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        position += RECORD_HEAD.size
        if length > end - position or (opcode == MESSAGE and length < MESSAGE_HEAD.size):
            raise ChunkError(f"a record in it says it has {length} bytes")
        if opcode in (MESSAGE, SCHEMA, CHANNEL):
            records.append((opcode, data[position : position + length]))
        position += length
    return records
