"""Chunks of an MCAP file: unpacked within bounds, checked, and only then taken apart."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from wayside.pipeline.reading.layout import (
    CHANNEL,
    LAST_KNOWN,
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
_LZ4_PIECE = 1 << 18


class ChunkError(ValueError):
    """A chunk that cannot be used, in words that follow "a chunk lost:"."""


class TooMuchError(ChunkError):
    """A chunk that unpacks to more than its log may."""


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What stands before a chunk's records."""

    start_ns: int
    end_ns: int
    unpacked_size: int
    checksum: int
    compression: str

    def span_after(self, zero_ns: int | None) -> str:
        """From when to when its messages are, counted from the first of the log; empty where that is not known."""
        if zero_ns is None or not 0 < self.start_ns <= self.end_ns:
            return ""
        begin, end = (self.start_ns - zero_ns) / 1e9, (self.end_ns - zero_ns) / 1e9
        return f" ({begin:.2f} s to {end:.2f} s after the first message)"


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
    return ChunkHead(start, end, unpacked, checksum, name), size


def unpack_chunk(head: ChunkHead, packed: memoryview) -> memoryview:
    """The records of a chunk as bytes, unpacked but not compared with their checksum.

    Raises
    ------
    ChunkError
        Size or compression is wrong.
    """
    data = memoryview(_decompress(head, packed))
    if len(data) != head.unpacked_size:
        raise ChunkError(f"it unpacks to {len(data)} bytes instead of {head.unpacked_size}")
    return data


def check_chunk(head: ChunkHead, data: memoryview) -> None:
    """Compare the unpacked records of a chunk with its checksum, where it has one; raises ChunkError."""
    if head.checksum and zlib.crc32(data) != head.checksum:
        raise ChunkError("its checksum differs")


def _decompress(head: ChunkHead, packed: memoryview) -> bytes | bytearray | memoryview:
    """At most one byte more than the head says, whatever the compressed data would grow to."""
    limit = head.unpacked_size + 1
    try:
        if head.compression in ("", "none"):
            return packed
        if head.compression == "lz4":
            return _unpack_lz4(packed, limit)
        if head.compression == "zstd":
            with zstd_unpacker().stream_reader(packed, read_across_frames=True) as reader:
                return reader.read(limit)
    except (RuntimeError, EOFError, ValueError, MemoryError, zstandard.ZstdError) as error:
        raise ChunkError(f"{head.compression} cannot unpack it ({error})") from error
    raise ChunkError(f"its compression {head.compression!r} is unknown")


def _unpack_lz4(packed: memoryview, limit: int) -> bytearray:
    """Piece by piece: the package holds what one call unpacks several times over."""
    unpacker, data = lz4.frame.LZ4FrameDecompressor(), bytearray()
    for start in range(0, len(packed), _LZ4_PIECE):
        data += unpacker.decompress(packed[start : start + _LZ4_PIECE])
        if len(data) >= limit or unpacker.eof:
            break
    return data


def zstd_unpacker() -> zstandard.ZstdDecompressor:
    """Unpacks zstd frames that need a window of half a gigabyte at most."""
    return zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)


class RecordOffsets(NamedTuple):
    """Where the schemas, channels and messages in a chunk begin, how many records it has, and why no more follow.

    misplaced: how many of its records are of kinds that stand outside of chunks, as chunks do.
    """

    offsets: array[int]
    records: int
    fault: str
    misplaced: int = 0


def find_records(data: memoryview, most: int) -> RecordOffsets:
    """Walk the records of a chunk up to its end, or to the first that cannot be (`fault` says why).

    Parameters
    ----------
    data
        What the chunk unpacks to.
    most
        Records that it may have.

    Raises
    ------
    TooMuchError
        It has more.
    """
    offsets = array("Q")
    position, end, count, misplaced = 0, len(data), 0, 0
    while position < end:
        if position + RECORD_HEAD.size > end:
            return RecordOffsets(offsets, count, "a record in it is cut off")
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        inside = end - position - RECORD_HEAD.size
        if opcode == 0:
            return RecordOffsets(offsets, count, "a record in it has no kind (opcode 0)")
        if length > inside or (opcode == MESSAGE and length < MESSAGE_HEAD.size):
            return RecordOffsets(offsets, count, f"a record in it says it has {length} bytes")
        count += 1
        if count > most:
            raise TooMuchError(
                f"it has over {most} records, with what came before more than the log has bytes; "
                "if this is right, raise the setting read.unpacked_extra_kb"
            )
        if opcode in (MESSAGE, SCHEMA, CHANNEL):
            offsets.append(position)
        elif opcode <= LAST_KNOWN:
            misplaced += 1
        position += RECORD_HEAD.size + length
    return RecordOffsets(offsets, count, "", misplaced)


def take_records(data: memoryview, offsets: Iterable[int]) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of the records that begin at `offsets`, as views into the data."""
    for offset in offsets:
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        start = offset + RECORD_HEAD.size
        yield opcode, data[start : start + length]
