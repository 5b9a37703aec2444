"""Format and size of a compressed image from its first bytes, without decoding it."""

from __future__ import annotations

from typing import NamedTuple

_PNG = b"\x89PNG\r\n\x1a\n"
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD9)})
_FORMAT_WORDS = {"jpg": "jpeg", "jpeg": "jpeg", "png": "png", "webp": "webp"}


class ImageHeader(NamedTuple):
    """Format ("jpeg", "png") and size in pixels of a compressed image."""

    encoding: str
    width: int
    height: int


def read_image_header(data: bytes | memoryview) -> ImageHeader | None:
    """Header of a JPEG (ITU-T T.81, annex B) or PNG image; None where it is neither or is cut before its size."""
    if data[:2] == b"\xff\xd8":
        return _read_jpeg(data)
    if data[:8] == _PNG and data[12:16] == b"IHDR" and len(data) >= 24:
        width, height = _big_endian(data[16:20]), _big_endian(data[20:24])
        return ImageHeader("png", width, height) if width and height else None
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
