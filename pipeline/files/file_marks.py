"""Marks by which wayside knows its own images and pages again, so that it replaces no others."""

from __future__ import annotations

import struct
import zlib
from html import escape
from pathlib import Path

_HEADER_BYTES = 33
"""Signature and image header of a PNG; text may follow."""


def marked_png(png: bytes, mark: str) -> bytes:
    """The same image with a text of the keyword `Source`; PNG specification, section 11.3.3.2 (tEXt)."""
    return png[:_HEADER_BYTES] + _text_chunk(mark) + png[_HEADER_BYTES:]


def marked_head(mark: str) -> str:
    """What says the same in the head of a page."""
    return f'<meta name="generator" content="{escape(mark)}">'


def is_marked(path: Path, mark: str) -> bool:
    """Whether a PNG file or a page bears a mark; raises OSError where it cannot be read."""
    with path.open("rb") as stream:
        start = stream.read(2048)
    return _text_chunk(mark) in start or marked_head(mark).encode() in start


def _text_chunk(mark: str) -> bytes:
    body = b"tEXt" + b"Source\0" + mark.encode("ascii", "backslashreplace")
    return struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
