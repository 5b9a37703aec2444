"""What is known of an image before it is decoded: format, size, Exif data, and whether it can be decoded."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from io import BytesIO
from typing import Any, NamedTuple

import simplejpeg
from PIL import Image
from PIL.ExifTags import IFD, Base

from wayside.pipeline.reading.contents import ImageContent
from wayside.pipeline.reading.h264 import H264, read_stream
from wayside.schemas.errors import InputError
from wayside.schemas.frame import FRAME_STATUS_WORDS, USED, Frame
from wayside.stages.imaging import decode_pixels, raw_samples

_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "BMP", "AVIF")
_START_CODES = (b"\0\0\0\1", b"\0\0\1")
_FORMAT_WORDS = {word: word for word in (*map(str.lower, _FORMATS), H264)}
_FORMAT_WORDS |= {"jpg": "jpeg", "mpo": "jpeg", "tif": "tiff"}
_LARGEST_TRIED_PX = 50_000_000
"""Nothing larger is decoded only to see whether it can be; each pixel takes some bytes."""
_TURNED = dict.fromkeys((2, 4, 5, 7), "mirrored") | {
    3: "turned by 180 degrees",
    6: "turned by 90 degrees clockwise",
    8: "turned by 90 degrees counterclockwise",
}


class ImageHeader(NamedTuple):
    """Format ("jpeg", "png", "webp", "tiff", "bmp", "avif", "h264") and size in pixels of a compressed image."""

    encoding: str
    width: int
    height: int


class Place(NamedTuple):
    """A place on WGS 84: degrees, and metres above mean sea level or the ellipsoid, nan where unknown."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class Exif(NamedTuple):
    """Exif data of an image; empty or None where it does not say.

    `turned`: how the stored pixels are to be turned to be shown, in words. `date`: of capture, else of change,
    `2009-05-14 10:31:07`. `taken`: date of capture, local, or with its offset. `place`: by satellites.
    """

    turned: str = ""
    date: str = ""
    taken: datetime | None = None
    place: Place | None = None


def read_image_header(data: bytes | memoryview) -> ImageHeader | None:
    """Header of an image; None where it is of none of these formats, or cut before its size.

    Of TIFF the first image, of H.264 a piece that begins with its sequence set.
    """
    try:
        if bytes(data[:4]).startswith(_START_CODES):
            found, _ = read_stream(data, None)
            return found and ImageHeader(H264, found.width, found.height)
        if bytes(data[:2]) == b"\xff\xd8":
            height, width, *_ = simplejpeg.decode_jpeg_header(data)
            if height * width <= _LARGEST_TRIED_PX:  # Pillow refuses what would fill the memory
                return ImageHeader("jpeg", width, height)
        with _opened(data) as image:
            (width, height), name = image.size, format_word(image.format or "")
    except Exception:  # each reader has errors of its own for damaged bytes
        return None
    return ImageHeader(name, width, height) if width > 0 and height > 0 else None


@contextmanager
def _opened(data: bytes | memoryview) -> Iterator[Image.Image]:
    """An image whose header is read and whose pixels are not."""
    with (
        warnings.catch_warnings(action="ignore"),
        Image.open(BytesIO(data), formats=_FORMATS) as image,
    ):
        yield image


def read_exif(data: bytes | memoryview) -> Exif:
    """Exif data of a compressed image, without damaged parts."""
    tags, satellites = dict[int, Any](), dict[int, Any]()
    try:
        with _opened(data) as image:
            # Pillow decodes all of a PNG to look for Exif data after the pixels.
            at_once = image.format == "PNG" and b"eXIf" not in bytes(data)
            exif = Image.Image.getexif(image) if at_once else image.getexif()
            tags = dict(exif)
            tags = dict(exif.get_ifd(IFD.Exif)) | tags
            satellites = dict(exif.get_ifd(IFD.GPSInfo))
    except Exception:  # the library has errors of its own for each damage, none is a reason to stop
        pass
    taken = _iso_date(tags.get(Base.DateTimeOriginal))
    date = taken or _iso_date(tags.get(Base.DateTime))
    fraction = f".{_text(tags.get(Base.SubsecTimeOriginal))}"
    time = _time_of(taken, fraction, _text(tags.get(Base.OffsetTimeOriginal)))
    return Exif(_TURNED.get(tags.get(Base.Orientation, 1), ""), date, time, _place_of(satellites))


def refuse_turned(what: str, exif: Exif) -> None:
    """Refuse an image that must be turned to be shown; raises InputError that begins with `what`."""
    if exif.turned:
        raise InputError(
            f"{what}: its Exif orientation shows it {exif.turned}, and the calibration may be of the image as shown "
            "or as stored. If as shown, turn the pixels of all images (`exiftran -ai *.jpg`). If as stored, remove the "
            "tag of all (`exiftool -Orientation= *.jpg`)."
        )


def _text(value: object) -> str:
    return str(value or "").strip(" \0")


def _iso_date(value: object) -> str:
    found = re.match(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)", _text(value))
    return "" if found is None else "{}-{}-{} {}".format(*found.groups())


def _time_of(date: str, fraction: str, offset: str) -> datetime | None:
    for text in (date + fraction + offset, date + offset, date):
        try:
            return datetime.fromisoformat(text)
        except ValueError:
            pass  # no fraction, no offset, or no date at all: 0000-00-00
    return None


def _place_of(tags: dict[int, Any]) -> Place | None:
    """GPSLatitude, GPSLongitude (degrees, minutes, seconds), GPSAltitude and their references; None where damaged."""
    try:
        lat, lon = (
            sum(float(part) / 60**k for k, part in enumerate(tags[tag]))
            * (1 - 2 * (_text(tags[tag - 1]) == minus))
            for tag, minus in ((2, "S"), (4, "W"))
        )
        below = tags.get(5, b"\0") in (1, b"\1")
        place = Place(lat, lon, float(tags.get(6, "nan")) * (-1 if below else 1))
    except (ArithmeticError, LookupError, TypeError, ValueError):
        return None
    return place if abs(lat) <= 90 and abs(lon) <= 180 and (lat or lon) else None


def format_word(text: str) -> str:
    """The image format that the text of a message names (`bgr8; jpeg compressed bgr8`), or else that text."""
    for word in text.lower().replace(";", " ").replace("/", " ").split():
        if word in _FORMAT_WORDS:
            return _FORMAT_WORDS[word]
    return text


def format_and_size(image: ImageContent) -> tuple[str, int, int]:
    """Encoding in a word, width and height; 0 where only decoding shows it."""
    if image.width:
        return image.encoding, image.width, image.height
    return read_image_header(image.data) or (format_word(image.encoding), 0, 0)


def image_fault(image: ImageContent) -> str:
    """Why an image cannot be decoded, in words; empty where it can, or is a picture of a video, which needs others."""
    one = frame_of(image)
    if image.encoding == H264 or one.width * one.height > _LARGEST_TRIED_PX:
        return ""
    if not one.width:
        return f"its format {one.encoding!r} is not supported, or its header is damaged"
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
