"""Format and size of an image before it is decoded, and whether it can be."""

from __future__ import annotations

import warnings
from io import BytesIO
from typing import NamedTuple

from PIL.AvifImagePlugin import AvifImageFile
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import TiffImageFile
from PIL.WebPImagePlugin import WebPImageFile

from wayside.pipeline.reading.contents import ImageContent
from wayside.pipeline.reading.h264 import H264, read_stream
from wayside.schemas.frame import FRAME_STATUS_WORDS, USED, Frame
from wayside.stages.imaging import decode_pixels, raw_samples

_FORMATS: dict[str, tuple[int, tuple[bytes, ...], type[ImageFile]]] = {
    "jpeg": (0, (b"\xff\xd8",), JpegImageFile),
    "png": (0, (b"\x89PNG\r\n\x1a\n",), PngImageFile),
    "webp": (8, (b"WEBP",), WebPImageFile),
    "tiff": (0, (b"II*\0", b"MM\0*"), TiffImageFile),
    "bmp": (0, (b"BM",), BmpImageFile),
    "avif": (4, (b"ftypavif", b"ftypavis"), AvifImageFile),
}
"""Compressed images: what they begin with, and where; and what reads their size."""
_START_CODES = (b"\0\0\0\1", b"\0\0\1")
_FORMAT_WORDS = {word: word for word in (*_FORMATS, H264)} | {"jpg": "jpeg", "tif": "tiff"}
_LARGEST_TRIED_PX = 50_000_000
"""Nothing larger is decoded only to see whether it can be; each pixel takes some bytes."""


class ImageHeader(NamedTuple):
    """Format ("jpeg", "png", "webp", "tiff", "bmp", "avif", "h264") and size in pixels of a compressed image."""

    encoding: str
    width: int
    height: int


def read_image_header(data: bytes | memoryview) -> ImageHeader | None:
    """Header of an image; None where it is of none of these formats, or cut before its size.

    Of TIFF the first image, of H.264 a piece that begins with its sequence set.
    """
    start = bytes(data[:16])
    if start.startswith(_START_CODES):
        try:
            found, _ = read_stream(data, None)
        except ValueError:
            return None
        return found and ImageHeader(H264, found.width, found.height)
    for name, (place, begins, reader) in _FORMATS.items():
        if start.startswith(begins, place):
            try:
                with warnings.catch_warnings(action="ignore"), reader(BytesIO(data)) as image:
                    width, height = image.size
            except Exception:  # each reader has errors of its own for damaged bytes
                return None
            return ImageHeader(name, width, height) if width > 0 and height > 0 else None
    return None


def format_word(text: str) -> str:
    """The image format in the free text of a message ("bgr8; jpeg compressed bgr8"); the text itself if none."""
    for word in text.lower().replace(";", " ").replace("/", " ").split():
        if word in _FORMAT_WORDS:
            return _FORMAT_WORDS[word]
    return text


def format_and_size(image: ImageContent) -> tuple[str, int, int]:
    """Encoding in a word, width and height; 0 where only decoding will tell."""
    if image.width:
        return image.encoding, image.width, image.height
    header = read_image_header(image.data)
    return (format_word(image.encoding), 0, 0) if header is None else header


def image_fault(image: ImageContent) -> str:
    """Why an image cannot be decoded, in words; empty where it can, or is a picture of a video, which needs others."""
    encoding, width, height = format_and_size(image)
    if image.encoding == H264 or width * height > _LARGEST_TRIED_PX:
        return ""
    if not width:
        return f"its format {encoding!r} is not understood, or its header is damaged"
    one = frame_of(image)
    status, _ = decode_pixels(one)
    if status != USED and image.width and read_image_header(image.data) is None:
        try:
            raw_samples(one)
        except ValueError as error:
            return str(error)
    return "" if status == USED else f"it {FRAME_STATUS_WORDS[status]}"


def frame_of(image: ImageContent) -> Frame:
    """An image by itself, as it is decoded."""
    encoding, width, height = format_and_size(image)
    return Frame(0, 0, None, USED, encoding, image.data, None, width, height, image.step)
