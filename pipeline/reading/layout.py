"""What the records of an MCAP file hold, and how to take them from bytes with every length checked.

MCAP specification, https://mcap.dev/spec: little-endian integers, strings and maps with a uint32 length in bytes.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from wayside.pipeline.visible_text import visible

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX = 0x07, 0x08, 0x09, 0x0A
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F
LAST_KNOWN = DATA_END
ONLY_IN_SUMMARY = (CHUNK_INDEX, ATTACHMENT_INDEX, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET)
ONLY_IN_DATA = (MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA)

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

LATEST_NS = 1 << 62
"""Times from here on (year 2116) are no times: sums and differences of two others fit 64 bits."""

LARGEST_RECORD = 1 << 29
"""Longer records and larger chunks are taken for damage: half a gigabyte is far beyond any recorder's chunks."""

_LENGTH_LIMITS = {
    FOOTER: (20, 64),
    SCHEMA: (14, 1 << 26),
    CHANNEL: (16, 1 << 26),
    MESSAGE: (MESSAGE_HEAD.size, LARGEST_RECORD),
    CHUNK: (40, LARGEST_RECORD),
    ATTACHMENT: (36, 1 << 62),
    METADATA: (8, 1 << 26),
    DATA_END: (4, 64),
}
_OTHER_LIMITS = (0, LARGEST_RECORD)


class LayoutError(ValueError):
    """A record's content contradicts its own lengths."""


@dataclass(frozen=True, slots=True)
class Schema:
    """Name and definition of a message type."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with the encoding of its messages; `schema` is None where the log gives none."""

    id: int
    topic: str
    encoding: str
    schema_id: int
    schema: Schema | None

    @property
    def schema_name(self) -> str:
        """Name of the message type, empty where unknown."""
        return "" if self.schema is None else self.schema.name


@dataclass(frozen=True, slots=True)
class Metadata:
    """Named key-value pairs."""

    name: str
    values: dict[str, str]


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried in the log."""

    name: str
    media_type: str
    data: bytes


def length_is_plausible(opcode: int, length: int) -> bool:
    """Whether a record of this kind can be this long."""
    low, high = _LENGTH_LIMITS.get(opcode, _OTHER_LIMITS)
    return low <= length <= high


class Fields:
    """Takes one field after the other from a record's content; raises LayoutError where it is too short."""

    def __init__(self, content: memoryview) -> None:
        self.content, self.position = content, 0

    def integer(self, size: int) -> int:
        """Unsigned integer of `size` bytes."""
        return int.from_bytes(self._take(size), "little")

    def block(self, length_size: int = 4) -> bytes:
        """Bytes behind their own length, an integer of `length_size` bytes."""
        return self._take(self.integer(length_size))

    def text(self) -> str:
        """String; bytes that are no UTF-8 are replaced, since a damaged name must not end the reading.

        Control characters come as their escapes: names are shown, compared and typed.
        """
        return visible(self.block().decode("utf-8", "replace"))

    def mapping(self) -> dict[str, str]:
        """Map of strings."""
        end = self.integer(4) + self.position
        if end > len(self.content):
            raise LayoutError("its map reaches beyond its end")
        values: dict[str, str] = {}
        while self.position < end:
            key = self.text()
            values[key] = self.text()
        return values

    def _take(self, count: int) -> bytes:
        end = self.position + count
        if end > len(self.content):
            raise LayoutError(f"a field of {count} bytes reaches beyond its end")
        taken = bytes(self.content[self.position : end])
        self.position = end
        return taken


def parse_schema(content: memoryview) -> Schema:
    """Schema record; raises LayoutError."""
    fields = Fields(content)
    return Schema(fields.integer(2), fields.text(), fields.text(), fields.block())


def parse_channel(content: memoryview, schemas: dict[int, Schema]) -> Channel:
    """Channel record with its schema looked up; raises LayoutError."""
    fields = Fields(content)
    channel_id, schema_id = fields.integer(2), fields.integer(2)
    topic, encoding = fields.text(), fields.text()
    return Channel(channel_id, topic, encoding, schema_id, schemas.get(schema_id))


def is_message_index(content: memoryview) -> bool:
    """Whether the content of a record is a message index: a channel and an array of times and offsets that fills it."""
    return (
        len(content) >= 6
        and int.from_bytes(content[2:6], "little") == len(content) - 6
        and (len(content) - 6) % 16 == 0
    )


def parse_metadata(content: memoryview) -> Metadata:
    """Metadata record; raises LayoutError."""
    fields = Fields(content)
    return Metadata(fields.text(), fields.mapping())


def parse_attachment(content: memoryview) -> Attachment:
    """Attachment record, its checksum tested; raises LayoutError."""
    fields = Fields(content)
    fields.integer(8)  # log time
    fields.integer(8)  # creation time
    name, media_type, data = fields.text(), fields.text(), fields.block(8)
    end = fields.position
    expected = fields.integer(4)
    if expected and zlib.crc32(content[:end]) != expected:
        raise LayoutError(f"the checksum of {name} differs")
    return Attachment(name, media_type, data)
