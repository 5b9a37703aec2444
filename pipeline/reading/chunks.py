"""Chunks of an MCAP file: unpacked within bounds, checked, and only then taken apart."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode

from wayside.pipeline.reading.layout import LARGEST_RECORD, MESSAGE_HEAD, RECORD_HEAD, LayoutError

# start, end, unpacked size, checksum, length of the compression's name
_FIXED = struct.Struct("<QQQII")
_LZ4_PIECE = 1 << 18
LARGEST_HEAD = _FIXED.size + 64 + 8


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What stands before a chunk's records; `size`: its own bytes."""

    start_ns: int
    end_ns: int
    unpacked_size: int
    checksum: int
    compression: str
    size: int


def parse_chunk_head(content: memoryview, record_length: int) -> ChunkHead:
    """Head of a chunk by the content of its record, or its first `LARGEST_HEAD` bytes.

    Raises
    ------
    LayoutError
        The head is cut off, or contradicts the length of the record's content.
    """
    if len(content) < _FIXED.size + 8:
        raise LayoutError("its head is incomplete")
    start, end, unpacked, checksum, name_length = _FIXED.unpack_from(content)
    size = _FIXED.size + name_length + 8
    if size > min(len(content), LARGEST_HEAD):
        raise LayoutError("the name of its compression is too long")
    name = bytes(content[_FIXED.size : size - 8]).decode("ascii", "replace")
    packed = int.from_bytes(content[size - 8 : size], "little")
    if size + packed != record_length:
        raise LayoutError(
            f"its records have {packed} bytes, its length leaves room for {record_length - size}"
        )
    return ChunkHead(start, end, unpacked, checksum, name, size)


def unpack_chunk(head: ChunkHead, packed: memoryview, *, whole: bool = True) -> memoryview:
    """The records of a chunk as bytes; unless it is `whole`, what can be had of its front, which nothing can check.

    Of lz4 and zstd whole blocks are unpacked. Whatever the compressed data would grow to, at most one byte more than
    the head says is made.

    Raises
    ------
    LayoutError
        It cannot be unpacked; size or checksum of a whole one differs.
    """
    limit = head.unpacked_size + 1
    try:
        if head.compression == "lz4":
            data = memoryview(_unpack_lz4(packed, limit))
        elif head.compression == "zstd":
            unpacker = zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD)
            with unpacker.stream_reader(packed, read_across_frames=True) as reader:
                data = memoryview(reader.read(limit))
        elif head.compression in ("", "none"):
            data = packed
        else:
            raise ValueError("an unknown compression")
    except (RuntimeError, EOFError, ValueError, MemoryError, zstandard.ZstdError) as error:
        raise LayoutError(f"{head.compression} cannot unpack it ({error})") from error
    if whole and len(data) != head.unpacked_size:
        raise LayoutError(f"it unpacks to {len(data)} bytes instead of {head.unpacked_size}")
    if whole and head.checksum and zlib.crc32(data) != head.checksum:
        raise LayoutError("its checksum differs")
    return data


def _unpack_lz4(packed: memoryview, limit: int) -> bytearray:
    """Piece by piece: the package holds what one call unpacks several times over."""
    unpacker, data = lz4.frame.LZ4FrameDecompressor(), bytearray()
    for start in range(0, len(packed), _LZ4_PIECE):
        data += unpacker.decompress(packed[start : start + _LZ4_PIECE])
        if len(data) >= limit or unpacker.eof:
            break
    return data


def find_records(data: memoryview, most: int) -> tuple[array[int], str]:
    """Where the records in a chunk or summary begin, and why no more follow (empty: the data end there).

    Raises
    ------
    LayoutError
        There are more than `most`.
    """
    offsets = array("Q")
    position, end = 0, len(data)
    while position < end:
        start = position + RECORD_HEAD.size
        if start > end:
            return offsets, "a record in it is cut off"
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        shortest = MESSAGE_HEAD.size if opcode == Opcode.MESSAGE else 0
        if opcode == 0 or not shortest <= length <= end - start:
            return offsets, f"a record in it of opcode {opcode} says it has {length} bytes"
        if len(offsets) >= most:
            raise LayoutError(
                f"it has over {most} records, with what came before more than the log has bytes"
            )
        offsets.append(position)
        position = start + length
    return offsets, ""


def take_records(data: memoryview, offsets: Iterable[int]) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of the records that begin at `offsets`, as views into the data."""
    for offset in offsets:
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        start = offset + RECORD_HEAD.size
        yield opcode, data[start : start + length]
