"""Sky, clouds, glow around the sun and the far skyline."""

import numpy as np

from recordings.drives.arrays import Singles
from recordings.drives.backdrop.tiles import TILE, Tiles
from recordings.drives.camera import CameraModel
from recordings.drives.paint.noise import sample_tile
from recordings.drives.paint.texture import linear
from recordings.drives.poses import TimedPose
from recordings.drives.spec import LightSpec
from recordings.drives.sunlight import Sunlight

_CLOUD = np.array([0.93, 0.945, 0.97], np.float32)
_ZENITH = np.array([0.17, 0.33, 0.68], np.float32)
_OVERCAST = 0.8  # cloud cover from which clouds reach the horizon


class Sky:
    """Draws the sky of one drive."""

    def __init__(self, light: LightSpec, sun: Sunlight, tiles: Tiles, camera: CameraModel) -> None:
        self.light, self.sunlight, self.tiles = light, sun, tiles
        self.focal = camera.canvas_focal
        self.ray_x = camera.canvas_columns().astype(np.float32)
        self.ray_y = camera.canvas_rows().astype(np.float32)

    def draw(self, pose: TimedPose, rows: slice) -> Singles:
        """Radiance (rows, canvas columns, 3) of some canvas rows as if there were no ground."""
        east, north, up = self._directions(pose, rows)
        sky = self._clear(east, north, up)
        if self.light.cloud_cover > 0:
            sky = self._with_clouds(sky, east, north, up)
        if float(up.min()) < 0.06:
            sky = self._with_skyline(sky, east, north, up)
        return sky

    def _directions(self, pose: TimedPose, rows: slice) -> tuple[Singles, Singles, Singles]:
        """Unit direction of every pixel, east, north and up."""
        x, y = np.broadcast_arrays(self.ray_x[None, :], self.ray_y[rows, None])
        r = pose.rotation.astype(np.float32)
        east, north, up = (r[i, 0] * x + r[i, 1] * y + r[i, 2] for i in range(3))
        scale = 1 / np.sqrt(x * x + y * y + 1)
        return east * scale, north * scale, up * scale

    def _clear(self, east: Singles, north: Singles, up: Singles) -> Singles:
        """Haze at the horizon, blue above, glow towards the sun."""
        light, to_sun = self.light, self.sunlight.to_sun
        warm = np.float32(light.warmth)
        blend = np.sqrt(np.clip(np.clip(up, 0.0, 1.0) * 1.6, 0, 1))[..., None]
        zenith = _ZENITH * light.sky_brightness
        sky: Singles = self.sunlight.haze * (1 - blend) + zenith * blend
        cosine = east * to_sun[0] + north * to_sun[1] + up * to_sun[2]
        toward = np.clip(cosine, 0, 1).astype(np.float32)
        glow = light.glare * toward**24 * 1.4 + 0.25 * light.sun * toward**6
        sky += glow[..., None] * np.array([1.0, 0.9 - 0.15 * warm, 0.75 - 0.3 * warm], np.float32)
        return sky

    def _with_clouds(self, sky: Singles, east: Singles, north: Singles, up: Singles) -> Singles:
        """Clouds on a plane overhead, finer noise added high up."""
        light, tiles = self.light, self.tiles
        k = np.float32(26.0) / np.maximum(up + 0.05, 0.02)
        field = sample_tile(tiles.clouds, east * k, north * k)
        finer = sample_tile(tiles.noise, east * k * 4, north * k * 4)
        field += 0.22 * finer * np.clip(up * 8, 0, 1)
        cover = np.clip((field - (1.1 - 2.6 * light.cloud_cover)) * 0.9, 0, 1)
        lowest = 0.25 if light.cloud_cover > _OVERCAST else 0
        cover = (cover * cover * (3 - 2 * cover) * np.clip(up * 14, lowest, 1))[..., None]
        tone = light.sky_brightness * (0.98 - 0.13 * np.clip(field, -1, 2.5))[..., None]
        clouded: Singles = sky * (1 - cover) + cover * tone * _CLOUD
        return clouded

    def _with_skyline(self, sky: Singles, east: Singles, north: Singles, up: Singles) -> Singles:
        """A strip of distant trees at the horizon."""
        azimuth = np.arctan2(east, north) * np.float32(TILE * 5 / (2 * np.pi))
        profile = np.append(self.tiles.skyline, self.tiles.skyline[0])
        height = np.interp(np.mod(azimuth, TILE), np.arange(TILE + 1), profile).astype(np.float32)
        amount = np.clip((0.0075 + 0.0016 * height - up) * self.focal * 0.5, 0, 1)[..., None]
        far = self.sunlight.haze * 0.62 + linear(52, 66, 46) * 0.3
        fringed: Singles = sky * (1 - amount) + far * amount
        return fringed
