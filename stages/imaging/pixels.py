"""Sizes and colours of an image: half size, the space in which colours are compared, white balance by the road."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera
from wayside.stages.kernels import Bytes


def halved(rgb: Bytes) -> Bytes:
    """The image at half size, each pixel the mean of four (an odd last row or column is left out)."""
    height, width = rgb.shape[0] // 2, rgb.shape[1] // 2
    if height == 0 or width == 0:
        return np.zeros((0, 0, 3), np.uint8)
    even = rgb[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def enlarged(rgb: Bytes, times: int) -> Bytes:
    """The image enlarged by a factor, cubic between its pixels; itself for 1."""
    if times == 1:
        return rgb
    large = cv2.resize(rgb, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
    return np.asarray(large, np.uint8)


DARK_LEVEL = 4.0
"""Added to every channel before a logarithm, about the noise of a dark pixel: keeps ratios of near-black colours small.
The models were learned with it."""


def log_chromaticity(rgb: NDArray[Any]) -> NDArray[np.float64]:
    """Natural logarithms of brightness (R+G+B)/3, of R/G and of B/G, (n, 3), finite for every input.

    `rgb`: colours (n, 3), R, G, B from 0 to 255. Each channel is raised by `DARK_LEVEL`; a change of exposure moves a
    colour along the first axis only. Raises ValueError if the colours are not (n, 3).
    """
    if rgb.ndim != 2 or rgb.shape[1] != 3:
        raise ValueError(f"colours: shape {rgb.shape} instead of (n, 3). Pass one colour a row.")
    colors = np.asarray(rgb, np.float64)
    raised = np.log(colors + DARK_LEVEL)
    brightness = np.log(colors.mean(axis=1) + DARK_LEVEL)
    return np.column_stack([brightness, raised[:, 0] - raised[:, 1], raised[:, 2] - raised[:, 1]])


def colorfulness(rgb: Bytes) -> float:
    """How far the colour of an image (h, w, 3) varies, as a fraction of how far its brightness does; 0 of an even one.

    Larger of the deviations of log R/G and log B/G, over the deviation of the log brightness, between the means of 64 x
    32 parts of the image. A cast is the same everywhere, noise averages out, and fog takes as much of colour as of
    contrast.
    """
    parts = cv2.resize(rgb, (64, 32), interpolation=cv2.INTER_AREA)
    bright, red, blue = log_chromaticity(parts.reshape(-1, 3)).std(axis=0).tolist()
    return max(red, blue) / bright if bright > 0 else 0.0


ROAD_FROM = 0.1
"""The road is searched from this tangent below the optical axis on."""
ROAD_UNTIL = 0.95
"""Down to this fraction of the height of the image: bonnets and what recorders write lie below."""
TOLERANCE = 0.18
"""Colour of a road, log ratio against green, without a cast: 9 of 10 images of six real drives show 0.16 at most."""
LARGEST_CAST = 0.3
"""Largest correction, log ratio: a road of earth or brick has a colour of its own."""
_STEP = 8
"""Pixels between the sampled ones, each way."""

_LOGARITHM = np.log(np.arange(256) + DARK_LEVEL)
"""Of each level, as in `log_chromaticity`."""


def road_chromaticity(rgb: Bytes, camera: Camera) -> NDArray[np.float64]:
    """Logarithms of R/G and B/G of the road (2,): medians over the rows where it lies; 0 where the image has none."""
    top = max(0, round(camera.cy + ROAD_FROM * camera.fy))
    road = rgb[top : round(ROAD_UNTIL * len(rgb)) : _STEP, ::_STEP].reshape(-1, 3)
    if not len(road):
        return np.zeros(2)
    red, green, blue = _LOGARITHM[road.T]
    return np.array([np.median(red - green), np.median(blue - green)])


def balanced(rgb: Bytes, camera: Camera, out: Bytes | None = None) -> Bytes:
    """The image (height, width, 3) without the cast of its road, in `out`; itself where that is small."""
    colour = road_chromaticity(rgb, camera)
    magnitude = float(np.linalg.norm(colour))
    if magnitude <= TOLERANCE:
        return rgb
    red, blue = np.exp(-colour * min(1.0, LARGEST_CAST / magnitude))
    levels = np.arange(256)[:, None] * np.array([red, 1.0, blue])
    table = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(rgb, table[:, None], out), np.uint8)
