"""Gabled barns, houses and sheds."""

from dataclasses import dataclass

import numpy as np

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Floats
from recordings.drives.paint.buildings import gable, wall
from recordings.drives.paint.texture import Rgb
from recordings.drives.parts import UP, Part, Quad
from recordings.drives.solids import Footing, box

_SUNK_M = 0.3
_ROOF_PAINTS = ((92, 84, 78), (120, 60, 50), (150, 152, 154))


@dataclass(frozen=True, slots=True)
class _Style:
    """Length, width, height of the eaves and of the roof above them (m); paints, ribs and windows of the walls."""

    size: tuple[float, float, float, float]
    paints: tuple[Rgb, ...]
    rib: int
    windows: int


_STYLES = {
    "barn": _Style((16, 10, 5.0, 4.0), ((146, 32, 30), (160, 40, 34), (226, 224, 216)), -12, 2),
    "house": _Style(
        (12, 8, 3.2, 2.6),
        ((228, 226, 218), (206, 190, 152), (150, 170, 186), (150, 84, 66), (224, 206, 120)),
        7,
        4,
    ),
    "shed": _Style(
        (20, 12, 4.2, 1.8),
        ((168, 172, 176), (206, 204, 192), (96, 124, 104), (62, 92, 142)),
        -8,
        0,
    ),
}


def build(
    road: RoadAlignment, rng: np.random.Generator, station: float, offset: float
) -> tuple[str, Floats, list[Part]]:
    """A building of some kind along the road or across it: its kind, base (world, m) and parts."""
    _, right, _ = road.axes(station)
    forward = road.level_forward(station)
    if rng.random() < 0.4:
        forward, right = right, -forward
    kind = str(rng.choice(list(_STYLES)))
    style = _STYLES[kind]
    length, width, eaves, rise = (v * rng.uniform(0.8, 1.15) for v in style.size)
    paint = style.paints[int(rng.integers(len(style.paints)))]
    base = road.surface(station, offset)
    base[2] -= _SUNK_M
    faces = {
        name: wall(
            rng,
            paint,
            (420 if name in ("left", "right") else 280, 150),
            windows=style.windows,
            rib=style.rib,
            door=name == "front",
        )
        for name in ("front", "rear", "left", "right")
    }
    footing, top = Footing(base, forward, right), eaves + _SUNK_M
    parts = box(footing, (length, width), (0, top), faces)
    end = gable(paint, ribbed=style.rib < 0)
    roof = wall(rng, _ROOF_PAINTS[int(rng.integers(3))], (256, 128), rib=9)
    ridge, f, r = base + UP * (top + rise), forward * length, right * width
    parts += [
        Quad(ridge - f / 2 - r / 2, r, -UP * rise, end),
        Quad(ridge + f / 2 + r / 2, -r, -UP * rise, end),
        Quad(ridge - f / 2, f, r / 2 - UP * rise, roof),
        Quad(ridge + f / 2, -f, -r / 2 - UP * rise, roof),
    ]
    return kind, base, parts
