"""What the records of an MCAP file hold, and how to take them from bytes with every length checked.

MCAP specification, https://mcap.dev/spec. The fields of a record are taken apart by the `mcap` package.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from wayside.pipeline.visible_text import visible

MAGIC = b"\x89MCAP0\r\n"

LAST_KNOWN = max(Opcode)
ENDS = (Opcode.DATA_END, Opcode.FOOTER)

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

LATEST_NS = 1 << 62
"""Times from here on (year 2116) are no times: sums and differences of two others fit 64 bits."""

LARGEST_RECORD = 1 << 29
"""Longer records and larger chunks are taken for damage: half a gigabyte is far beyond any recorder's chunks."""

_SHORTEST = (0, 8, 20, 14, 16, MESSAGE_HEAD.size, 40, 6, 64, 36, 48, 46, 8, 20, 17, 4)
"""Bytes that the fixed fields of each kind take, by opcode."""

_PARSED: dict[int, Any] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.METADATA: records.Metadata,
    Opcode.ATTACHMENT: records.Attachment,
}
PARSED = frozenset(_PARSED)
"""Kinds whose own lengths tell whether the length of the record is right."""


class LayoutError(ValueError):
    """A record that contradicts itself, in words that follow "a chunk of 20 bytes lost:"."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with the encoding of its messages; `schema` is None where the log gives none."""

    id: int
    topic: str
    encoding: str
    schema_id: int
    schema: records.Schema | None

    @property
    def schema_name(self) -> str:
        """Name of the message type, empty where unknown."""
        return "" if self.schema is None else self.schema.name


def length_is_plausible(opcode: int, length: int) -> bool:
    """Whether a record of this kind can be this long; none has opcode 0."""
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

    Raises
    ------
    LayoutError
        A field reaches beyond the content, or the checksum of an attachment differs.
    """
    stream = _Content(BytesIO(content))
    try:
        record = _PARSED[opcode].read(stream)
    except EndOfFile as error:
        raise LayoutError("a field of it reaches beyond its end") from error
    if opcode == Opcode.ATTACHMENT:
        end = stream.count - 4
        expected = int.from_bytes(content[end : end + 4], "little")
        if expected and zlib.crc32(content[:end]) != expected:
            raise LayoutError(f"the checksum of {record.name} differs")
    return record, len(content) - stream.count
