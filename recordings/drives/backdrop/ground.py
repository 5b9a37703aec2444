"""Colour of the ground: covers, grain, wheel tracks, cracks and painted lines."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.drives.arrays import Singles
from recordings.drives.backdrop.cover import (
    FIELDS,
    LEFT_FIELD,
    RIGHT_FIELD,
    Marking,
    markings,
    materials,
    zones,
)
from recordings.drives.backdrop.mesh import Facets
from recordings.drives.backdrop.tiles import Tiles
from recordings.drives.camera import CameraModel
from recordings.drives.paint.noise import sample_tile
from recordings.drives.spec import DriveSpec
from recordings.drives.sunlight import Sunlight

_MIDDLE_M, _COARSE_M = 0.07, 0.6
"""Texel sizes of the noise layers on the ground."""
_FINE_TILES = ((0.008, 0.553), (0.0117, -0.302))
"""Texel size and turn (rad) of the two tiles of the fine layer. Their repeats never fall together, so that no shift
of a few metres along the road maps the ground onto itself."""
_FIELD_M = 170.0
_TEXELS_PER_M_OF_DAPPLE = np.float32(18)


@dataclass(frozen=True, slots=True)
class _Spots:
    """Ground pixels, each array (n,): where they lie, how large they are, and noise there."""

    s: Singles
    t: Singles
    depth: Singles
    across: Singles  # width of a pixel on the ground, m
    stretch: Singles  # square root of how much longer it is along the view
    dither: Singles
    fine: Singles
    middle: Singles
    coarse: Singles


class Ground:
    """Shades the ground of one drive."""

    def __init__(
        self,
        spec: DriveSpec,
        sun: Sunlight,
        tiles: Tiles,
        camera: CameraModel,
        dapple: Singles | None,
    ) -> None:
        self.spec, self.sunlight, self.tiles, self.dapple = spec, sun, tiles, dapple
        covers = materials(spec.scene.season)
        self.names = list(covers)
        self.table = np.array([cover.row() for cover in covers.values()], np.float32)
        self.limits, self.zones = zones(spec.road, self.names)
        self.markings = markings(spec.road)
        self.ray_x = camera.canvas_columns().astype(np.float32)
        self.ray_y = camera.canvas_rows().astype(np.float32)
        self.focal = np.float32(camera.canvas_focal)
        self.eye = np.float32(spec.camera.mount_height_m + 0.3)

    def shade(
        self, facets: Facets, mask: NDArray[np.bool_], rows: slice
    ) -> tuple[Singles, Singles]:
        """Linear colour (n, 3) and depth (n,) of the masked pixels of some canvas rows."""
        spots = self._spots(facets, mask, rows)
        zone = self._zone(spots)
        color = self._cover(spots, zone)
        for marking in self.markings:
            _paint_line(color, marking, spots)
        sun = np.full(len(spots.s), max(0.0, float(self.sunlight.to_sun[2])), np.float32)
        if self.dapple is not None:
            k = _TEXELS_PER_M_OF_DAPPLE
            sun *= sample_tile(self.dapple, spots.s * k, spots.t * k)
        light = self.sunlight
        color *= sun[:, None] * light.sun.astype(np.float32) + light.ambient.astype(np.float32)
        clear = np.exp(-spots.depth / np.float32(self.spec.light.haze_m))[:, None]
        return color * clear + light.haze * (1 - clear), spots.depth

    def _spots(self, facets: Facets, mask: NDArray[np.bool_], rows: slice) -> _Spots:
        """Intersections of the pixels' rays with their facets."""
        x = np.broadcast_to(self.ray_x[None, :], mask.shape)[mask]
        y = np.broadcast_to(self.ray_y[rows, None], mask.shape)[mask]
        p = facets.table[facets.ids[rows][mask]]
        inverse: Singles = np.maximum(p[:, 0] * x + p[:, 1] * y + p[:, 2], np.float32(1e-5))
        depth = np.asarray(1 / inverse, np.float32)
        across_road = depth * (p[:, 7] * x + p[:, 8] * y + p[:, 9])
        t = np.asarray(across_road + p[:, 10], np.float32)
        along = depth * (p[:, 3] * x + p[:, 4] * y + p[:, 5]) + p[:, 6]
        bend: Singles = np.maximum(1 - p[:, 12] * t, np.float32(0.1))
        s = np.asarray(p[:, 11] + along / bend, np.float32)
        across = depth / self.focal
        stretch = np.sqrt(np.clip(depth / self.eye, 1, 400))
        footprint = across * stretch

        def layer(tile: Singles, texel: float, phase: float, turn: float = 0.0) -> Singles:
            """Noise that fades where its texels are smaller than pixels."""
            fade = np.clip(1.6 - footprint / (6 * texel), 0, 1)
            cos, sin = np.float32(np.cos(turn) / texel), np.float32(np.sin(turn) / texel)
            noise = sample_tile(tile, s * cos + t * sin + phase, t * cos - s * sin)
            noise *= fade
            return noise

        first, second = (layer(self.tiles.grain, texel, 0, turn) for texel, turn in _FINE_TILES)
        return _Spots(
            s=s,
            t=t,
            depth=depth,
            across=across,
            stretch=stretch,
            dither=self.tiles.dither[: mask.shape[0]][mask],
            fine=(first + second) * np.float32(np.sqrt(0.5)),
            middle=layer(self.tiles.noise, _MIDDLE_M, 31.0),
            coarse=layer(self.tiles.noise, _COARSE_M, 77.0),
        )

    def _zone(self, spots: _Spots) -> NDArray[np.int64]:
        """Index of the cover of every spot; edges off the pavement wander."""
        road, s, t = self.spec.road, spots.s, spots.t
        paved = 8.6 if road.kind == "street" else 4.2
        wobble = t + (spots.middle * 0.06 + spots.coarse * 0.12) * (np.abs(t) > paved)
        zone: NDArray[np.int64] = self.zones[
            np.searchsorted(self.limits, wobble + spots.dither * spots.across)
        ]
        for side, mark in enumerate((LEFT_FIELD, RIGHT_FIELD)):
            inside = zone == mark
            if inside.any():
                number = np.floor((s[inside] + spots.coarse[inside]) / _FIELD_M)
                block = (number + self.tiles.first_fields[side]).astype(np.int64)
                fields = np.array([self.names.index(name) for name in FIELDS])
                zone[inside] = fields[(block * 7919) % len(FIELDS)]
        verge = 6.6 if road.kind == "four_lane" else np.abs(self.limits).min()
        blur = spots.dither * spots.across * spots.stretch * spots.stretch
        for where in road.side_roads:
            gravel = (np.abs(s - where + blur) < 3.4) & (t > verge)
            zone[gravel] = self.names.index("gravel")
        return zone

    def _cover(self, spots: _Spots, zone: NDArray[np.int64]) -> Singles:
        """Colour of the covers with grain, and wheel tracks and sealed cracks on asphalt."""
        s, t, fine, middle, coarse = spots.s, spots.t, spots.fine, spots.middle, spots.coarse
        m = self.table[zone]
        share = np.clip(0.5 + coarse * m[:, 8] + middle * m[:, 7] * 0.6, 0, 1)[:, None]
        color: Singles = m[:, 0:3] * share + m[:, 3:6] * (1 - share)
        shade = 1 + fine * m[:, 6] + middle * m[:, 7] * 0.5
        lane = np.abs(np.mod(t, np.float32(3.6)) - 1.8)
        tracks = np.exp(-(((lane - 0.85) / 0.35) ** 2)) * 0.13
        crack = np.abs(np.mod(s + middle * 0.35 + 2.0 * np.sin(t), np.float32(23.0)) - 11.5)
        length = spots.across * spots.stretch * spots.stretch
        seal = np.clip((0.03 + length * 0.5 - crack) / (length + 0.01), 0, 1)
        seal *= np.clip(0.06 / (length + 0.03), 0, 1)
        worn = shade * (1 - tracks) * (1 - 0.35 * np.clip(seal, 0, 1))
        shade = np.where(zone == self.names.index("asphalt"), worn, shade)
        color *= np.maximum(shade, 0.15)[:, None]
        return color


def _paint_line(color: Singles, marking: Marking, spots: _Spots) -> None:
    """Paint a worn line over the colours (n, 3) of the spots near it."""
    aside = np.abs(spots.t - marking.offset)
    near = np.flatnonzero(aside < marking.half_width + spots.across * 1.5)
    if near.size == 0:
        return
    width = spots.across[near]
    cover = np.clip((marking.half_width - aside[near]) / width + 0.5, 0, 1)
    cover = np.minimum(cover, np.clip(2 * marking.half_width / width, 0, 1))
    if marking.period:
        length = width * spots.stretch[near] ** 2
        phase = np.abs(np.mod(spots.s[near], np.float32(marking.period)) - marking.dash / 2)
        cover *= np.clip((marking.dash / 2 - phase) / length + 0.5, 0, 1)
    cover *= np.clip(0.9 + 0.35 * spots.middle[near] + 0.2 * spots.fine[near], 0.35, 1)
    color[near] = color[near] * (1 - cover[:, None]) + marking.color * cover[:, None]
