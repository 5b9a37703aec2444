"""What cameras write into images besides the pixels (Exif): which way up they are, and when they were taken."""

from __future__ import annotations

import re
import warnings
from datetime import datetime
from io import BytesIO
from typing import Any, NamedTuple

from PIL import Image

from wayside.schemas.errors import InputError

_DIRECTORY, _ORIENTATION = 0x8769, 0x0112
_TAKEN, _CHANGED, _FRACTION, _OFFSET = 0x9003, 0x0132, 0x9291, 0x9011
"""Tags of the Exif standard: DateTimeOriginal, DateTime, SubSecTimeOriginal, OffsetTimeOriginal."""
_TURNED = dict.fromkeys((2, 4, 5, 7), "mirrored") | {
    3: "turned by 180 degrees",
    6: "turned by 90 degrees clockwise",
    8: "turned by 90 degrees counterclockwise",
}


class Exif(NamedTuple):
    """Exif data of an image; empty or None where it does not say.

    turned: how the stored pixels are to be turned to be shown, in words; date: of capture, else of change,
    `2009-05-14 10:31:07`; taken: date of capture, local, or with its offset.
    """

    turned: str = ""
    date: str = ""
    taken: datetime | None = None


def read_exif(data: bytes | memoryview) -> Exif:
    """Exif data of a compressed image; what is damaged of it is not there."""
    tags: dict[int, Any] = {}
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(BytesIO(data)) as image:
            # Pillow decodes all of a PNG to look for Exif data behind the pixels.
            at_once = image.format == "PNG" and b"eXIf" not in bytes(data)
            exif = Image.Image.getexif(image) if at_once else image.getexif()
            tags = dict(exif)
            tags = dict(exif.get_ifd(_DIRECTORY)) | tags
    except Exception:  # the library has errors of its own for each damage, none is a reason to stop
        pass
    taken = _iso_date(tags.get(_TAKEN))
    date = taken or _iso_date(tags.get(_CHANGED))
    more = f".{_text(tags.get(_FRACTION))}", _text(tags.get(_OFFSET))
    return Exif(_TURNED.get(tags.get(_ORIENTATION, 1), ""), date, _time_of(taken, *more))


def refuse_turned(what: str, exif: Exif) -> None:
    """Refuse an image that is to be shown otherwise than it is stored; raises InputError that begins with `what`."""
    if exif.turned:
        raise InputError(
            f"{what}: its Exif orientation says that it is to be shown {exif.turned}, and whether the calibration is "
            "of the image as stored or as shown is not known; if as shown, turn the pixels of all images "
            "(`exiftran -ai *.jpg`); if as stored, remove the tag of all (`exiftool -Orientation= *.jpg`)"
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
