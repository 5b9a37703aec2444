"""What the records and chunks of an MCAP file hold, and how to take them from bytes with every length checked.

MCAP specification, https://mcap.dev/spec. The fields of a record are taken apart by the `mcap` package.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from wayside.pipeline.files.visible_text import visible

MAGIC = b"\x89MCAP0\r\n"

LAST_KNOWN = max(Opcode)
ENDS = (Opcode.DATA_END, Opcode.FOOTER)

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
# start, end, unpacked size, checksum, length of the compression's name
_CHUNK_HEAD = struct.Struct("<QQQII")
LARGEST_CHUNK_HEAD = _CHUNK_HEAD.size + 64 + 8
_LZ4_PIECE = 1 << 18

LATEST_NS = 1 << 62
"""Times from here on (year 2116) are no times: sums and differences of two others fit 64 bits."""

LARGEST_RECORD = 1 << 29
"""Longer records and larger chunks are taken for damage: half a gigabyte is far beyond any recorder's chunks."""

_SHORTEST = (0, 8, 20, 14, 16, MESSAGE_HEAD.size, 40, 6, 64, 36, 48, 46, 8, 20, 17, 4)
"""Bytes that the fixed fields of each kind take, by opcode."""

PARSED: dict[int, Any] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.METADATA: records.Metadata,
    Opcode.ATTACHMENT: records.Attachment,
}
"""Kinds whose own lengths tell whether the length of the record is right."""


class LayoutError(ValueError):
    """A record that contradicts itself, in words that follow "a chunk of 20 bytes lost:"."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with the encoding of its messages, and its `schema` or None."""

    id: int
    topic: str
    encoding: str
    schema_id: int
    schema: records.Schema | None

    @property
    def schema_name(self) -> str:
        """Name of the message type, empty where unknown."""
        return "" if self.schema is None else self.schema.name


class RecordHead(NamedTuple):
    """Kind of a record, how long its content is, and where the record begins in the file."""

    opcode: int
    length: int
    start: int

    @property
    def content(self) -> int:
        """Where its content begins."""
        return self.start + RECORD_HEAD.size

    @property
    def end(self) -> int:
        """Where it ends."""
        return self.content + self.length

    @property
    def plausible(self) -> bool:
        """Whether a record of this kind can be this long; none has opcode 0."""
        opcode, length = self.opcode, self.length
        shortest = _SHORTEST[opcode] if opcode <= LAST_KNOWN else 1
        if opcode in ENDS:
            return length == shortest
        if opcode == 0 or (opcode == Opcode.MESSAGE_INDEX and length % 16 != shortest):
            return False
        return shortest <= length <= (1 << 62 if opcode == Opcode.ATTACHMENT else LARGEST_RECORD)


class _Content(ReadDataStream):
    """The content of one record; raises EndOfFile where a field is longer than it."""

    def read(self, length: int) -> bytes:
        data = super().read(min(length, LARGEST_RECORD))
        if len(data) < length:
            raise EndOfFile
        return data

    def read_prefixed_string(self) -> str:
        """Bytes that are no UTF-8 are replaced, and control characters escaped: names are shown, compared and typed."""
        return visible(self.read(self.read4()).decode("utf-8", "replace"))


def parse_record(opcode: int, content: memoryview) -> tuple[Any, int]:
    """A record of one of the kinds `PARSED` as the `mcap` package has it, and how many bytes stand behind its fields.

    Raises LayoutError where a field reaches beyond the content, or the checksum of an attachment differs.
    """
    stream = _Content(BytesIO(content))
    try:
        record = PARSED[opcode].read(stream)
    except EndOfFile as error:
        raise LayoutError("a field of it reaches beyond its end") from error
    if opcode == Opcode.ATTACHMENT:
        end = stream.count - 4
        expected = int.from_bytes(content[end : end + 4], "little")
        if expected and zlib.crc32(content[:end]) != expected:
            raise LayoutError(f"the checksum of {record.name} differs")
    return record, len(content) - stream.count


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """The head of a chunk's records; `size`: its own bytes."""

    unpacked_size: int
    checksum: int
    compression: str
    size: int


def parse_chunk_head(content: memoryview, record_length: int) -> ChunkHead:
    """Head of a chunk by the content of its record, or the first `LARGEST_CHUNK_HEAD` bytes of it.

    Raises LayoutError where it is cut off, or contradicts the length of the content.
    """
    if len(content) < _CHUNK_HEAD.size + 8:
        raise LayoutError("its head is incomplete")
    _, _, unpacked, checksum, name_length = _CHUNK_HEAD.unpack_from(content)
    size = _CHUNK_HEAD.size + name_length + 8
    if size > min(len(content), LARGEST_CHUNK_HEAD):
        raise LayoutError("the name of its compression is too long")
    name = bytes(content[_CHUNK_HEAD.size : size - 8]).decode("ascii", "replace")
    packed = int.from_bytes(content[size - 8 : size], "little")
    if size + packed != record_length:
        raise LayoutError(
            f"its records have {packed} bytes, its length leaves room for {record_length - size}"
        )
    return ChunkHead(unpacked, checksum, name, size)


def unpack_chunk(head: ChunkHead, packed: memoryview, *, whole: bool = True) -> memoryview:
    """The records of a chunk as bytes; unless it is `whole`, what can be had of its front, which nothing can check.

    Of lz4 and zstd whole blocks are unpacked. Whatever the compressed data would grow to, at most one byte more than
    the head says is made. Raises LayoutError where it cannot be unpacked, or size or checksum of a whole one differs.
    """
    limit = head.unpacked_size + 1
    try:
        if head.compression == "lz4":
            lz4_unpacker, pieces = lz4.frame.LZ4FrameDecompressor(), bytearray()
            # Piece by piece: the package holds what one call unpacks several times over.
            for start in range(0, len(packed), _LZ4_PIECE):
                pieces += lz4_unpacker.decompress(packed[start : start + _LZ4_PIECE])
                if len(pieces) >= limit or lz4_unpacker.eof:
                    break
            data = memoryview(pieces)
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


def records_in(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of the records of a chunk or summary, as views; LayoutError where not all of one is there."""
    position, end = 0, len(data)
    while position < end:
        start = position + RECORD_HEAD.size
        opcode, length = RECORD_HEAD.unpack_from(data, position) if start <= end else (0, 0)
        shortest = MESSAGE_HEAD.size if opcode == Opcode.MESSAGE else 0
        if opcode == 0 or not shortest <= length <= end - start:
            raise LayoutError(f"a record in it of opcode {opcode} says it has {length} bytes")
        position = start + length
        yield opcode, data[start:position]
