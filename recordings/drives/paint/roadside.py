"""Fences, rails, posts and the small things along a road."""

from functools import cache

import cv2
import numpy as np

from recordings.drives.paint.texture import Rgb, Texture, fill_box, ink, linear, opaque, rgba, sheet

_BEAM = (
    *(0.5, 0.75, 0.9, 0.7, 0.45, 0.4),
    *(0.5, 0.75, 0.9, 0.7, 0.45, 0.4),
    *(0.5, 0.75, 0.85, 0.6),
)


def fence(rng: np.random.Generator) -> Texture:
    """Eight metres of wire fence with two posts, 1.3 m high."""
    canvas = np.zeros((104, 640, 4), np.float32)
    for y in (14, 38, 62, 86):
        cv2.line(canvas, (0, y), (640, y), ink(linear(120, 118, 112)), 1)
    for x in (80, 400):
        lean = int(rng.integers(-4, 5))
        cv2.line(canvas, (x, 104), (x + lean, 4), ink(linear(96, 84, 70)), 8)
    return Texture(canvas)


def guardrail() -> Texture:
    """Four metres of W-beam with posts, 0.8 m high."""
    image = np.zeros((80, 400, 4), np.float32)
    profile = np.array(_BEAM, np.float32)
    beam = cv2.resize(profile[:, None], (1, 32))[:, 0]
    image[4:36, :, :3] = beam[:, None, None] * linear(200, 203, 205)
    image[4:36, :, 3] = 1
    for x in (90, 290):
        image[36:, x : x + 15] = ink(linear(100, 88, 74))
    return Texture(image)


def truss() -> Texture:
    """Steel lattice of a gantry."""
    image = np.zeros((48, 640, 4), np.float32)
    steel = ink(linear(150, 154, 156))
    for y in (4, 43):
        cv2.line(image, (0, y), (640, y), steel, 6)
    for x in range(0, 640, 40):
        cv2.line(image, (x, 4), (x + 40, 43), steel, 3)
        cv2.line(image, (x, 43), (x + 40, 4), steel, 3)
    return Texture(image)


def rod(color: Rgb) -> Texture:
    """Cylinder side, shaded across."""
    across = np.sqrt(np.clip(1 - np.linspace(-0.95, 0.95, 16) ** 2, 0, 1))
    shade = across.astype(np.float32) * 0.6 + 0.4
    image = np.empty((16, 16, 3), np.float32)
    image[:] = shade[None, :, None] * linear(*color)
    return opaque(image)


def plain(color: Rgb) -> Texture:
    """Single colour."""
    return opaque(sheet(color, 32, 32))


def grainy(color: Rgb, rng: np.random.Generator, grain: float) -> Texture:
    """Single colour with grain of a relative deviation."""
    image = sheet(color, 32, 32)
    image *= (1 + grain * rng.standard_normal((32, 32, 1))).astype(np.float32)
    return opaque(image)


def barrel() -> Texture:
    """Orange work-zone drum with white bands."""
    image = sheet((238, 98, 24), 64, 96)
    for top in (0.2, 0.5):
        fill_box(image, (0, top, 1, top + 0.14), linear(230, 230, 226))
    shade = 0.5 + 0.5 * np.sqrt(1 - np.linspace(-0.9, 0.9, 64) ** 2)
    return opaque(image * shade.astype(np.float32)[None, :, None])


def bale(rng: np.random.Generator) -> Texture:
    """Round hay bale end-on."""
    size = 96
    yy, xx = (np.mgrid[0:size, 0:size] - size / 2 + 0.5) / (size / 2)
    radius = np.hypot(xx, yy)
    swirl = 0.85 + 0.15 * np.sin(radius * 30 + np.arctan2(yy, xx))
    image = (swirl * (1.0 - 0.35 * yy))[..., None] * linear(190, 158, 88)
    image *= 1 + 0.1 * rng.standard_normal((size, size, 1))
    rim = np.clip((0.97 - radius) * 20, 0, 1)
    return Texture(rgba(image.astype(np.float32), rim.astype(np.float32)))


@cache
def contact_shadow() -> Texture:
    """Soft dark patch under a vehicle."""
    alpha = np.zeros((48, 48), np.float32)
    alpha[8:40, 8:40] = 0.8
    soft = np.asarray(cv2.GaussianBlur(alpha, (0, 0), 3.5), np.float32)
    return Texture(rgba(np.zeros((48, 48, 3), np.float32), soft))
