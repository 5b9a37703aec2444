"""Images as WebP and PNG, and as addresses that a page can hold."""

from __future__ import annotations

import base64

import cv2
import numpy as np
from numpy.typing import NDArray

QUALITY = 75
"""Of small images that people look at; above 100 is lossless."""
_FAST = 1


def encode_webp(rgb: NDArray[np.uint8], quality: int = QUALITY) -> bytes:
    """An image (h, w, 3) as WebP."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".webp", bgr, (cv2.IMWRITE_WEBP_QUALITY, quality))[1].tobytes()


def encode_png(rgb: NDArray[np.uint8]) -> bytes:
    """An image (h, w, 3) as PNG, compressed a little."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".png", bgr, (cv2.IMWRITE_PNG_COMPRESSION, _FAST))[1].tobytes()


def data_address(content: bytes) -> str:
    """The content of a WebP or PNG file as the address of an image in a page."""
    kind = "webp" if content.startswith(b"RIFF") else "png"
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
