"""Bytes of an image message to pixels, decoded once."""

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from io import BytesIO

import cv2
import numpy as np
import PIL.Image
import simplejpeg
from numpy.typing import NDArray

from wayside.schemas.frame import DAMAGED, UNDECODABLE, USED, WRONG_SIZE, Frame, Image
from wayside.schemas.settings import BalanceSettings
from wayside.stages.imaging.pixels import balanced
from wayside.stages.kernels import Bytes

Empty = Callable[[tuple[int, ...]], Bytes] | None
"""Makes an array of a shape, with any content. None: in the heap."""

_AS_STORED = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
"""The calibration belongs to the pixels as the sensor gave them, so a rotation noted in EXIF is not applied."""

_RAW_CHANNELS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8uc3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8uc4": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8uc1": (1, cv2.COLOR_GRAY2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "nv12": (1, cv2.COLOR_YUV2RGB_NV12),
    "nv21": (1, cv2.COLOR_YUV2RGB_NV21),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
}
"""Raw encodings in small letters: bytes a pixel (of NV12 and NV21 of the brightness) and the conversion to RGB (None:
already). Those whose names end in 16 for 8 have samples of two bytes, little-endian."""
_PLANAR = ("nv12", "nv21")
_DEEP = re.compile(r"((?:mono|rgba?|bgra?|bayer_[rgb]{4}))16(?::(\d+))?")
"""A raw encoding of 16 bits; behind a colon, how many of the bits the camera uses."""

_JPEG, _END_OF_JPEG, _START_OF_SCAN, _SCAN = b"\xff\xd8", b"\xff\xd9", b"\xff\xda", 0xDAFF
_MOST_SCANS = 100
"""Scans of a progressive JPEG, each of which passes over all pixels: encoders write about ten."""
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_FILLING = re.compile(r"\b[1-8] extraneous bytes before marker 0xd9")
"""Warnings about the bytes that some cameras put between image and end: no pixel is missing."""


def decode(
    frames: Iterator[Frame], balance: BalanceSettings | None = None, empty: Empty = None
) -> Iterator[Image]:
    """Decode the pixels of every used frame; pass the others on without.

    Status `undecodable`: an image that cannot be decoded. Status `damaged`: one that decodes in part. Status
    `wrong_size`: one whose size differs from the camera's, which leaves its points without a place. Size and scans are
    checked before anything is decoded. A compressed image whose header does not state its size is not decoded.
    Orientation tags are ignored.

    `rgb` (height, width, 3) uint8, C-contiguous, is balanced by the road where there is a calibration and `balance` is
    given. `grey` (height, width) uint8 stays as recorded. Of a camera without colour it is each channel of `rgb`. Both
    are None where the frame is not used, and then its recorded bytes are gone. `empty` makes the arrays of JPEG images.
    """
    for frame in frames:
        if not frame.used:
            yield Image(frame, None, None)
            continue
        # where the header does not state the size, decoding refuses the image
        camera, size = frame.camera, (frame.width, frame.height)
        fits = camera is None or 0 in size or size == (camera.width, camera.height)
        status, rgb = decode_pixels(frame, empty) if fits else (WRONG_SIZE, None)
        if rgb is not None and rgb.shape[:2] != (frame.height, frame.width):
            status, rgb = WRONG_SIZE, None
        if rgb is None:
            yield Image(replace(frame, status=status, data=b""), None, None)
        else:
            grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY, empty and empty(rgb.shape[:2]))
            if frame.grey:  # what its channels differ by is noise, or a cast
                rgb = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.uint8)
            elif balance is not None and balance.on and frame.camera is not None:
                rgb = balanced(rgb, frame.camera, empty and empty(rgb.shape))
            yield Image(frame, rgb, np.asarray(grey, np.uint8))


def decode_pixels(frame: Frame, empty: Empty = None) -> tuple[str, Bytes | None]:
    """Status and pixels of one frame, (height, width, 3) uint8 RGB, C-contiguous; None where they cannot all be had."""
    data = np.frombuffer(frame.data, np.uint8)
    with suppress(cv2.error, ValueError):
        if _DEEP.sub(r"\g<1>8", frame.encoding.lower()) in _RAW_CHANNELS:
            return USED, _raw_pixels(frame)
        if data.size and frame.width > 0 and frame.height > 0:
            if data[:2].tobytes() == _JPEG:
                return _jpeg_pixels(bytes(frame.data), empty)
            decoded = cv2.imdecode(data, _AS_STORED)
            if decoded is not None:
                whole = data[:4].tobytes() not in _TIFF or _is_whole_tiff(data)
                return (USED, np.ascontiguousarray(decoded)) if whole else (DAMAGED, None)
    return UNDECODABLE, None


