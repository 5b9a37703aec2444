"""Images as WebP, and as addresses that a page can hold."""

from __future__ import annotations

import base64

import cv2
import numpy as np
from numpy.typing import NDArray

QUALITY = 75
"""Of small images that people look at; above 100 is lossless."""


def encode_webp(rgb: NDArray[np.uint8], quality: int = QUALITY) -> bytes:
    """An image (h, w, 3) as WebP."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".webp", bgr, (cv2.IMWRITE_WEBP_QUALITY, quality))[1].tobytes()


def data_address(webp: bytes) -> str:
    """The content of a WebP file as the address of an image in a page."""
    return f"data:image/webp;base64,{base64.b64encode(webp).decode()}"
