"""Where records begin: told from bytes that are none, and found again behind damage."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import BinaryIO

from mcap.opcode import Opcode

from wayside.pipeline.reading.layout import (
    ENDS,
    LARGEST_CHUNK_HEAD,
    LATEST_NS,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Channel,
    LayoutError,
    RecordHead,
    parse_chunk_head,
)

LARGEST_ATTACHMENT = 1 << 20
"""Larger attachments are passed over unread: a calibration is a few hundred bytes."""
_WINDOW = 1 << 14
# Records shorter than four gigabytes. Messages and definitions stand in chunks as well: where there are chunks, what
# looks like one is the inside of a broken chunk.
_OUTSIDE_CHUNKS = re.compile(rb"[\x06\x09\x0c\x0f](?=.{4}\x00{4})", re.DOTALL)
_ANYWHERE = re.compile(rb"[\x03-\x06\x09\x0c\x0f](?=.{4}\x00{4})", re.DOTALL)


@dataclass(slots=True)
class RecordFinder:
    """Finds records in a file; every method moves the stream.

    `channels`: those known, by id. `end`: where the last record ends at most. `cut`: there the file ends, perhaps
    within a record. `chunked`: its messages stand in chunks.
    """

    stream: BinaryIO
    channels: Mapping[int, Channel]
    end: int
    cut: bool = True
    chunked: bool = False

    def bytes_at(self, offset: int, count: int) -> memoryview:
        """So many bytes, or as many as there are."""
        self.stream.seek(offset)
        return memoryview(self.stream.read(count))

    def head_at(self, offset: int, *, damaged: bool = False) -> RecordHead | None:
        """Head of a record, None where none can begin, unless it is `damaged`; it may reach beyond the end."""
        found = self.bytes_at(offset, RECORD_HEAD.size)
        if len(found) < RECORD_HEAD.size:
            return None
        opcode, length = RECORD_HEAD.unpack(found)
        head = RecordHead(opcode, length, offset)
        return head if damaged or head.plausible else None

    def follows(self, offset: int) -> bool:
        """Whether a record begins here, also one whose kind or length is damaged, or none is left.

        A message of a known channel is recognised by its content, whatever its length, and an end by its length. Other
        kinds, private ones among them, look like garbage: behind them another record must begin.
        """
        if self._is_end(offset) or self._is_known_message(offset):
            return True
        head = self.head_at(offset, damaged=True)
        if head is None or offset > self.end:
            return False
        inside = head.end < self.end
        if self._is_end(head.end) or (inside and self._is_known_message(head.end)):
            return True
        behind = self.head_at(head.end) is not None if inside else self.cut
        return head.plausible and (behind or head.opcode in ENDS)

    def _is_end(self, offset: int) -> bool:
        """Whether no record is left, or too little of one to be told."""
        left = self.end - offset
        return left == 0 or (self.cut and 0 < left < RECORD_HEAD.size)

    def _is_known_message(self, offset: int) -> bool:
        found = self.bytes_at(offset, RECORD_HEAD.size + MESSAGE_HEAD.size)
        if len(found) < RECORD_HEAD.size + MESSAGE_HEAD.size or found[0] != Opcode.MESSAGE:
            return False
        channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(found, RECORD_HEAD.size)
        return channel_id in self.channels and 0 < log_time_ns < LATEST_NS

    def is_chunk(self, head: RecordHead) -> bool:
        """Whether the record is a chunk whose head agrees with its length."""
        if head.opcode != Opcode.CHUNK:
            return False
        try:
            parse_chunk_head(self.bytes_at(head.content, LARGEST_CHUNK_HEAD), head.length)
        except LayoutError:
            return False
        return True

    def find(self, start: int) -> int | None:
        """Offset of the first record from `start` on whose kind and length agree with the bytes after it, or None."""
        pattern = _OUTSIDE_CHUNKS if self.chunked else _ANYWHERE
        while start < self.end:
            window = self.bytes_at(start, _WINDOW + RECORD_HEAD.size)
            for match in pattern.finditer(window):
                head = self.head_at(start + match.start())
                if head is None or head.end > self.end or match.start() >= _WINDOW:
                    continue
                if self.is_chunk(head) or (head.opcode != Opcode.CHUNK and self.follows(head.end)):
                    return head.start
            start += _WINDOW
        return None
