"""Crops as another camera takes them, in the order in which light becomes a file.

Scene, lens, exposure, tone curve, processing, JPEG. Light is linear up to the exposure. White that is too bright for
the sensor runs over thin dark lines next to it, which no blur of a finished image does.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recordings.drives.sensor import line_kernel

DISPLAY_GAMMA = 2.2
"""Values of an image are light to the power of one over this."""

TOO_DARK, TOO_BRIGHT = (0.08, 0.15, 0.5), (0.1, 1.2, 2.4)
"""Fractions of the crops that are exposed far too little and too much; factors on the values, least and most."""

HAZY, HAZIEST = 0.35, 0.3
"""Fraction of the crops with light scattered into the path, and most of it, as a fraction of all light."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise drawn once: smooth (side, side) of deviation 1, and grain (side, side, 3) of deviation 1."""

    smooth: NDArray[np.float32]
    grain: NDArray[np.float32]


def make_noise(rng: np.random.Generator, side: int = 768) -> Noise:
    """Noise of several scales for dirt and shade, and of one for grain."""
    smooth = np.zeros((side, side), np.float32)
    for cells in (6, 24, 96):
        coarse = rng.normal(0, 1, (cells, cells)).astype(np.float32)
        smooth += cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
    grain = rng.normal(0, 1, (side, side, 3)).astype(np.float32)
    grain[::2] = cv2.GaussianBlur(grain, (3, 3), 0.7)[::2] * 1.6
    return Noise(smooth / smooth.std(), grain)


def piece(
    noise: NDArray[np.float32], shape: tuple[int, ...], rng: np.random.Generator
) -> NDArray[np.float32]:
    """A part of a square of noise with the rows and columns of an image, scaled where it is smaller than that."""
    y, x = (int(rng.integers(max(1, len(noise) - side + 1))) for side in shape[:2])
    part = noise[y : y + shape[0], x : x + shape[1]]
    return part if part.shape[:2] == shape[:2] else _floats(cv2.resize(part, shape[1::-1]))


def through_a_camera(
    rgb: NDArray[np.uint8], noise: Noise, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """An image (h, w, 3) as another camera takes it in another light."""
    levels = np.linspace(0, 1, 256, dtype=np.float32) ** np.float32(DISPLAY_GAMMA)
    light = _floats(cv2.LUT(rgb, levels.reshape(256, 1)))
    light = _through_the_lens(_lit(light, noise, rng), rng)
    return _processed(_exposed(light, rng), noise, rng)


def _lit(light: NDArray[np.float32], noise: Noise, rng: np.random.Generator) -> NDArray[np.float32]:
    """The light of the scene with shade on it and haze before it."""
    if rng.random() < 0.08:
        dark = np.clip(
            0.5 + piece(noise.smooth, light.shape, rng) * rng.uniform(0.5, 2), 0, 1
        ) * rng.uniform(0.2, 0.6)
        light = _floats(light * ((1 - dark) ** DISPLAY_GAMMA)[..., None])
    if rng.random() < HAZY:
        haze = rng.uniform(0, HAZIEST)
        veil = (rng.uniform(0.3, 0.9) * np.exp(rng.normal(0, 0.06, 3))) ** DISPLAY_GAMMA
        light = _floats(light * (1 - haze) + veil * haze)
    return light


def _through_the_lens(light: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Larger pixels, blur of the lens or of motion."""
    if rng.random() < 0.15:  # a camera of lower resolution
        size = light.shape[1::-1]
        small = [max(1, round(side * rng.uniform(0.45, 0.9))) for side in size]
        coarse = cv2.resize(light, small, interpolation=cv2.INTER_AREA)
        light = _floats(cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR))
    draw = rng.random()
    if draw < 0.35:
        sigma = float(np.exp(rng.uniform(np.log(0.35), np.log(1.6))))
        light = _floats(cv2.GaussianBlur(light, (0, 0), sigma))
    elif draw < 0.45:
        kernel = line_kernel(rng.uniform(1.5, 4), rng.normal(0, 0.35))
        light = _floats(cv2.filter2D(light, -1, kernel))
    return light


def _exposed(light: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Bytes: exposure, white balance, what the sensor can hold, tone curve."""
    gains = np.exp(rng.normal(0, 0.1, 3) + rng.normal(0, 0.3))
    if rng.random() < 0.25:  # white balance far off: mostly bluish, at times yellowish
        cast = rng.normal(0.25, 0.2)
        gains *= np.exp([-cast, rng.normal(0, 0.06), 0.8 * cast])
    for fraction, least, most in (TOO_DARK, TOO_BRIGHT):
        if rng.random() < fraction:
            gains *= rng.uniform(least, most)
    contrast = np.exp(rng.normal(0, 0.22))
    held = np.minimum(light * (gains**DISPLAY_GAMMA).astype(np.float32), 1)
    return _bytes(255 * _floats(cv2.pow(held, contrast / DISPLAY_GAMMA)))


def _processed(rgb: NDArray[np.uint8], noise: Noise, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Grain of the sensor, saturation, sharpening, JPEG."""
    if rng.random() < 0.4:
        noisy = rgb + piece(noise.grain, rgb.shape, rng) * np.float32(
            np.exp(rng.uniform(np.log(1.5), np.log(12)))
        )
        rgb = _bytes(np.clip(noisy, 0, 255))
    saturation = float(np.clip(np.exp(rng.normal(-0.08, 0.35)), 0.15, 2))
    if abs(saturation - 1) > 0.08:
        mix = saturation * np.eye(3) + (1 - saturation) * np.array([0.3, 0.59, 0.11])
        rgb = _bytes(cv2.transform(rgb, mix))
    if rng.random() < 0.15:
        soft = cv2.GaussianBlur(rgb, (0, 0), 1.0)
        amount = rng.uniform(0.3, 1.5)
        rgb = _bytes(cv2.addWeighted(rgb, 1 + amount, soft, -amount, 0))
    if rng.random() < 0.6:
        quality = int(rng.integers(22, 96))
        done, data = cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if done:
            rgb = _bytes(cv2.imdecode(data, cv2.IMREAD_COLOR))
    return rgb


def _floats(values: Any) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def _bytes(values: Any) -> NDArray[np.uint8]:
    return np.asarray(values, np.uint8)
