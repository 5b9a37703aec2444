"""Bytes of an image message to pixels, decoded once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO

import cv2
import numpy as np
import PIL.Image
import simplejpeg
from numpy.typing import NDArray

from wayside.schemas.frame import DAMAGED, UNDECODABLE, USED, WRONG_SIZE, Frame, Image
from wayside.schemas.settings import BalanceSettings
from wayside.stages.imaging.white_balance import balanced

_AS_STORED = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
"""The calibration belongs to the pixels as the sensor gave them, so a rotation noted in EXIF is not applied."""

_RAW_CHANNELS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8UC4": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
}
"""Raw encodings: bytes a pixel and the conversion to RGB (None: already)."""

_JPEG, _END_OF_JPEG, _START_OF_SCAN = b"\xff\xd8", b"\xff\xd9", b"\xff\xda"
_MOST_SCANS = 100
"""Scans of a progressive JPEG, each of which passes over all pixels: encoders write about ten."""
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_FILLING = re.compile(r"\b[1-8] extraneous bytes before marker 0xd9")
"""What a decoder says of the bytes that some cameras put between image and end: no pixel is missing."""


def decode(frames: Iterator[Frame], balance: BalanceSettings | None = None) -> Iterator[Image]:
    """Decode the pixels of every used frame; pass the others on without.

    An image that cannot be decoded comes out with status `undecodable`, one that decodes in part only with `damaged`,
    one whose size is not the camera's with `wrong_size`, since no point of it could be placed. Size and scans are
    looked at before anything is decoded; a compressed image whose header does not tell its size is not. Orientation
    tags are ignored. OpenCV's own threads are left as the process has set them.

    Parameters
    ----------
    frames
        Frames in any state; used ones hold a compressed image, its size in `width` and `height`, or raw rows.
    balance
        Of the white balance of `rgb` by the road, where there is a calibration; None: as recorded. `grey` stays as
        recorded.

    Yields
    ------
    One image a frame, in order: `rgb` (height, width, 3) uint8, C-contiguous, and `grey` (height, width) uint8;
    both None where the frame is not used, and then its recorded bytes are gone, too.
    """
    for frame in frames:
        if not frame.used:
            yield Image(frame, None, None)
            continue
        status, rgb = USED if _fits(frame) else WRONG_SIZE, None
        if status == USED:
            status, rgb = decode_pixels(frame)
        if rgb is not None and rgb.shape[:2] != (frame.height, frame.width):
            status, rgb = WRONG_SIZE, None
        if rgb is None:
            yield Image(replace(frame, status=status, data=b""), None, None)
        else:
            grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
            if balance is not None and balance.on and frame.camera is not None:
                rgb = balanced(rgb, frame.camera, balance)
            yield Image(frame, rgb, grey)


def _fits(frame: Frame) -> bool:
    """Whether an image has the size of its camera, by its header; where this is not known, decoding refuses it."""
    camera, size = frame.camera, (frame.width, frame.height)
    return camera is None or 0 in size or size == (camera.width, camera.height)


def decode_pixels(frame: Frame) -> tuple[str, NDArray[np.uint8] | None]:
    """Status and pixels of one frame, (height, width, 3) uint8 RGB, C-contiguous; None where they cannot all be had."""
    data = np.frombuffer(frame.data, np.uint8)
    rgb = None
    try:
        if frame.encoding in _RAW_CHANNELS:
            rgb = _raw_pixels(frame, data)
        elif data.size and frame.width > 0 and frame.height > 0:
            if data[:2].tobytes() == _JPEG:
                return _jpeg_pixels(data)
            decoded = cv2.imdecode(data, _AS_STORED)
            if decoded is not None and data[:4].tobytes() in _TIFF and not _is_whole_tiff(data):
                return DAMAGED, None
            rgb = None if decoded is None else np.ascontiguousarray(decoded, np.uint8)
    except cv2.error:
        rgb = None
    return (UNDECODABLE, None) if rgb is None else (USED, rgb)


def _jpeg_pixels(data: NDArray[np.uint8]) -> tuple[str, NDArray[np.uint8] | None]:
    """Status and pixels of a JPEG.

    libjpeg fills what is missing or cannot be read with grey and warns; simplejpeg, the same decoder with the same
    pixels as OpenCV's, hands the warnings on. What no decoder notices is a damaged coefficient whose code is valid.
    """
    if data.tobytes().count(_START_OF_SCAN) > _MOST_SCANS:
        return UNDECODABLE, None
    try:
        _, _, colors, _ = simplejpeg.decode_jpeg_header(data)
    except ValueError:
        return UNDECODABLE, None
    if str(colors).upper() in ("CMYK", "YCCK"):
        decoded = None if _is_cut_short(data) else cv2.imdecode(data, _AS_STORED)
        return (DAMAGED, None) if decoded is None else (USED, np.ascontiguousarray(decoded))
    try:
        return USED, simplejpeg.decode_jpeg(data, "RGB")
    except ValueError as error:
        if _FILLING.search(str(error)) is None:
            return DAMAGED, None
        return USED, simplejpeg.decode_jpeg(data, "RGB", strict=False)


def _is_whole_tiff(data: NDArray[np.uint8]) -> bool:
    """Whether every strip and tile decodes: OpenCV prints the errors of libtiff and goes on, Pillow raises them.

    True for the kinds of TIFF that Pillow does not know.
    """
    try:
        image = PIL.Image.open(BytesIO(data.tobytes()), formats=("TIFF",))
    except (PIL.UnidentifiedImageError, PIL.Image.DecompressionBombError):
        return True
    try:
        with image:
            image.load()
    except (OSError, ValueError, SyntaxError, TypeError, KeyError, EOFError):
        return False
    return True


def _raw_pixels(frame: Frame, data: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    channels, conversion = _RAW_CHANNELS[frame.encoding]
    used = frame.width * channels
    step = frame.step or used
    if frame.width <= 0 or frame.height <= 0 or step < used:
        return None
    if data.size < step * (frame.height - 1) + used:  # the last row may come without its padding
        return None
    rows = np.lib.stride_tricks.as_strided(data, (frame.height, used), (step, 1), writeable=False)
    pixels = rows.reshape(frame.height, frame.width, channels)
    if conversion is None:
        return pixels.copy()
    return np.ascontiguousarray(cv2.cvtColor(pixels, conversion), np.uint8)


def _is_cut_short(data: NDArray[np.uint8]) -> bool:
    """Whether a JPEG has no end after its last scan: a decoder fills the rest with grey without an error."""
    content = data.tobytes()  # padding or other bytes may follow the end
    return content.rfind(_END_OF_JPEG) < content.rfind(_START_OF_SCAN)
