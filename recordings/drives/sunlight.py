"""Sun, ambient light and haze of a drive."""

from dataclasses import dataclass

import numpy as np

from recordings.drives.arrays import Floats, Singles
from recordings.drives.spec import LightSpec


@dataclass(frozen=True, slots=True)
class Sunlight:
    """Direction to the sun (world, unit) and colours of light, each (3,) linear RGB."""

    to_sun: Floats
    sun: Floats
    ambient: Floats
    haze: Singles

    def on_surface(self, share: float) -> Singles:
        """Irradiance on a surface that sees a fraction of the sun."""
        return (self.sun * share + self.ambient).astype(np.float32)


def sunlight(light: LightSpec) -> Sunlight:
    """Light of a drive; warmth makes the sun and the haze redder."""
    azimuth, elevation = np.radians([light.sun_azimuth_deg, light.sun_elevation_deg])
    level = np.cos(elevation)
    to_sun = np.array([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(elevation)])
    warm = light.warmth
    haze = light.sky_brightness * np.array(
        [0.68 + 0.16 * warm, 0.75 + 0.02 * warm, 0.84 - 0.12 * warm]
    )
    return Sunlight(
        to_sun=to_sun,
        sun=light.sun * np.array([1.0, 0.96 - 0.22 * warm, 0.90 - 0.48 * warm]),
        ambient=light.ambient * np.array([0.93, 0.99, 1.10]),
        haze=haze.astype(np.float32),
    )
