"""Augmentation: training images altered as if another camera had taken them.

Rendered images all come from one camera model in good light. Recorded ones are burnt out, crushed, over-sharpened,
soft, tinted, noisy and compressed; a classifier learned without that misses clear signs in hard light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Image

ALTERED_FRACTION = 0.5
"""Fraction of the images that are altered; the others stay as they are."""
STOPS, CONTRAST, SATURATION, TINT = (-0.8, 0.8), (0.75, 1.9), (0.6, 1.5), 0.05
"""Ranges of exposure (powers of two), contrast about a middle grey, saturation; sigma of the log of channel gains."""
SOFT_PX, SHARP, NOISE, QUALITY = 1.0, 1.2, 4.0, (45, 95)
"""Largest blur (sigma, pixels), sharpening (fraction), noise (grey values, sigma); JPEG quality from and to."""


def through_other_cameras(
    images: Iterator[Image], seed: int, fraction: float = ALTERED_FRACTION
) -> Iterator[Image]:
    """The images, a fraction of them altered; which ones and how depends on seed and frame number alone."""
    for image in images:
        random = np.random.default_rng((seed, image.frame.index))
        if image.rgb is None or random.random() >= fraction:
            yield image
            continue
        rgb = altered(image.rgb, random)
        grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
        yield replace(image, rgb=rgb, grey=grey)


def altered(rgb: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
    """An image (rows, columns, 3) as another camera might have taken it: tones, then optics, noise and JPEG.

    Each step is left out now and then, so that one alone is seen, too.
    """
    shown = retoned(rgb, random)
    if random.random() < 0.5:
        sigma = float(random.uniform(0.4, SOFT_PX))
        shown = np.asarray(cv2.GaussianBlur(shown, (0, 0), sigma), np.uint8)
    if random.random() < 0.5:
        amount = float(random.uniform(0.0, SHARP))
        soft = cv2.GaussianBlur(shown, (0, 0), 1.0)
        shown = np.asarray(cv2.addWeighted(shown, 1 + amount, soft, -amount, 0), np.uint8)
    if random.random() < 0.5:
        # one tile of noise, repeated: its grain matters, not that it is new everywhere
        tile = random.normal(0.0, random.uniform(0.5, NOISE), (128, 128, 3)).astype(np.float32)
        rows, columns = shown.shape[:2]
        grain = np.tile(tile, (-(-rows // 128), -(-columns // 128), 1))[:rows, :columns]
        shown = np.clip(np.rint(shown + grain), 0, 255).astype(np.uint8)
    quality = int(random.integers(*QUALITY, endpoint=True))
    _, data = cv2.imencode(
        ".jpg", cv2.cvtColor(shown, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), np.uint8)


def retoned(rgb: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
    """An image (rows, columns, 3) with another exposure, tint, contrast and saturation."""
    exposure = 2.0 ** random.uniform(*STOPS) if random.random() < 0.7 else 1.0
    gains = np.exp(random.normal(0.0, TINT, 3)) * exposure
    contrast = random.uniform(*CONTRAST) if random.random() < 0.7 else 1.0
    middle = random.uniform(80.0, 130.0)
    levels = np.arange(256.0)
    curves = np.clip(
        (levels[:, None] * gains - middle * exposure) * contrast + middle * exposure, 0, 255
    )
    table = np.rint(curves).astype(np.uint8)
    shown = np.stack([table[rgb[..., k], k] for k in range(3)], axis=-1)
    if random.random() < 0.6:
        amount = float(random.uniform(*SATURATION))
        grey = cv2.cvtColor(cv2.cvtColor(shown, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        shown = np.asarray(cv2.addWeighted(shown, amount, grey, 1 - amount, 0), np.uint8)
    return np.ascontiguousarray(shown)
