"""Posts of signs as they vary: width, profile, colour, rust, grain, holes and shade."""

import cv2
import numpy as np

from recordings.drives.arrays import Singles
from recordings.drives.paint.texture import Rgb, Texture, linear, opaque

_GALVANISED: tuple[Rgb, ...] = ((150, 153, 154), (172, 174, 174), (128, 132, 134))
_WOODS: tuple[Rgb, ...] = ((138, 124, 90), (158, 128, 94), (112, 88, 66), (142, 134, 124))
_PAINTS: tuple[Rgb, ...] = ((58, 84, 62), (92, 74, 60), (46, 46, 48))
_RUST: Rgb = (104, 64, 44)
_KINDS: dict[str, tuple[tuple[float, ...], tuple[Rgb, ...]]] = {
    "wood": ((0.089, 0.114, 0.14), (*_WOODS, (206, 206, 200))),
    "round_metal": ((0.048, 0.06, 0.073), (*_GALVANISED, *_GALVANISED, *_PAINTS)),
    "u_channel": ((0.076, 0.083, 0.09), (*_GALVANISED, *_PAINTS[:2])),
    "steel_beam": ((0.1, 0.13, 0.165, 0.2), (*_GALVANISED, *_GALVANISED, *_PAINTS[:2])),
    "pole": ((0.2, 0.25, 0.3, 0.36), (*_GALVANISED, *_WOODS[2:])),
}
"""Usual widths (m) and sRGB colours of each kind."""
_COLUMNS, _ROW_M, _HOLES_M = 48, 0.0125, 0.025


def varied_post(kind: str, length: float, rng: np.random.Generator) -> tuple[Texture, float]:
    """A post of a kind and length (m) as its texture and its width (m)."""
    widths, colors = _KINDS[kind]
    width, color = float(rng.choice(widths)), colors[rng.integers(len(colors))]
    rows = max(int(length / _ROW_M), 16)
    paint: Singles = np.empty((rows, _COLUMNS, 3), np.float32)
    paint[:] = linear(*color)
    if color in _WOODS:
        streaks = cv2.GaussianBlur(_noise(rng, rows), (1, 0), 0.6, sigmaY=9.0)
        paint *= (1 + rng.uniform(0.6, 1.6) * streaks)[..., None]
    elif rng.random() < 0.35:
        blotches = cv2.GaussianBlur(_noise(rng, rows), (0, 0), 5.0) * 12 + rng.uniform(-1, 1.5)
        paint += np.clip(blotches, 0, 1)[..., None] * (linear(*_RUST) - paint)
    paint *= _profile(kind, rng)[None, :, None]
    if kind == "u_channel":
        holes = (np.arange(rows) * _ROW_M) % _HOLES_M < _HOLES_M / 2
        paint[holes, _COLUMNS * 5 // 11 : _COLUMNS * 6 // 11] *= rng.uniform(0.2, 0.7)
    return opaque(paint * _shade(rng, rows)[:, None, None]), width * float(rng.uniform(0.97, 1.03))


def _noise(rng: np.random.Generator, rows: int) -> Singles:
    return rng.standard_normal((rows, _COLUMNS)).astype(np.float32)


def _profile(kind: str, rng: np.random.Generator) -> Singles:
    """Light across a post (columns,): round, a plate, a channel, or a beam whose flange shades its web."""
    x = np.linspace(-0.98, 0.98, _COLUMNS)
    side, deep = rng.choice([-1, 1]), rng.uniform(0.35, 0.7)
    if kind in ("round_metal", "pole"):
        ambient = rng.uniform(0.3, 0.6)
        toward = np.clip(np.sqrt(1 - x**2) * 0.85 + side * rng.uniform(0, 0.5) * x, 0, 1)
        light = ambient + (1 - ambient) * toward
    elif kind == "u_channel":
        wall = np.where(x * side > 0, 1.1, deep)
        light = np.where(abs(x) > 0.66, 1.0, np.where(abs(x) > 0.4, wall, rng.uniform(0.6, 0.9)))
    elif kind == "steel_beam" and rng.random() < 0.4:
        light = np.where(abs(x) > rng.uniform(0.8, 0.92), 1.0, deep)
    elif kind == "steel_beam":  # from the front and aside: the plate, then the web behind it
        behind = rng.uniform(0.45, 0.85)
        light = np.where(x * side < behind, 1.0, np.where(x * side > 0.92, 0.95, deep))
    else:
        light = np.where(x * side > rng.uniform(0.7, 1.0), rng.uniform(0.6, 0.9), 1.0)
    return np.asarray(light, np.float32)


def _shade(rng: np.random.Generator, rows: int) -> Singles:
    """Light along a post (rows,): evenly lit, or with the shade of a branch on a part of it."""
    depth = rng.uniform(0.45, 1.0) if rng.random() < 0.4 else 1.0
    at, soft = rng.uniform(0, rows, 2), rng.uniform(2, 16)
    along = np.arange(rows)
    shaded = 1 / (1 + np.exp(-(along - at.min()) / soft)) - 1 / (
        1 + np.exp(-(along - at.max()) / soft)
    )
    return np.asarray(rng.uniform(0.75, 1.1) * (1 - (1 - depth) * shaded), np.float32)
