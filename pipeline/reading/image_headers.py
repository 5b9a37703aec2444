"""Format and size of a compressed image from its header, without decoding it."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from wayside.pipeline.reading.h264 import H264, read_stream

_PNG = b"\x89PNG\r\n\x1a\n"
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD9)})
_FORMAT_WORDS = {w: w for w in ("jpeg", "png", "webp", "tiff", "bmp", "avif", "h264")} | {
    "jpg": "jpeg",
    "tif": "tiff",
}
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257


class ImageHeader(NamedTuple):
    """Format ("jpeg", "png", "webp", "tiff", "bmp", "avif", "h264") and size in pixels of a compressed image."""

    encoding: str
    width: int
    height: int


def read_image_header(data: bytes | memoryview) -> ImageHeader | None:
    """Header of an image; None where it is of none of these formats, or cut before its size.

    JPEG (ITU-T T.81, annex B), PNG, WebP (RFC 9649), TIFF 6.0 (its first image), BMP, AVIF (the largest size it names),
    H.264 (a piece that begins with its sequence set).
    """
    start = bytes(data[:16])
    if start[:2] == b"\xff\xd8":
        return _read_jpeg(data)
    if start[:8] == _PNG and start[12:16] == b"IHDR":
        return _sized("png", data, (16, 4), (20, 4), "big")
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return _read_webp(data, start[12:16])
    if start[:4] in (b"II*\0", b"MM\0*"):
        return _read_tiff(data, "little" if start[:2] == b"II" else "big")
    if start[:2] == b"BM":
        return _sized("bmp", data, (18, 4), (22, 4), "little")
    if start[:4] == b"\0\0\0\1" or start[:3] == b"\0\0\1":
        return _read_h264(data)
    if start[4:12] in (b"ftypavif", b"ftypavis"):
        return _read_avif(bytes(data[:4096]))
    return None


def format_word(text: str) -> str:
    """The image format in the free text of a message ("bgr8; jpeg compressed bgr8"); the text itself if none."""
    for word in text.lower().replace(";", " ").replace("/", " ").split():
        if word in _FORMAT_WORDS:
            return _FORMAT_WORDS[word]
    return text


def _read_jpeg(data: bytes | memoryview) -> ImageHeader | None:
    position, end = 2, len(data)
    while position + 4 <= end and data[position] == 0xFF:
        marker = data[position + 1]
        if marker == 0xFF:  # fill byte
            position += 1
        elif marker in _WITHOUT_LENGTH:
            position += 2
        elif marker in _START_OF_FRAME:
            height = _big_endian(data[position + 5 : position + 7])
            width = _big_endian(data[position + 7 : position + 9])
            whole = position + 9 <= end and width > 0 and height > 0
            return ImageHeader("jpeg", width, height) if whole else None
        else:
            position += 2 + _big_endian(data[position + 2 : position + 4])
    return None


def _big_endian(data: bytes | memoryview) -> int:
    return int.from_bytes(data, "big")


def _sized(
    encoding: str,
    data: bytes | memoryview,
    width: tuple[int, int],
    height: tuple[int, int],
    order: Literal["little", "big"],
) -> ImageHeader | None:
    """Header with width and height at given offsets, of given lengths in bytes; a negative height is upside down."""
    if len(data) < sum(height):
        return None
    w = int.from_bytes(data[width[0] : sum(width)], order)
    h = abs(int.from_bytes(data[height[0] : sum(height)], order, signed=encoding == "bmp"))
    return ImageHeader(encoding, w, h) if w and h else None


def _read_webp(data: bytes | memoryview, kind: bytes) -> ImageHeader | None:
    if len(data) < 30:
        return None
    if kind == b"VP8 ":
        found = _sized("webp", data, (26, 2), (28, 2), "little")
        return found and ImageHeader("webp", found.width & 0x3FFF, found.height & 0x3FFF)
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return ImageHeader("webp", (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[i : i + 3], "little") + 1 for i in (24, 27))
        return ImageHeader("webp", width, height)
    return None


def _read_tiff(data: bytes | memoryview, order: Literal["little", "big"]) -> ImageHeader | None:
    directory = int.from_bytes(data[4:8], order)
    sizes: dict[int, int] = {}
    for k in range(int.from_bytes(data[directory : directory + 2], order)):
        entry = bytes(data[directory + 2 + 12 * k : directory + 14 + 12 * k])
        if len(entry) < 12:
            return None
        tag, kind = int.from_bytes(entry[:2], order), int.from_bytes(entry[2:4], order)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            value = int.from_bytes(entry[8:10] if kind == 3 else entry[8:12], order)
            sizes[tag] = max(value, sizes.get(tag, 0))
    width, height = sizes.get(_TIFF_WIDTH, 0), sizes.get(_TIFF_HEIGHT, 0)
    return ImageHeader("tiff", width, height) if width and height else None


def _read_h264(data: bytes | memoryview) -> ImageHeader | None:
    try:
        found, _ = read_stream(data, None)
    except ValueError:
        return None
    return found and ImageHeader(H264, found.width, found.height)


def _read_avif(start: bytes) -> ImageHeader | None:
    sizes = [
        (_big_endian(start[at + 8 : at + 12]), _big_endian(start[at + 12 : at + 16]))
        for at in (found.start() for found in re.finditer(b"ispe", start))
    ]
    width, height = max(sizes, key=lambda s: s[0] * s[1], default=(0, 0))
    return ImageHeader("avif", width, height) if width and height else None
