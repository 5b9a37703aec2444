"""Noise that every image of a drive shares."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.drives.arrays import Singles
from recordings.drives.paint.noise import noise_tile

TILE = 512
BAND_ROWS = 48


@dataclass(frozen=True, slots=True)
class Tiles:
    """Periodic tiles (TILE, TILE), the profile of the skyline (TILE,) and dither for a band of the canvas."""

    noise: Singles
    grain: Singles
    clouds: Singles
    skyline: Singles
    first_fields: NDArray[np.int64]  # number of the first field left and right of the road
    dither: Singles  # (BAND_ROWS, canvas columns), -0.5 to 0.5


def make_tiles(seed: int, columns: int) -> Tiles:
    """Tiles of a drive for a canvas of so many columns."""
    rng = np.random.default_rng([seed, 3])
    return Tiles(
        noise=noise_tile(rng, TILE, 0.9, 2.0, 256.0),
        grain=noise_tile(rng, TILE, 0.25, 2.0, 64.0),
        clouds=noise_tile(rng, TILE, 1.75, 3.0, 300.0),
        skyline=noise_tile(rng, TILE, 0.7, 3.0, 60.0)[0],
        first_fields=rng.integers(0, 1000, 2),
        dither=rng.random((BAND_ROWS, columns), np.float32) - np.float32(0.5),
    )
