"""Walls, shop fronts, billboards and silos."""

import cv2
import numpy as np

from recordings.drives.paint import texture

_LETTERS = (
    "COLD BEER|BANK|MOTEL|CORN MAZE|TIRES|USED CARS|EAT HERE|JESUS SAVES|FIREWORKS|SEED|INSURANCE"
    "|PIZZA|ANTIQUES|LIVE BAIT"
).split("|")
_FASCIAS = (
    (196, 30, 34),
    (20, 80, 170),
    (250, 190, 20),
    (20, 120, 60),
    (240, 110, 20),
    (240, 240, 236),
)
_POSTERS = (
    *((206, 24, 32), (250, 196, 16), (16, 78, 168), (0, 124, 66), (242, 116, 20)),
    *((238, 238, 234), (30, 30, 34)),
)


def wall(
    rng: np.random.Generator,
    color: texture.Rgb,
    size: tuple[int, int],
    *,
    windows: int = 0,
    rib: int = 0,
    door: bool = False,
) -> texture.Texture:
    """Building wall of (columns, rows); a positive rib is siding every so many rows, a negative one upright ribs."""
    columns, rows = size
    image = texture.sheet(color, columns, rows)
    grain = rng.standard_normal((rows // 4, columns // 4)).astype(np.float32)
    image *= (1 + 0.06 * cv2.resize(grain, (columns, rows)))[..., None]
    if rib > 0:
        image[::rib] *= 0.82
    elif rib < 0:
        image[:, ::-rib] *= 0.8
    frame, glass = texture.linear(226, 224, 216), texture.linear(52, 62, 74)
    for i in range(windows):
        x = (i + 0.5) / windows
        half = min(0.09, 0.28 / windows)
        texture.fill_box(image, (x - half - 0.012, 0.33, x + half + 0.012, 0.68), frame)
        pane = glass * np.float32(rng.uniform(0.6, 1.8))
        texture.fill_box(image, (x - half, 0.35, x + half, 0.66), pane)
        texture.fill_box(image, (x - half, 0.5, x + half, 0.515), frame)
    if door:
        x = float(rng.uniform(0.2, 0.7))
        texture.fill_box(image, (x, 0.4, x + 0.12, 1.0), texture.linear(*rng.uniform(30, 150, 3)))
    return texture.opaque(image)


def shop_front(rng: np.random.Generator) -> texture.Texture:
    """Town shop: coloured fascia with lettering, glass below, wall above."""
    image = np.empty((240, 400, 3), np.float32)
    image[:] = texture.linear(*rng.uniform((120, 80, 60), (200, 180, 160)))
    image[::10] *= 0.85
    fascia = _FASCIAS[int(rng.integers(len(_FASCIAS)))]
    texture.fill_box(image, (0.04, 0.42, 0.96, 0.58), texture.linear(*fascia))
    ink = texture.linear(20, 20, 20) if sum(fascia) > 380 else texture.linear(240, 240, 240)
    texture.write_text(
        image, _LETTERS[int(rng.integers(len(_LETTERS)))], (0.2, 0.44, 0.8, 0.57), ink
    )
    texture.fill_box(image, (0.06, 0.62, 0.94, 0.96), texture.linear(40, 50, 58))
    for x in (0.25, 0.5, 0.75):
        texture.fill_box(image, (x - 0.01, 0.62, x + 0.01, 0.96), texture.linear(190, 190, 186))
    for x in (0.15, 0.4, 0.65, 0.85):
        texture.fill_box(image, (x - 0.05, 0.1, x + 0.05, 0.34), texture.linear(60, 70, 84))
    return texture.opaque(image)


def billboard(rng: np.random.Generator) -> texture.Texture:
    """Advertising panel with strong colours."""
    image = np.empty((240, 640, 3), np.float32)
    picks = rng.permutation(len(_POSTERS))
    ground, second, third = (texture.linear(*_POSTERS[i]) for i in picks[:3])
    image[:] = ground
    paint = [float(v) for v in second]
    style = int(rng.integers(3))
    if style == 0:
        texture.fill_box(image, (0, 0.62, 1, 1), second)
    elif style == 1:
        cv2.circle(image, (500, 120), 95, paint, -1)
    else:
        cv2.fillPoly(image, [np.array([[380, 0], [640, 0], [640, 240], [300, 240]])], paint)
    texture.write_text(
        image, _LETTERS[int(rng.integers(len(_LETTERS)))], (0.06, 0.18, 0.62, 0.52), third
    )
    exit_ink = third if style else texture.linear(20, 20, 20)
    texture.write_text(image, f"EXIT {int(rng.integers(5, 250))}", (0.1, 0.68, 0.45, 0.9), exit_ink)
    image *= (1 + 0.03 * rng.standard_normal((240, 640, 1))).astype(np.float32)
    return texture.opaque(image)


def silo(color: texture.Rgb) -> texture.Texture:
    """Grain silo with conical roof."""
    rows, columns = 320, 128
    x = np.linspace(-1, 1, columns, dtype=np.float32)[None, :]
    y = np.linspace(0, 1, rows, dtype=np.float32)[:, None]
    shade = 0.45 + 0.55 * np.sqrt(np.clip(1 - (x + 0.2) ** 2 / 1.5, 0, 1))
    ribs = 0.92 + 0.08 * np.sin(y * 180)
    image = (shade * ribs)[..., None] * texture.linear(*color)
    outline = np.where(y < 0.15, np.abs(x) < y / 0.15, np.abs(x) < 0.985)
    return texture.Texture(texture.rgba(image, outline.astype(np.float32)))


def gable(color: texture.Rgb, ribbed: bool) -> texture.Texture:
    """Triangular end of a roof."""
    image = texture.sheet(color, 192, 96)
    if ribbed:
        image[:, ::8] *= 0.8
    x, y = np.linspace(-1, 1, 192)[None, :], np.linspace(0, 1, 96)[:, None]
    return texture.Texture(texture.rgba(image, (np.abs(x) < y).astype(np.float32)))
