"""Trees, bushes and weeds seen from the side."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import cv2
import numpy as np

from recordings.drives.arrays import Singles
from recordings.drives.paint.noise import noise_tile
from recordings.drives.paint.texture import Texture, ink, linear, rgba

Plant: TypeAlias = Literal["broad", "conifer", "bush", "weed"]

_SIZE = 384
_WEED_SIZE = 160


@dataclass(frozen=True, slots=True)
class _Clump:
    """One ball of leaves; positions and radius as fractions of the image."""

    u: float
    v: float
    radius: float
    shade: float


def foliage(rng: np.random.Generator, kind: Plant, season: float) -> Texture:
    """A broad-leaved tree, conifer, bush or weed; season 0 is lush, 1 is dry."""
    return _weed(rng, season) if kind == "weed" else _leafy(rng, kind, season)


def _clumps(rng: np.random.Generator, kind: Plant) -> Iterator[_Clump]:
    """Balls of leaves that fill the outline of a crown."""
    bottom = {"broad": 0.78, "conifer": 0.97, "bush": 1.0}[kind]
    for _ in range({"broad": 90, "conifer": 110, "bush": 60}[kind]):
        v = rng.uniform(0.14, bottom)
        if kind == "conifer":
            half, radius = 0.32 * (v - 0.1) + 0.01, rng.uniform(0.04, 0.08)
        elif kind == "bush":
            half = 0.42 * np.sqrt(max(0.0, 1 - ((1 - v) / 0.87) ** 2)) * 0.85
            radius = rng.uniform(0.06, 0.13)
        else:
            half = 0.36 * np.sqrt(max(0.02, 1 - ((v - 0.45) / 0.34) ** 2))
            radius = rng.uniform(0.05, 0.12)
        u = 0.5 + rng.uniform(-half, half)
        yield _Clump(u, v, radius, rng.uniform(0.75, 1.15))


def _crown(
    rng: np.random.Generator, kind: Plant, xx: Singles, yy: Singles
) -> tuple[Singles, Singles]:
    """Brightness and cover of a crown, clumps drawn over each other in random order."""
    tone = np.zeros((_SIZE, _SIZE), np.float32)
    cover = np.zeros((_SIZE, _SIZE), np.float32)
    clumps = list(_clumps(rng, kind))
    for i in rng.permutation(len(clumps)):
        u, v, radius = clumps[i].u, clumps[i].v, clumps[i].radius
        r0, r1 = max(0, int((v - radius) * _SIZE)), min(_SIZE, int((v + radius) * _SIZE) + 1)
        c0, c1 = max(0, int((u - radius) * _SIZE)), min(_SIZE, int((u + radius) * _SIZE) + 1)
        if r1 <= r0 or c1 <= c0:
            continue
        dx, dy = (xx[r0:r1, c0:c1] - u) / radius, (yy[r0:r1, c0:c1] - v) / radius
        inside = dx * dx + dy * dy < 1
        lit = clumps[i].shade * (0.62 - 0.38 * dy - 0.15 * dx) * (1.15 - 0.55 * v)
        tone[r0:r1, c0:c1][inside] = lit[inside]
        cover[r0:r1, c0:c1][inside] = 1.0
    return tone, cover


def _displaced(image: Singles, map_x: Singles, map_y: Singles) -> Singles:
    """An image with every pixel fetched from elsewhere, empty outside."""
    moved = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(moved, np.float32)


def _leafy(rng: np.random.Generator, kind: Plant, season: float) -> Texture:
    """A crown with ragged edges, on a trunk if it is a broad-leaved tree."""
    fine = noise_tile(rng, _SIZE, 0.6, 2.0, 24.0)
    medium = noise_tile(rng, _SIZE, 1.4, 10.0, 120.0)
    yy, xx = np.mgrid[0:_SIZE, 0:_SIZE].astype(np.float32) / _SIZE
    tone, cover = _crown(rng, kind, xx, yy)
    shift = (medium * 3 + fine * 4).astype(np.float32)
    map_x, map_y = xx * _SIZE + shift, yy * _SIZE + np.roll(shift, 57, axis=0)
    tone, cover = _displaced(tone, map_x, map_y), _displaced(cover, map_x, map_y)
    edge = np.asarray(cv2.GaussianBlur(cover, (0, 0), _SIZE * 0.025), np.float32)
    ragged = edge + 0.2 * np.clip(fine, -1.6, 1.6)
    cover *= np.clip((ragged - 0.45) * 6, 0, 1)
    tone = np.clip(tone * (1 + 0.28 * fine + 0.12 * medium), 0.05, 2.0)
    lush = linear(*rng.uniform((62, 92, 30), (98, 128, 52)))
    dark = linear(*rng.uniform((36, 62, 36), (58, 82, 48)))
    dry = linear(*rng.uniform((128, 112, 58), (158, 130, 70)))
    base = dark if kind == "conifer" else lush * (1 - 0.6 * season) + dry * 0.6 * season
    color = tone[..., None] * base
    if kind == "broad":
        wobble = 0.5 + 0.02 * np.sin(yy * 9)
        trunk = (np.abs(xx - wobble) < 0.018 + 0.02 * yy) & (yy > 0.55)
        bare = trunk & (cover < 0.5)
        color[bare] = linear(74, 62, 50) * (0.7 + 0.3 * fine[bare][:, None])
        cover = np.where(bare, 1.0, cover)
    cover[0], cover[:, 0], cover[:, -1] = 0, 0, 0
    return Texture(rgba(color, cover))


def _weed(rng: np.random.Generator, season: float) -> Texture:
    """Tuft of tall grass."""
    size = _WEED_SIZE
    canvas = np.zeros((size, size, 4), np.float32)
    fresh, straw = linear(104, 116, 52), linear(176, 154, 96)
    for _ in range(130):
        x = rng.normal(size / 2, size * 0.16)
        lean = rng.normal(0, size * 0.13)
        height = size * rng.uniform(0.35, 0.97)
        blend = np.clip(season + rng.normal(0, 0.25), 0, 1)
        color = (fresh * (1 - blend) + straw * blend) * rng.uniform(0.6, 1.15)
        points = np.array(
            [[x, size], [x + lean * 0.3, size - height * 0.5], [x + lean, size - height]]
        )
        sixteenths = np.round(points * 16).astype(np.int32)
        thickness = int(rng.integers(1, 3))
        cv2.polylines(canvas, [sixteenths], False, ink(color), thickness, cv2.LINE_8, 4)
    canvas[:, 0], canvas[:, -1], canvas[0] = 0, 0, 0
    return Texture(canvas)
