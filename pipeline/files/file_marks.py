"""Marks by which wayside knows its own images and pages again, so that it replaces no others."""

from __future__ import annotations

import struct
import zlib
from html import escape
from pathlib import Path

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 33
"""Signature and image header of a PNG; text may follow."""


def marked_png(png: bytes, mark: str) -> bytes:
    """The same image with a text of the keyword `Source`; PNG specification, section 11.3.3.2 (tEXt)."""
    return png[:_HEADER_BYTES] + _text_chunk(mark) + png[_HEADER_BYTES:]


def marked_head(mark: str) -> str:
    """What says the same in the head of a page."""
    return f'<meta name="generator" content="{escape(mark)}">'


def is_marked(path: Path, mark: str) -> bool:
    """Whether a PNG file or a page bears a mark.

    Raises
    ------
    OSError
        It cannot be read.
    """
    chunk, head = _text_chunk(mark), marked_head(mark).encode()
    with path.open("rb") as stream:
        start = stream.read(_HEADER_BYTES + len(chunk) + 1024)
    if start.startswith(_SIGNATURE):
        return start[_HEADER_BYTES:].startswith(chunk)
    return head in start


def _text_chunk(mark: str) -> bytes:
    body = b"tEXt" + b"Source\0" + mark.encode("ascii", "backslashreplace")
    return struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
