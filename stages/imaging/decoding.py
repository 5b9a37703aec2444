"""Bytes of an image message to pixels, decoded once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import UNDECODABLE, WRONG_SIZE, Frame, Image

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

_END_OF_JPEG, _START_OF_SCAN = b"\xff\xd9", b"\xff\xda"


def decode(frames: Iterator[Frame]) -> Iterator[Image]:
    """Decode the pixels of every used frame; pass the others on without.

    An image that cannot be decoded, or only in part, comes out with status `undecodable`; one whose size is not the
    camera's with `wrong_size`, since no point of it could be placed. Orientation tags are ignored. OpenCV's own threads
    are left as the process has set them.

    Parameters
    ----------
    frames
        Frames in any state; used ones hold a compressed image or raw rows.

    Yields
    ------
    One image a frame, in order: `rgb` (height, width, 3) uint8, C-contiguous, and `grey` (height, width) uint8;
    both None where the frame is not used.
    """
    for frame in frames:
        if not frame.used:
            yield Image(frame, None, None)
            continue
        rgb = decode_pixels(frame)
        if rgb is None:
            yield Image(replace(frame, status=UNDECODABLE), None, None)
        elif frame.camera is not None and rgb.shape[:2] != (
            frame.camera.height,
            frame.camera.width,
        ):
            yield Image(replace(frame, status=WRONG_SIZE), None, None)
        else:
            yield Image(frame, rgb, np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8))


def decode_pixels(frame: Frame) -> NDArray[np.uint8] | None:
    """Pixels of one frame, (height, width, 3) uint8 RGB, C-contiguous; None where they cannot all be had."""
    data = np.frombuffer(frame.data, np.uint8)
    try:
        if frame.encoding in _RAW_CHANNELS:
            return _raw_pixels(frame, data)
        if data.size == 0 or _is_cut_short(data):
            return None
        decoded = cv2.imdecode(data, _AS_STORED)
    except cv2.error:
        return None
    return None if decoded is None else np.ascontiguousarray(decoded, np.uint8)


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
    if data[:2].tobytes() != b"\xff\xd8" or data[-2:].tobytes() == _END_OF_JPEG:
        return False
    content = data.tobytes()  # padding or other bytes may follow the end
    return content.rfind(_END_OF_JPEG) < content.rfind(_START_OF_SCAN)
