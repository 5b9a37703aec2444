"""Periodic noise, the grain of ground, foliage and clouds."""

import cv2
import numpy as np
from numpy.typing import NDArray

from recordings.drives.arrays import Singles

_ROW = 1024


def noise_tile(
    rng: np.random.Generator, size: int, slope: float, shortest: float, longest: float
) -> Singles:
    """Periodic noise (size, size), zero mean and unit deviation; wavelengths in texels, spectrum 1 / f^slope."""
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    frequency[0, 0] = 1.0
    band = (frequency <= 1.0 / shortest) & (frequency >= 1.0 / longest)
    tile = np.fft.irfft2(spectrum * np.where(band, frequency**-slope, 0.0), (size, size))
    even: Singles = ((tile - tile.mean()) / tile.std()).astype(np.float32)
    return even


def sample_tile(tile: Singles, x: NDArray[np.floating], y: NDArray[np.floating]) -> Singles:
    """Periodic bilinear look-up of a square tile at texel positions, any one shape (n,) or (rows, columns)."""
    size = np.float32(tile.shape[0])
    map_x, map_y = np.mod(x, size), np.mod(y, size)
    if x.ndim == 2:
        return _look_up(tile, map_x, map_y)
    # remap refuses rows longer than 32767 pixels, so a list of points is folded into short rows.
    padding = -len(x) % _ROW
    folded = (np.pad(m.reshape(1, -1), ((0, 0), (0, padding))) for m in (map_x, map_y))
    map_x, map_y = (m.reshape(-1, _ROW) for m in folded)
    return _look_up(tile, map_x, map_y).ravel()[: len(x)]


def _look_up(tile: Singles, map_x: Singles, map_y: Singles) -> Singles:
    sampled = cv2.remap(tile, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(sampled, np.float32)