def _jpeg_pixels(data: bytes, empty: Empty) -> tuple[str, Bytes | None]:
    """Status and pixels of a JPEG; raises ValueError where its header cannot be read.

    libjpeg fills what is missing or cannot be read with grey and warns; simplejpeg, the same decoder with the same
    pixels as OpenCV's, hands the warnings on. What no decoder notices is a damaged coefficient whose code is valid.
    """
    pairs = (np.frombuffer(data, "<u2", (len(data) - k) // 2, k) for k in (0, 1))
    if sum(np.count_nonzero(two == _SCAN) for two in pairs) > _MOST_SCANS:
        return UNDECODABLE, None
    height, width, colors, _ = simplejpeg.decode_jpeg_header(data)
    if str(colors).upper() in ("CMYK", "YCCK"):
        # without an end after its last scan, a decoder fills the rest with grey without an error
        cut_short = data.rfind(_END_OF_JPEG) < data.rfind(_START_OF_SCAN)
        decoded = None if cut_short else cv2.imdecode(np.frombuffer(data, np.uint8), _AS_STORED)
        return (DAMAGED, None) if decoded is None else (USED, np.ascontiguousarray(decoded))
    rgb = empty and empty((height, width, 3))
    try:
        return USED, simplejpeg.decode_jpeg(data, "RGB", buffer=rgb)
    except ValueError as error:
        if _FILLING.search(str(error)) is None:
            return DAMAGED, None
        return USED, simplejpeg.decode_jpeg(data, "RGB", buffer=rgb, strict=False)


def _is_whole_tiff(data: Bytes) -> bool:
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


def raw_samples(frame: Frame) -> NDArray[np.uint8 | np.uint16]:
    """Samples of a raw image, one row of it each (of NV12 and NV21 followed by half as many rows of colours).

    Raises ValueError where the encoding is unknown, or size, step and bytes contradict each other.
    """
    name, width, height = frame.encoding.lower(), frame.width, frame.height
    deep = _DEEP.fullmatch(name)
    if (known := _RAW_CHANNELS.get(f"{deep[1]}8" if deep else name)) is None:
        raise ValueError(
            f"its encoding {frame.encoding!r} is not supported. Known are rgb8, bgr8, rgba8, bgra8, mono8 and "
            "bayer_* (also with 16 bits), uyvy, yuyv, nv12 and nv21"
        )
    data = np.frombuffer(frame.data, np.uint8)
    used = width * known[0] * (2 if deep else 1)
    step, rows = frame.step or used, height * 3 // 2 if name in _PLANAR else height
    if width <= 0 or height <= 0 or (name in _PLANAR and (width % 2 or height % 2)):
        raise ValueError(f"its size of {width} x {height} pixels is not possible in {name}")
    if step < used:
        raise ValueError(f"its step is {step} bytes, a row of {width} pixels in {name} has {used}")
    if data.size not in (step * rows, step * (rows - 1) + used):  # the last may lack its padding
        raise ValueError(f"its {data.size} bytes are not {rows} rows of {step} bytes (its step)")
    strided = np.lib.stride_tricks.as_strided(data, (rows, used), (step, 1), writeable=False)
    return np.ascontiguousarray(strided).view("<u2") if deep else strided


def used_bits(frame: Frame) -> int:
    """Bits that the samples of a raw image of 16 bits use: 8, 10, 12, 14 or 16; 0 for any other image.

    Cameras of 10 or 12 bits store their samples at the low end of two bytes, or shifted to the high end.
    """
    if _DEEP.fullmatch(frame.encoding.lower()) is None:
        return 0
    try:
        return max(8, int(raw_samples(frame).max()).bit_length() + 1 & ~1)
    except ValueError:
        return 0


def _raw_pixels(frame: Frame) -> Bytes:
    """Pixels of a raw image; samples of two bytes keep the upper eight of their used bits."""
    samples, name = raw_samples(frame), frame.encoding.lower()
    if deep := _DEEP.fullmatch(name):
        name = f"{deep[1]}8"
        samples = np.minimum(samples >> (int(deep[2] or 16) - 8), 255)
    conversion = _RAW_CHANNELS[name][1]
    pixels = samples.astype(np.uint8, copy=False).reshape(len(samples), frame.width, -1)
    if conversion is None:
        return pixels.copy()
    return np.ascontiguousarray(cv2.cvtColor(pixels, conversion), np.uint8)
