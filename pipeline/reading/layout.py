"""Records of an MCAP file, taken from bytes with every length checked; the `mcap` package parses their fields.

MCAP specification: https://mcap.dev/spec.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from wayside.pipeline.files.visible_text import visible

MAGIC = b"\x89MCAP0\r\n"
ENDS = (Opcode.DATA_END, Opcode.FOOTER)
LAST_KNOWN = max(Opcode)

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_FOOTER = RECORD_HEAD.pack(Opcode.FOOTER, 20)
_SUMMARISED = Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS
_LZ4_PIECE = 1 << 18

LATEST_NS = 1 << 62
"""Times from here on (year 2116) are invalid: sums and differences of two valid ones fit 64 bits."""
LARGEST_RECORD = 1 << 29
"""Longer records and larger chunks are taken for damage: half a gigabyte is far beyond any recorder's chunks."""
UNPACKED_RATIO, EXTRA_BYTES = 255, 500_000
"""lz4 reaches 255; the bytes added to the size of a log leave room for short ones of images of one colour."""

_SHORTEST = (0, 8, 20, 14, 16, MESSAGE_HEAD.size, 40, 6, 64, 36, 48, 46, 8, 20, 17, 4)
"""Bytes that the fixed fields of each kind take, by opcode."""

PARSED: dict[int, Any] = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK: records.Chunk,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.ATTACHMENT: records.Attachment,
}
"""Kinds whose inner lengths show whether the length of the record is right."""


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
    """Kind of a record, and where in the file it begins, its content begins, and it ends."""

    opcode: int
    start: int
    content: int
    end: int


def parse_head(data: bytes, start: int) -> RecordHead | None:
    """Head of the record that begins with these bytes; None where no record of its kind can be so long."""
    if len(data) < RECORD_HEAD.size:
        return None
    opcode, length = RECORD_HEAD.unpack(data)
    shortest = _SHORTEST[opcode] if opcode <= LAST_KNOWN else 1
    longest = 1 << 62 if opcode == Opcode.ATTACHMENT else LARGEST_RECORD
    step = {Opcode.MESSAGE_INDEX: 16}.get(opcode, 1)
    if opcode in ENDS:
        longest = shortest
    if opcode == 0 or not shortest <= length <= longest or (length - shortest) % step:
        return None
    content = start + RECORD_HEAD.size
    return RecordHead(opcode, start, content, content + length)


@dataclass(slots=True)
class Budget:
    """Bytes that chunks of a log may still unpack to; a record counts as `UNPACKED_RATIO` of them."""

    left: int

    @classmethod
    def of(cls, size: int) -> "Budget":
        """What a log of so many bytes may cost: a multiple of its size, whatever it states."""
        return cls(UNPACKED_RATIO * (size + EXTRA_BYTES))

    def take(self, cost: int) -> None:
        """Use some of it; raises LayoutError where less is left."""
        if cost > self.left:
            raise LayoutError(
                f"with what came before it unpacks to more than {UNPACKED_RATIO} times the size of the log"
            )
        self.left -= cost


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
    except UnicodeDecodeError as error:
        raise LayoutError("the name of its compression is not text") from error
    if opcode == Opcode.ATTACHMENT:
        end = stream.count - 4
        expected = int.from_bytes(content[end : end + 4], "little")
        if expected and zlib.crc32(content[:end]) != expected:
            raise LayoutError(f"the checksum of {record.name} differs")
    return record, len(content) - stream.count


def unpack_chunk(chunk: records.Chunk, budget: Budget) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of the records of a chunk, as views.

    Raises LayoutError where it cannot be unpacked or costs too much, or where its size, its checksum or the length of
    a record in it is wrong.
    """
    if chunk.uncompressed_size > LARGEST_RECORD:
        raise LayoutError(f"it says it unpacks to {chunk.uncompressed_size} bytes")
    budget.take(chunk.uncompressed_size)
    try:
        data = _unpacked(chunk.compression, chunk.data, chunk.uncompressed_size + 1)
    except (RuntimeError, EOFError, ValueError, MemoryError, zstandard.ZstdError) as error:
        raise LayoutError(f"{chunk.compression} cannot unpack it ({error})") from error
    if len(data) != chunk.uncompressed_size:
        raise LayoutError(f"it unpacks to {len(data)} bytes instead of {chunk.uncompressed_size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise LayoutError("its checksum differs")
    most = budget.left // UNPACKED_RATIO + 1
    budget.take(UNPACKED_RATIO * sum(1 for _ in islice(records_in(data), most)))
    return records_in(data)


def _unpacked(compression: str, packed: bytes, limit: int) -> memoryview:
    """Unpacked bytes, about `limit` of them at most."""
    if compression == "lz4":
        unpacker, pieces = lz4.frame.LZ4FrameDecompressor(), bytearray()
        # Piece by piece: the package holds what one call unpacks several times over.
        for start in range(0, len(packed), _LZ4_PIECE):
            pieces += unpacker.decompress(packed[start : start + _LZ4_PIECE])
            if len(pieces) >= limit or unpacker.eof:
                break
        return memoryview(pieces)
    if compression == "zstd":
        zstd = zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD)
        with zstd.stream_reader(packed, read_across_frames=True) as reader:
            return memoryview(reader.read(limit))
    if compression not in ("", "none"):
        raise ValueError("an unknown compression")
    return memoryview(packed)


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


def read_summary(stream: BinaryIO, size: int) -> list[Any]:
    """Schemas, channels and statistics of the summary of a log of `size` bytes; moves the stream.

    None where the log does not end in a summary, or it is damaged.
    """
    end = size - len(_FOOTER) - 20 - len(MAGIC)
    stream.seek(max(end, 0))
    tail = stream.read(size)
    if not (tail.startswith(_FOOTER) and tail.endswith(MAGIC)):
        return []
    footer, _ = parse_record(Opcode.FOOTER, memoryview(tail)[len(_FOOTER) : -len(MAGIC)])
    if not footer.summary_start or not 0 <= end - footer.summary_start <= LARGEST_RECORD:
        return []
    stream.seek(footer.summary_start)
    section = stream.read(end - footer.summary_start)
    checksum = zlib.crc32(tail[: -len(MAGIC) - 4], zlib.crc32(section))
    if footer.summary_crc not in (0, checksum):
        return []
    try:
        found = [one for one in records_in(memoryview(section)) if one[0] in _SUMMARISED]
        return [parse_record(*one)[0] for one in found]
    except LayoutError:
        return []
