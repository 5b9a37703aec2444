"""Images as WebP and PNG for pages, and marks by which wayside knows its own images and pages again."""

import base64
import struct
import zlib
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

QUALITY = 75
"""Of small images that people look at; above 100 is lossless."""
BLUR_CELLS = 40
"""Cells that a blurred image is averaged to along its width: a face or number plate across the street is one or two."""
_HEADER_BYTES = 33
"""Signature and image header of a PNG; text may follow."""


def blurred(rgb: NDArray[np.uint8], kept: Iterable[Sequence[float]]) -> NDArray[np.uint8]:
    """An image (h, w, 3) averaged to `BLUR_CELLS`, except inside the `kept` boxes (x0, y0, x1, y1; half open)."""
    height, width = rgb.shape[:2]
    cells = min(BLUR_CELLS, width), max(1, round(height * BLUR_CELLS / width))
    coarse = cv2.resize(rgb, cells, interpolation=cv2.INTER_AREA)
    hidden = np.asarray(cv2.resize(coarse, (width, height)), np.uint8)
    for box in kept:
        x0, y0, x1, y1 = (max(round(float(edge)), 0) for edge in box)
        hidden[y0:y1, x0:x1] = rgb[y0:y1, x0:x1]
    return hidden


def encoded(rgb: NDArray[np.uint8], kind: str, *flags: int) -> bytes:
    """An image (h, w, 3) as a file of a kind such as `.jpg`; `flags`: those of `cv2.imwrite`."""
    return cv2.imencode(kind, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), flags)[1].tobytes()


def webp_address(rgb: NDArray[np.uint8], quality: int = QUALITY) -> str:
    """An image (h, w, 3) as WebP in the address of an image in a page."""
    content = encoded(rgb, ".webp", cv2.IMWRITE_WEBP_QUALITY, quality)
    return f"data:image/webp;base64,{base64.b64encode(content).decode()}"


def marked_png(png: bytes, mark: str) -> bytes:
    """The same image with a text of the keyword `Source`; PNG specification, section 11.3.3.2 (tEXt)."""
    return png[:_HEADER_BYTES] + _text_chunk(mark) + png[_HEADER_BYTES:]


def marked_head(mark: str) -> str:
    """The same mark for the head of a page."""
    return f'<meta name="generator" content="{escape(mark)}">'


def is_marked(path: Path, mark: str) -> bool:
    """Whether a PNG file or a page bears a mark; raises OSError where it cannot be read."""
    with path.open("rb") as stream:
        start = stream.read(2048)
    return _text_chunk(mark) in start or marked_head(mark).encode() in start


def _text_chunk(mark: str) -> bytes:
    body = b"tEXt" + b"Source\0" + mark.encode("ascii", "backslashreplace")
    return struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
