"""Lens and sensor: from light on the canvas to an 8-bit image."""

from dataclasses import dataclass

import cv2
import numpy as np

from recordings.drives.arrays import Bytes, Singles
from recordings.drives.camera import CameraModel
from recordings.drives.spec import DriveSpec

_STEPS_PER_LIGHT = 2048
_STEPS = 8192
_MIDDLE_GREY = 0.25  # fraction of full light that contrast leaves
_MOSAIC_STEPS = 128  # steps a grey level
_MEMORY = 0.93  # fraction of exposure and white balance that stays from image to image


@dataclass(frozen=True, slots=True)
class Exposure:
    """Response of one image: gain and per-channel white balance (RGB)."""

    gain: float
    white_balance: tuple[float, float, float]


def exposures(spec: DriveSpec, count: int) -> list[Exposure]:
    """Slow drift of gain and white balance over a drive."""
    rng = np.random.default_rng([spec.seed, 4])
    light, tint = spec.light, spec.light.white_balance_drift
    result = []
    state = rng.normal(0, 1, 3)
    for _ in range(count):
        state = _MEMORY * state + np.sqrt(1 - _MEMORY**2) * rng.normal(0, 1, 3)
        gain = light.exposure * float(np.exp(light.exposure_drift * state[0]))
        balance = (float(1 + tint * state[1]), 1.0, float(1 + tint * state[2]))
        result.append(Exposure(gain, balance))
    return result


class Sensor:
    """Develops the images of one drive."""

    def __init__(self, spec: DriveSpec, camera: CameraModel) -> None:
        self.spec, self.camera = spec, camera
        width, height = spec.camera.width, spec.camera.height
        columns = np.linspace(-1, 1, width, dtype=np.float32)[None, :]
        rows = np.linspace(-1, 1, height, dtype=np.float32)[:, None] * (height / width)
        reach = 1 + (height / width) ** 2
        self.vignette = 1 - spec.sensor.vignette * (columns**2 + rows**2) / reach
        self.curve = _response(spec.sensor.contrast)

    def develop(self, canvas: Singles, index: int, exposure: Exposure) -> Bytes:
        """Lens distortion, blur, response curve, noise and sharpening of image number `index`; BGR."""
        sensor = self.spec.sensor
        rng = np.random.default_rng([self.spec.seed, 5, index])
        light = self._through_lens(canvas, rng)
        gains = np.array(exposure.white_balance, np.float32)
        light *= self.vignette[..., None]
        light *= gains * np.float32(exposure.gain * _STEPS_PER_LIGHT)
        np.clip(light, 0, _STEPS - 1, out=light)
        image = self.curve[light.astype(np.uint16)]
        noise = rng.standard_normal(image.shape, np.float32)
        noise *= np.float32(sensor.noise)
        noise += np.float32(0.5) * cv2.GaussianBlur(noise, (0, 0), 1.0)
        image += noise
        if sensor.mosaic:
            image = _through_mosaic(image)
        if sensor.sharpen > 0:
            image += np.float32(sensor.sharpen) * (image - cv2.GaussianBlur(image, (0, 0), 1.0))
        rounded = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(rounded[..., ::-1])

    def _through_lens(self, canvas: Singles, rng: np.random.Generator) -> Singles:
        """Distorted light (height, width, 3) with the blur of motion and lens."""
        sensor, camera = self.spec.sensor, self.camera
        light = cv2.remap(
            canvas, camera.map_x, camera.map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        if sensor.motion_blur_px > 0:
            angle = rng.uniform(0, np.pi)
            kernel = line_kernel(sensor.motion_blur_px * rng.uniform(0.3, 1.0), angle)
            light = cv2.filter2D(light, -1, kernel)
        if sensor.blur_px > 0:
            light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px)
        return np.asarray(light, np.float32)


def _through_mosaic(image: Singles) -> Singles:
    """The image (rows, columns, RGB) of a sensor that sees one colour a pixel, the rest filled in."""
    levels = np.clip(np.rint(image * _MOSAIC_STEPS), 0, np.iinfo(np.uint16).max).astype(np.uint16)
    mosaic = levels[..., 1].copy()
    mosaic[::2, ::2] = levels[::2, ::2, 0]
    mosaic[1::2, 1::2] = levels[1::2, 1::2, 2]
    filled = cv2.cvtColor(mosaic, cv2.COLOR_BayerRGGB2RGB)
    return np.asarray(filled, np.float32) / np.float32(_MOSAIC_STEPS)


def _response(contrast: float) -> Singles:
    """Grey level (0..255) of every step of light: contrast about a middle grey, a soft shoulder, the sRGB curve."""
    level = np.arange(_STEPS, dtype=np.float32) / _STEPS_PER_LIGHT
    if contrast != 1:
        level = _MIDDLE_GREY * (level / _MIDDLE_GREY) ** np.float32(contrast)
    shoulder = np.where(level < 0.7, level, 0.7 + 0.3 * (1 - np.exp(-(level - 0.7) / 0.3)))
    power = 1.055 * np.power(np.maximum(shoulder, 1e-6), 1 / 2.4) - 0.055
    return (255 * np.where(shoulder < 0.0031308, shoulder * 12.92, power)).astype(np.float32)


def line_kernel(length: float, angle: float) -> Singles:
    """Small normalised line kernel, 5 x 5."""
    kernel: Singles = np.zeros((5, 5), np.float32)
    for w in np.linspace(-0.5, 0.5, 21):
        x, y = 2 + w * length * np.cos(angle), 2 + w * length * np.sin(angle)
        i, j = int(np.floor(x)), int(np.floor(y))
        for di in (0, 1):
            for dj in (0, 1):
                weight = (1 - abs(x - i - di)) * (1 - abs(y - j - dj))
                kernel[min(j + dj, 4), min(i + di, 4)] += weight
    kernel /= kernel.sum()
    return kernel
